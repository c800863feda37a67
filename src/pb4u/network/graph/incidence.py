"""Incidence of edges and nodes: the node at each edge's end, and the edges at each node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

Span = tuple[int, int]

EDGES_PER_RUN = 8192
"""So many edges of 128 latents in float32 take 4 MB, which stays in a processor's cache between two layers."""


@dataclass(frozen=True, eq=False)
class Incidence:
    """One end of a list of edges, readable from both sides.

    Args:
        index: (edges,) int64 node at this end of each edge.
        offsets: (nodes + 1,) int64; edges order[offsets[i]:offsets[i + 1]] touch node i.
        order: (edges,) int64 edges in ascending order of their node (the identity where they are stored so).
    """

    index: Tensor
    offsets: Tensor
    order: Tensor

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return self.offsets.shape[0] - 1

    @cached_property
    def runs(self) -> tuple[tuple[Span, Span], ...]:
        """Spans of edges and of the nodes they touch, where edges are stored in order; computed when first read."""
        return edge_runs(self.offsets)

    def restrict(self, edges: Sequence[Span], nodes: Sequence[Span]) -> Incidence:
        """Incidence of the given spans alone, renumbered.

        Args:
            edges: spans of edges, each touching exactly the span of nodes beside it.
            nodes: spans of nodes.
        """
        index, order, offsets = [], [], [self.offsets.new_zeros(1)]
        edge_base = node_base = 0
        for (e0, e1), (n0, n1) in zip(edges, nodes, strict=True):
            index.append(self.index[e0:e1] + (node_base - n0))
            order.append(self.order[e0:e1] + (edge_base - e0))
            offsets.append(self.offsets[n0 + 1 : n1 + 1] + (edge_base - e0))
            edge_base += e1 - e0
            node_base += n1 - n0
        return Incidence(torch.cat(index), torch.cat(offsets), torch.cat(order))


@dataclass(frozen=True, eq=False)
class Bags:
    """For each edge some rows of a table.

    Args:
        rows: (edges * rows of each,) int64.
        offsets: (edges + 1,) int64 first of the rows of each edge, and the total.
    """

    rows: Tensor
    offsets: Tensor

    @classmethod
    def of(cls, rows: Tensor) -> Bags:
        """Bags of `rows` (edges, rows of each) int64."""
        count, each = rows.shape
        return cls(rows.reshape(-1), torch.arange(0, each * count + 1, each, device=rows.device))


def incidence(index: Tensor, node_count: int) -> Incidence:
    """Incidence of one end of a list of edges.

    Args:
        index: (edges,) int64 node at that end of each edge.
        node_count: number of nodes.
    """
    ordered, order = torch.sort(index, stable=True)
    nodes = torch.arange(node_count + 1, device=index.device)
    return Incidence(index, torch.searchsorted(ordered, nodes), order)


def both_directions(pairs: Tensor, node_count: int) -> tuple[Incidence, Incidence]:
    """Senders and receivers of undirected edges, both ways, in ascending order of receiver, then of sender.

    Args:
        pairs: (edges, 2) int64 node indices, each edge once.
        node_count: number of nodes.
    """
    both = torch.cat([pairs, pairs.flip(1)])
    both = both[torch.argsort(both[:, 1] * node_count + both[:, 0])]
    return incidence(both[:, 0].contiguous(), node_count), incidence(both[:, 1].contiguous(), node_count)


def edge_runs(offsets: Tensor, edges_per_run: int = EDGES_PER_RUN) -> tuple[tuple[Span, Span], ...]:
    """Spans of edges and of nodes of about `edges_per_run` edges, cut between nodes; they cover everything in order.

    Empty where all edges fit into one run, or on an accelerator.

    Args:
        offsets: (nodes + 1,) int64 index of the first edge of each node, and the total.
        edges_per_run: number of edges aimed at.
    """
    if offsets.device.type != "cpu" or int(offsets[-1]) <= edges_per_run:
        return ()
    edge_count, node_count = int(offsets[-1]), offsets.shape[0] - 1
    cuts = torch.searchsorted(offsets, torch.arange(edges_per_run, edge_count, edges_per_run))
    bounds: Sequence[int] = [0, *torch.unique(cuts.clamp(1, node_count - 1)).tolist(), node_count]
    edges = offsets[torch.tensor(bounds)].tolist()
    return tuple(((edges[i], edges[i + 1]), (bounds[i], bounds[i + 1])) for i in range(len(bounds) - 1))
