"""MeshGraphNet: encode, fifteen blocks, decode (Pfaff et al. 2021; with the family's features, reference 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from torch import Tensor, nn

from pb4u.baselines.encode_process_decode import MESH_GRAPH_LAYOUT, EncodeProcessDecode
from pb4u.graph.features import FeatureLayout
from pb4u.graph.graph import GARMENT, Graph
from pb4u.graph.world_edges import WorldEdgeRule
from pb4u.nn.acceleration_model import NetworkConfiguration
from pb4u.nn.interaction_block import InteractionBlock


@dataclass(frozen=True, kw_only=True)
class MeshGraphNetConfiguration(NetworkConfiguration):
    """A MeshGraphNet.

    Args:
        width: of all latents and hidden layers.
        blocks: as many mesh edges can a stretch travel in a step; 15, and 48 for HOOD's reach, in the family's tables.
        layout: the columns read; absolute edge vectors and lengths by default.
        world_edges: which body vertices a garment vertex sees.
    """

    width: int = 128
    blocks: int = 15
    layout: FeatureLayout = field(default_factory=lambda: MESH_GRAPH_LAYOUT)
    world_edges: WorldEdgeRule = field(default_factory=WorldEdgeRule)

    def network(self) -> MeshGraphNet:
        """A network of this configuration with fresh weights."""
        return MeshGraphNet(self)


class MeshGraphNet(EncodeProcessDecode):
    """Blocks over mesh and world edges."""

    def __init__(self, configuration: MeshGraphNetConfiguration) -> None:
        super().__init__(configuration, ("mesh",))
        self.configuration = configuration
        width = configuration.width
        self.blocks = nn.ModuleList(InteractionBlock(width, ("mesh", "world")) for _ in range(configuration.blocks))

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3); `steps` is not read."""
        nodes, edges = self.encode(graph)
        for index, block in enumerate(self.blocks):
            last = index == len(self.blocks) - 1
            nodes, edges = block(nodes, edges, graph, receivers=(GARMENT,) if last else None)
        return self.decoder(nodes[GARMENT])
