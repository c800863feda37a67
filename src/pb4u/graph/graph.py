"""What a network sees of one time step: typed nodes and edges with their features. No weights, no positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import torch
from torch import Tensor

from pb4u.graph.incidence import Incidence, Span, incidence

GARMENT, BODY = "garment", "body"
EDGES_PER_RUN = 8192


class NodeType(IntEnum):
    """What a node is."""

    GARMENT = 0
    BODY = 1
    PINNED = 2


@dataclass(frozen=True, eq=False)
class NodeSet:
    """Nodes of one mesh kind.

    Args:
        features: (nodes, columns).
        types: (nodes,) int64 `NodeType`.
        owner: (nodes,) int64 garment that each node belongs to (the garment that touches it, for a body node).
        active: (nodes,) bool, False where no edge reaches the node, or None where every node counts.
    """

    features: Tensor
    types: Tensor
    owner: Tensor
    active: Tensor | None = None


@dataclass(frozen=True, eq=False)
class EdgePiece:
    """A run of edges that holds all edges of a run of receivers."""

    edges: slice
    senders: Incidence
    receivers: Incidence
    mask: Tensor | None


@dataclass(frozen=True, eq=False)
class EdgeSet:
    """Directed edges of one kind, in ascending order of receiver.

    Args:
        kind: which weights treat them: mesh, world, or what a network adds (coarse levels, repulsion, attraction).
        sender_set, receiver_set: names of the node sets they join.
        senders, receivers: the ends.
        features: (edges, columns).
        mask: (edges, 1), 0 where an edge of a fixed-size list is absent, or None where all exist.
        runs: spans of edges and of their receivers, small enough to stay in cache; they cover everything in order.
        columns: which table the features are of: "mesh_edge", "world_edge" or "found_edge".
    """

    kind: str
    sender_set: str
    receiver_set: str
    senders: Incidence
    receivers: Incidence
    features: Tensor
    mask: Tensor | None = None
    runs: tuple[tuple[Span, Span], ...] = ()
    columns: str = "mesh_edge"

    @property
    def edge_count(self) -> int:
        return self.receivers.index.shape[0]

    def pieces(self) -> tuple[EdgePiece, ...]:
        """All edges as one piece while gradients are recorded, else run by run."""
        if torch.is_grad_enabled() or len(self.runs) < 2:
            return (EdgePiece(slice(0, self.edge_count), self.senders, self.receivers, self.mask),)
        return tuple(self._piece(edges, nodes) for edges, nodes in self.runs)

    def degrees(self) -> Tensor:
        """(receivers, 1) number of edges that end at each receiver, absent ones left out."""
        counts = self.receivers.offsets.diff().to(self.features.dtype)
        if self.mask is not None:
            running = torch.nn.functional.pad(self.mask[:, 0].cumsum(0), (1, 0))
            counts = running[self.receivers.offsets].diff().to(self.features.dtype)
        return counts[:, None]

    def restrict(self, nodes: Sequence[Span]) -> EdgeSet:
        """Only the edges that end in the given spans of receivers, which are renumbered.

        Senders of the same set must lie in the same spans and are renumbered with them; others keep their numbers.
        """
        offsets, limits = self.receivers.offsets, [bound for span in nodes for bound in span]
        ends = offsets[torch.tensor(limits, device=offsets.device)].tolist()
        edges = list(zip(ends[::2], ends[1::2], strict=True))
        if self.sender_set == self.receiver_set:
            senders = self.senders.restrict(edges, nodes)
        else:
            senders = incidence(torch.cat([self.senders.index[e0:e1] for e0, e1 in edges]), self.senders.node_count)
        receivers = self.receivers.restrict(edges, nodes)
        return replace(
            self,
            senders=senders,
            receivers=receivers,
            features=torch.cat([self.features[e0:e1] for e0, e1 in edges]),
            mask=None if self.mask is None else torch.cat([self.mask[e0:e1] for e0, e1 in edges]),
            runs=receiver_runs(receivers.offsets, EDGES_PER_RUN),
        )

    def _piece(self, edges: Span, nodes: Span) -> EdgePiece:
        (e0, e1), (n0, n1) = edges, nodes
        # Senders lie anywhere: only their indices are read, since a piece is never differentiated.
        senders = Incidence(self.senders.index[e0:e1], self.senders.offsets, self.senders.order)
        order = torch.arange(e1 - e0, device=self.features.device)
        offsets = self.receivers.offsets[n0 : n1 + 1] - e0
        receivers = Incidence(self.receivers.index[e0:e1], offsets, order)
        return EdgePiece(slice(e0, e1), senders, receivers, None if self.mask is None else self.mask[e0:e1])


@dataclass(frozen=True, eq=False)
class Graph:
    """One time step of packed garments and their bodies.

    Args:
        nodes: node sets by name: "garment", and "body" where a body is near.
        edges: edge sets by name: "mesh", what a network adds ("coarse"), "body_to_garment", "garment_to_body".
        vertex_offsets: first garment node of each garment, and the total.
        rest: what the network derived once from the garments at rest (`Derived.rest`).
    """

    nodes: dict[str, NodeSet]
    edges: dict[str, EdgeSet]
    vertex_offsets: tuple[int, ...]
    rest: Mapping[str, Tensor] = field(default_factory=dict)

    def with_features(self, nodes: dict[str, Tensor], edges: dict[str, Tensor]) -> Graph:
        """The same graph with other features, by name of the set."""
        return replace(
            self,
            nodes={name: replace(node_set, features=nodes[name]) for name, node_set in self.nodes.items()},
            edges={name: replace(edge_set, features=edges[name]) for name, edge_set in self.edges.items()},
        )


def receiver_runs(offsets: Tensor, edges_per_run: int = EDGES_PER_RUN) -> tuple[tuple[Span, Span], ...]:
    """Spans of about `edges_per_run` edges, cut between receivers; none where all fit, or on an accelerator."""
    if offsets.device.type != "cpu" or int(offsets[-1]) <= edges_per_run:
        return ()
    edge_count, node_count = int(offsets[-1]), offsets.shape[0] - 1
    cuts = torch.searchsorted(offsets, torch.arange(edges_per_run, edge_count, edges_per_run))
    bounds: Sequence[int] = [0, *torch.unique(cuts.clamp(1, node_count - 1)).tolist(), node_count]
    edges = offsets[torch.tensor(bounds)].tolist()
    return tuple(((edges[i], edges[i + 1]), (bounds[i], bounds[i + 1])) for i in range(len(bounds) - 1))
