"""Reading node values at edges and summing edge values at nodes, deterministic in both directions of differentiation.

Each is the other's derivative. Sums run through `embedding_bag`, which adds up one node's edges at a time: on a CPU
it took a tenth of the time of `segment_reduce` and less than half of that of `index_add_` (33,000 edges, 128 wide).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from pb4u.network.graph.incidence import Incidence


def _bag_sums(values: Tensor, order: Tensor, offsets: Tensor, count: int) -> Tensor:
    if order.shape[0] == 0:
        return values.new_zeros(count, values.shape[1])
    # The operator itself: beside tiles that stay in cache, its Python wrapper takes a tenth of the time.
    return torch.embedding_bag(values, order, offsets, mode=0, include_last_offset=True)[0][:count]


class _Gather(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, nodes: Tensor, index: Tensor, order: Tensor, offsets: Tensor, count: int) -> Tensor:
        ctx.save_for_backward(order, offsets)
        ctx.count = count
        return nodes.index_select(0, index)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        order, offsets = ctx.saved_tensors
        return _bag_sums(gradients[0].contiguous(), order, offsets, ctx.count), None, None, None, None


class _SegmentSum(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, edges: Tensor, index: Tensor, order: Tensor, offsets: Tensor, count: int) -> Tensor:
        # Edges that are only room are last in the order.
        ctx.save_for_backward(index, order, offsets)
        ctx.count = count
        return _bag_sums(edges, order, offsets, count)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        index, order, offsets = ctx.saved_tensors
        back = gradients[0].index_select(0, index)
        if len(offsets) > ctx.count + 1:
            room = torch.arange(len(order), device=order.device) >= offsets[ctx.count]
            back = torch.where(torch.zeros_like(room).scatter(0, order, room)[:, None], 0.0, back)
        return back, None, None, None, None


def gather(nodes: Tensor, ends: Incidence) -> Tensor:
    """Values (edges, width) of the node at each edge's end, in the unit of `nodes`.

    Args:
        nodes: (nodes, width) values of any unit.
        ends: node at that end of each edge.
    """
    if not torch.is_grad_enabled():
        return nodes.index_select(0, ends.index)
    return _Gather.apply(nodes, ends.index, ends.order, ends.offsets, ends.node_count)  # type: ignore[no-untyped-call]


def segment_sum(edges: Tensor, ends: Incidence) -> Tensor:
    """Sums (nodes, width) over the edges that end at each node, in the unit of `edges`; zero where none does.

    Args:
        edges: (edges, width) values of any unit.
        ends: node at that end of each edge.
    """
    if not torch.is_grad_enabled():
        return _bag_sums(edges, ends.order, ends.offsets, ends.node_count)
    return _SegmentSum.apply(edges, ends.index, ends.order, ends.offsets, ends.node_count)  # type: ignore[no-untyped-call]
