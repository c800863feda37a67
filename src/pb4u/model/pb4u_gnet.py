"""Pb4U-GNet: encode, propagate K steps, update once, fifteen MeshGraphNet blocks, decode (paper, figure 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from pb4u.graph.features import FeatureLayout, total_width
from pb4u.graph.garment_graph import GarmentGraph
from pb4u.graph.graph import GARMENT, Graph, NodeType
from pb4u.graph.world_edges import WorldEdgeRule
from pb4u.model.propagation import Propagation, PropagationForm
from pb4u.model.propagation_control import ConstantDistance, FixedSteps, PropagationControl
from pb4u.model.update_scaling import MeanScaling, NoScaling, PerVertexScaling, UpdateScaling
from pb4u.nn.acceleration_model import GraphNetwork, NetworkConfiguration
from pb4u.nn.interaction_block import InteractionBlock
from pb4u.nn.mlp import MLP, SplitMLP

TYPE_WIDTH = 9


@dataclass(frozen=True, kw_only=True)
class Pb4uConfiguration(NetworkConfiguration):
    """Everything that makes one Pb4U-GNet differ from another.

    Args:
        width: of all latents and hidden layers.
        blocks: MeshGraphNet blocks after the update.
        propagation: the paper's or the released form.
        control: how many propagation steps.
        scaling: how large an update.
        layout: the columns read.
        world_edges: which body vertices a garment vertex sees.
    """

    width: int = 128
    blocks: int = 15
    propagation: PropagationForm = field(default_factory=PropagationForm)
    control: ConstantDistance | FixedSteps = field(default_factory=ConstantDistance)
    scaling: PerVertexScaling | MeanScaling | NoScaling = field(default_factory=PerVertexScaling)
    layout: FeatureLayout = field(default_factory=FeatureLayout)
    world_edges: WorldEdgeRule = field(default_factory=WorldEdgeRule)

    def network(self) -> Pb4uGNet:
        """A network of this configuration with fresh weights."""
        return Pb4uGNet(self)


class Pb4uGNet(GraphNetwork):
    """The network of the paper, on normalised features."""

    def __init__(self, configuration: Pb4uConfiguration) -> None:
        super().__init__(configuration)
        self.configuration = configuration
        layout = configuration.layout
        self.control: PropagationControl = configuration.control
        self.scaling: UpdateScaling = configuration.scaling
        width = configuration.width
        self.node_type = nn.Embedding(len(NodeType), TYPE_WIDTH)
        self.node_encoder = MLP(total_width(layout.node_columns) + TYPE_WIDTH, width, width, norm=True)
        self.edge_encoders = nn.ModuleDict(
            {
                "mesh": MLP(total_width(layout.mesh_edge_columns), width, width, norm=True),
                "world": MLP(total_width(layout.world_edge_columns), width, width, norm=True),
            }
        )
        self.propagation = Propagation(width, configuration.propagation)
        self.update = SplitMLP((width, width), width, width, norm=True)
        self.blocks = nn.ModuleList(InteractionBlock(width, ("mesh", "world")) for _ in range(configuration.blocks))
        self.decoder = MLP(width, width, 3, norm=False)

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3), with `steps` propagation steps for each garment."""
        nodes = {
            name: self.node_encoder(torch.cat([s.features, self.node_type(s.types).to(s.features)], dim=1))
            for name, s in graph.nodes.items()
        }
        edges = {name: self.edge_encoders[s.kind](s.features) for name, s in graph.edges.items()}

        travelled = self.propagation(nodes, edges, graph, steps)
        hidden = self.update.project(0, nodes[GARMENT], bias=True) + self.update.project(1, travelled)
        nodes = {**nodes, GARMENT: self.update.after_first(hidden)}

        for index, block in enumerate(self.blocks):
            last = index == len(self.blocks) - 1
            nodes, edges = block(nodes, edges, graph, receivers=(GARMENT,) if last else None)
        return self.decoder(nodes[GARMENT])

    def propagation_steps(self, mean_edge_length: float) -> int:
        """K for a garment of this mean rest edge length [m]."""
        return self.control.steps(mean_edge_length)

    def update_scale(self, garments: GarmentGraph) -> Tensor | None:
        """S, (vertices, 1) dimensionless, or None for 1."""
        return self.scaling.factors(garments)
