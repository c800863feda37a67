"""Pb4U-GNet: encode, propagate K steps, update once, fifteen MeshGraphNet blocks, decode (paper, figure 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from torch import Tensor, nn

from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.encode_process_decode import EncodeProcessDecode
from pb4u.network.graph.garment_graph import GarmentGraph
from pb4u.network.graph.graph import GARMENT, Graph
from pb4u.network.interaction_block import InteractionBlock
from pb4u.network.mlp import MLP, SplitMLP
from pb4u.network.propagation import Propagation, PropagationForm
from pb4u.network.propagation_control import ConstantDistance, FixedSteps, TruncatedDistance
from pb4u.network.update_scaling import PerVertexScaling, Scaling, UpdateScale, scaling_of
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True, kw_only=True)
class Pb4uConfiguration(NetworkConfiguration):
    """Configuration of a Pb4U-GNet; fields that are not listed are as in `NetworkConfiguration`.

    Args:
        blocks: number of MeshGraphNet blocks after the update.
        propagation: the paper's or the released form.
        control: rule for the number of propagation steps.
        scaling: rule for the factors on the accelerations.
    """

    blocks: int = 15
    propagation: PropagationForm = field(default_factory=PropagationForm)
    control: ConstantDistance | TruncatedDistance | FixedSteps = field(default_factory=ConstantDistance)
    scaling: Scaling = field(default_factory=PerVertexScaling)

    def network(self) -> Pb4uGNet:
        """A network of this configuration with fresh weights."""
        return Pb4uGNet(self)


class Pb4uGNet(EncodeProcessDecode):
    """The network of the paper, on normalised features.

    Args:
        configuration: width, columns, propagation and blocks.
    """

    configuration: Pb4uConfiguration
    propagates = True

    def __init__(self, configuration: Pb4uConfiguration) -> None:
        super().__init__(configuration)
        width = configuration.width
        self.propagation = Propagation(width, configuration.propagation)
        self.update = SplitMLP((width, width), width, width, norm=True)
        self.blocks = nn.ModuleList(InteractionBlock(width, ("mesh", "world")) for _ in range(configuration.blocks))
        self.decoder = MLP(width, width, 3, norm=False)

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3), dimensionless.

        Args:
            graph: with normalised features.
            steps: propagation steps of each garment.
        """
        nodes, edges = self.encode(graph)
        propagated = self.propagation(nodes, edges, graph, steps)
        nodes = {**nodes, GARMENT: self.update.of_parts({0: nodes[GARMENT], 1: propagated})}
        return self.decode_after(self.blocks, nodes, edges, graph)

    def propagation_steps(self, mean_edge_length: float) -> int:
        """Number K of propagation steps of a garment of `mean_edge_length` [m].

        Args:
            mean_edge_length: mean edge length of the garment at rest [m].
        """
        return self.configuration.control.steps(mean_edge_length)

    def update_scale(self, garments: PackedGarments, graph: GarmentGraph) -> UpdateScale | None:
        """Factors S on the accelerations, or None for 1.

        Args:
            garments: the pack.
            graph: its static graph, with the rest lengths of the garments' edges.
        """
        return scaling_of(self.configuration.scaling, garments, graph)
