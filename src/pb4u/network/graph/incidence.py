"""Incidence of edges and nodes: the node at each edge's end, and the edges at each node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

Span = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Incidence:
    """One end of a list of edges, readable from both sides.

    Args:
        index: (edges,) int64 node at this end of each edge.
        offsets: (nodes + 1,) int64; edges order[offsets[i]:offsets[i + 1]] touch node i.
        order: (edges,) int64 edges in ascending order of their node (the identity where they are stored so).
        spare: whether the last node of `offsets` is a dummy for unused entries of edges.
    """

    index: Tensor
    offsets: Tensor
    order: Tensor
    spare: bool = False

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return self.offsets.shape[0] - 1 - self.spare

    def restrict(self, edges: Sequence[Span], nodes: Sequence[Span]) -> Incidence:
        """Incidence of only the given index ranges, renumbered.

        Args:
            edges: index ranges of edges, each of which touches exactly the corresponding range of nodes.
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


def incidence(index: Tensor, node_count: int, filled: Tensor | None = None) -> Incidence:
    """Incidence of one end of a list of edges.

    Args:
        index: (edges,) int64 node at that end of each edge.
        node_count: number of nodes.
        filled: (edges,) bool, False where an edge is only room; None where all are edges.
    """
    spare = filled is not None
    ordered, order = torch.sort(index if filled is None else torch.where(filled, index, node_count), stable=True)
    nodes = torch.arange(node_count + 1 + spare, device=index.device)
    return Incidence(index, torch.searchsorted(ordered, nodes), order, spare)


def both_directions(pairs: Tensor, node_count: int) -> tuple[Incidence, Incidence]:
    """Senders and receivers of undirected edges, both ways, in ascending order of receiver, then of sender.

    Args:
        pairs: (edges, 2) int64 node indices, each edge once.
        node_count: number of nodes.
    """
    both = torch.cat([pairs, pairs.flip(1)])
    both = both[torch.argsort(both[:, 1] * node_count + both[:, 0])]
    return incidence(both[:, 0].contiguous(), node_count), incidence(both[:, 1].contiguous(), node_count)
