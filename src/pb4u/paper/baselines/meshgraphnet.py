"""MeshGraphNet: encode, fifteen blocks, decode (Pfaff et al. 2021; with the family's features, reference 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from torch import Tensor, nn

from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.encode_process_decode import EncodeProcessDecode
from pb4u.network.graph.features import FeatureLayout
from pb4u.network.graph.graph import Graph
from pb4u.network.interaction_block import InteractionBlock
from pb4u.network.mlp import MLP

MESH_GRAPH_LAYOUT = FeatureLayout(
    mesh_edge=("relative_position", "length", "rest_relative_position", "rest_length", "dt", "material")
)
"""Edges with absolute vectors and lengths, as MeshGraphNet and HOOD have them: 12 columns (reference 1.2)."""


@dataclass(frozen=True, kw_only=True)
class MeshGraphNetConfiguration(NetworkConfiguration):
    """Configuration of a MeshGraphNet; fields that are not listed are as in `NetworkConfiguration`.

    Args:
        blocks: number of blocks, each of which propagates messages by one mesh edge; 15, and 48 for HOOD's reach, in
            the family's tables.
        layout: the columns read; absolute edge vectors and lengths by default.
    """

    blocks: int = 15
    layout: FeatureLayout = field(default_factory=lambda: MESH_GRAPH_LAYOUT)

    def network(self) -> MeshGraphNet:
        """A network of this configuration with fresh weights."""
        return MeshGraphNet(self)


class MeshGraphNet(EncodeProcessDecode):
    """Network of blocks over mesh and world edges.

    Args:
        configuration: width, columns and blocks.
    """

    def __init__(self, configuration: MeshGraphNetConfiguration) -> None:
        super().__init__(configuration)
        width = configuration.width
        self.decoder = MLP(width, width, 3, norm=False)
        self.blocks = nn.ModuleList(InteractionBlock(width, ("mesh", "world")) for _ in range(configuration.blocks))

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3), dimensionless.

        Args:
            graph: with normalised features.
            steps: not read.
        """
        return self.decode_after(self.blocks, *self.encode(graph), graph)
