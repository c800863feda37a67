"""What the baselines share: encoders, a decoder, and how they read a graph (reference 1.1, 1.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec

import torch
from torch import Tensor, nn

from pb4u.errors import InputError
from pb4u.graph.features import FeatureLayout, total_width
from pb4u.graph.graph import GARMENT, Graph, NodeType
from pb4u.nn.acceleration_model import GraphNetwork, NetworkConfiguration
from pb4u.nn.mlp import MLP

TYPE_WIDTH = 9
LEVEL_WIDTH = 4
LEVEL = "level"

MESH_GRAPH_LAYOUT = FeatureLayout(
    mesh_edge=("relative_position", "length", "rest_relative_position", "rest_length", "dt", "material")
)
"""Edges with absolute vectors and lengths, as MeshGraphNet and HOOD have them: 12 columns (reference 1.2)."""


class EncodeProcessDecode(GraphNetwork):
    """Encoders for nodes and for every kind of edge, and a decoder; subclasses process in between.

    Args:
        configuration: width, layout and world edges.
        mesh_kinds: kinds of edges with the columns of mesh edges. found_kinds: those with the columns of found edges.
        levels: number of labels of a vertex's coarsest level, or 0 where nodes carry none.
    """

    def __init__(
        self,
        configuration: NetworkConfiguration,
        mesh_kinds: Sequence[str],
        found_kinds: Sequence[str] = (),
        levels: int = 0,
    ) -> None:
        super().__init__(configuration)
        width, layout = configuration.width, configuration.layout
        self.node_type = nn.Embedding(len(NodeType), TYPE_WIDTH)
        self.level = nn.Embedding(levels, LEVEL_WIDTH) if levels else None
        marks = TYPE_WIDTH + (LEVEL_WIDTH if levels else 0)
        self.node_encoder = MLP(total_width(layout.node_columns) + marks, width, width, norm=True)
        columns = {kind: layout.mesh_edge_columns for kind in mesh_kinds}
        columns |= {kind: layout.found_edge_columns for kind in found_kinds}
        columns["world"] = layout.world_edge_columns
        self.edge_encoders = nn.ModuleDict(
            {kind: MLP(total_width(of), width, width, norm=True) for kind, of in columns.items()}
        )
        self.decoder = MLP(width, width, 3, norm=False)

    def encode(self, graph: Graph) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """Node and edge latents (rows, width) by set name."""
        nodes = {}
        for name, node_set in graph.nodes.items():
            inputs = [node_set.features, self.node_type(node_set.types).to(node_set.features)]
            if self.level is not None:
                labels = graph.rest[LEVEL] if name == GARMENT else torch.zeros_like(node_set.types)
                inputs.append(self.level(labels).to(node_set.features))
            nodes[name] = self.node_encoder(torch.cat(inputs, dim=1))
        return nodes, {name: self.edge_encoders[s.kind](s.features) for name, s in graph.edges.items()}


def require_scipy(method: str) -> None:
    """Raises InputError where scipy, which a machine that only trains may lack, is not installed."""
    if find_spec("scipy") is None:
        raise InputError(f"{method} needs scipy, which is not installed here; `pip install scipy` adds it.")


def packed_pairs(pairs: Sequence[Tensor], offsets: Sequence[int], like: Tensor) -> Tensor:
    """Edges (edges, 2) numbered garment by garment as edges of the pack, on the device of `like`."""
    shifted = [of + offset for of, offset in zip(pairs, offsets, strict=False)]
    return torch.cat([torch.zeros(0, 2, dtype=torch.int64), *shifted]).to(like.device)


def with_edges(graph: Graph, kinds: Sequence[str]) -> Graph:
    """The graph with edges of the given kinds only."""
    return replace(graph, edges={name: s for name, s in graph.edges.items() if s.kind in kinds})
