"""Graph of one time step, as a network reads it: typed nodes and edges with their features, without positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import torch
from torch import Tensor

from pb4u.network.graph.incidence import Incidence, Span, incidence

GARMENT, BODY = "garment", "body"


class NodeType(IntEnum):
    """Kind of a node: free garment vertex, body vertex or pinned garment vertex."""

    GARMENT = 0
    BODY = 1
    PINNED = 2


@dataclass(frozen=True, eq=False)
class NodeSet:
    """Nodes of one mesh kind.

    Args:
        features: (nodes, columns), each column in the unit of its `Feature`.
        types: (nodes,) int64 `NodeType`.
        world: (nodes,) int64 world that each node belongs to.
    """

    features: Tensor
    types: Tensor
    world: Tensor


@dataclass(frozen=True, eq=False)
class EdgeSet:
    """Directed edges of one kind, in ascending order of receiver.

    Args:
        kind: name of their weights: mesh, world, or one that a network adds (coarse levels, repulsion, attraction).
        sender_set: name of the node set they start from.
        receiver_set: name of the node set they end in.
        senders: node at the start of each edge.
        receivers: node at the end of each edge.
        features: (edges, columns), each column in the unit of its `Feature`.
        columns: table that the features are from: "mesh_edge", "world_edge" or "found_edge".
    """

    kind: str
    sender_set: str
    receiver_set: str
    senders: Incidence
    receivers: Incidence
    features: Tensor
    columns: str = "mesh_edge"

    @property
    def edge_count(self) -> int:
        """Number of directed edges."""
        return self.receivers.index.shape[0]

    def degrees(self) -> Tensor:
        """Number of edges that end at each receiver, (receivers, 1), dimensionless."""
        return self.receivers.offsets.diff()[: self.receivers.node_count].to(self.features.dtype)[:, None]

    def restrict(self, nodes: Sequence[Span]) -> EdgeSet:
        """Edges whose receivers are in the given index ranges; the receivers are renumbered.

        Senders of the same set must be in the same ranges and are renumbered too; others keep their numbers.

        Args:
            nodes: index ranges of receivers to keep.
        """
        offsets, limits = self.receivers.offsets, [bound for span in nodes for bound in span]
        ends = offsets[torch.tensor(limits, device=offsets.device)].tolist()
        edges = list(zip(ends[::2], ends[1::2], strict=True))
        if self.sender_set == self.receiver_set:
            senders = self.senders.restrict(edges, nodes)
        else:
            senders = incidence(torch.cat([self.senders.index[e0:e1] for e0, e1 in edges]), self.senders.node_count)
        features = torch.cat([self.features[e0:e1] for e0, e1 in edges])
        return replace(self, senders=senders, receivers=self.receivers.restrict(edges, nodes), features=features)


@dataclass(frozen=True, eq=False)
class Graph:
    """One time step of packed garments and their bodies.

    Args:
        nodes: node sets by name: "garment", and "body" where a body is near.
        edges: edge sets by name: "mesh", kinds that a network adds ("coarse"), "body_to_garment", "garment_to_body".
        vertex_offsets: first garment node of each garment, and the total.
        rest: tensors that the network derived once from the garments at rest (`Derived.rest`), by name.
    """

    nodes: dict[str, NodeSet]
    edges: dict[str, EdgeSet]
    vertex_offsets: tuple[int, ...]
    rest: Mapping[str, Tensor] = field(default_factory=dict)

    def with_features(self, nodes: dict[str, Tensor], edges: dict[str, Tensor]) -> Graph:
        """Copy of the graph with other features.

        Args:
            nodes: (nodes, columns) features of each node set by name, normalised ones dimensionless [1].
            edges: (edges, columns) features of each edge set by name, likewise [1].
        """
        return replace(
            self,
            nodes={name: replace(node_set, features=nodes[name]) for name, node_set in self.nodes.items()},
            edges={name: replace(edge_set, features=edges[name]) for name, edge_set in self.edges.items()},
        )
