"""Encode, process, decode: what all networks share (Pfaff et al. 2021; reference 1.1, 1.2)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from pb4u.network.acceleration_model import GraphNetwork, NetworkConfiguration
from pb4u.network.graph.features import total_width
from pb4u.network.graph.graph import GARMENT, Graph, NodeType
from pb4u.network.mlp import MLP

TYPE_WIDTH = 9
"""Width of the embedding of a node's type, as in the family's code, which embeds nine types."""
LEVEL_WIDTH = 4
"""Width of the embedding of a vertex's coarsest level, as in HOOD's code."""
LEVEL = "level"
"""Name in `Graph.rest` of the number of coarse levels that each garment vertex has edges on, (vertices,) int64."""


class EncodeProcessDecode(GraphNetwork):
    """Encoders for nodes and for every kind of edge; subclasses process, and decode with a decoder of their own.

    Args:
        configuration: width, layout and world edges.
        mesh_kinds: kinds of edges with the columns of mesh edges.
        found_kinds: kinds with the columns of edges found at every step.
        levels: number of labels of a vertex's coarsest level, or 0 if nodes have none.
    """

    decoder: MLP

    def __init__(
        self,
        configuration: NetworkConfiguration,
        mesh_kinds: Sequence[str] = ("mesh",),
        found_kinds: Sequence[str] = (),
        levels: int = 0,
    ) -> None:
        super().__init__(configuration)
        width, layout = configuration.width, configuration.layout
        self.node_type = nn.Embedding(len(NodeType), TYPE_WIDTH)
        self.level = nn.Embedding(levels, LEVEL_WIDTH) if levels else None
        marks = TYPE_WIDTH + (LEVEL_WIDTH if levels else 0)
        self.node_encoder = MLP(total_width(layout.columns("node")) + marks, width, width, norm=True)
        columns = {kind: layout.columns("mesh_edge") for kind in mesh_kinds}
        columns |= {kind: layout.columns("found_edge") for kind in found_kinds}
        columns["world"] = layout.columns("world_edge")
        self.edge_encoders = nn.ModuleDict(
            {kind: MLP(total_width(of), width, width, norm=True) for kind, of in columns.items()}
        )

    def encode(self, graph: Graph) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """Node and edge latents (rows, width), dimensionless, by set name.

        Args:
            graph: features of nodes and edges.
        """
        nodes = {name: self.node_encoder(values) for name, values in self.node_inputs(graph).items()}
        return nodes, {name: self.edge_encoders[s.kind](s.features) for name, s in graph.edges.items()}

    def node_inputs(self, graph: Graph) -> dict[str, Tensor]:
        """Input of the encoder of nodes, (nodes, columns) [1] by set name: features, and embeddings of labels.

        Args:
            graph: features of nodes and edges.
        """
        entering = {}
        for name, node_set in graph.nodes.items():
            inputs = [node_set.features, self.node_type(node_set.types).to(node_set.features)]
            if self.level is not None:
                labels = graph.rest[LEVEL] if name == GARMENT else torch.zeros_like(node_set.types)
                inputs.append(self.level(labels).to(node_set.features))
            entering[name] = torch.cat(inputs, dim=1)
        return entering

    def decode_after(
        self, blocks: nn.ModuleList, nodes: dict[str, Tensor], edges: dict[str, Tensor], graph: Graph
    ) -> Tensor:
        """Normalised accelerations (garment vertices, 3), dimensionless, after blocks in a row.

        Args:
            blocks: any number of `InteractionBlock`.
            nodes: latents (nodes, width) [1] by set name.
            edges: latents (edges, width) [1] by set name.
            graph: the ends of the edges.
        """
        for index, block in enumerate(blocks):
            last = index == len(blocks) - 1
            nodes, edges = block(nodes, edges, graph, receivers=(GARMENT,) if last else None)
        return self.decoder(nodes[GARMENT])
