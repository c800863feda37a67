"""Gathers and sums against their definitions, forward and backward."""

from __future__ import annotations

import torch

from pb4u.network.graph.incidence import incidence
from pb4u.network.segment import gather, segment_sum

INDEX = torch.tensor([4, 0, 2, 2, 4, 4, 0])


def test_values_and_derivatives_are_right():
    ends = incidence(INDEX, 6)
    nodes = torch.randn(6, 3, dtype=torch.float64, requires_grad=True)
    edges = torch.randn(7, 3, dtype=torch.float64, requires_grad=True)
    assert torch.equal(gather(nodes, ends), nodes[INDEX])
    torch.testing.assert_close(segment_sum(edges, ends), torch.zeros(6, 3).double().index_add(0, INDEX, edges))
    assert torch.autograd.gradcheck(lambda x: gather(x, ends), (nodes,))
    assert torch.autograd.gradcheck(lambda x: segment_sum(x, ends), (edges,))


def test_without_gradients_they_give_the_same():
    ends = incidence(INDEX, 6)
    nodes, edges = torch.randn(6, 3), torch.randn(7, 3)
    with torch.inference_mode():
        quick = gather(nodes, ends), segment_sum(edges, ends)
    assert torch.equal(quick[0], gather(nodes, ends))
    assert torch.equal(quick[1], segment_sum(edges, ends))


def test_no_edges_sum_to_zero():
    ends = incidence(torch.zeros(0, dtype=torch.int64), 3)
    edges = torch.zeros(0, 5, requires_grad=True)
    total = segment_sum(edges, ends)
    assert torch.equal(total, torch.zeros(3, 5))
    total.sum().backward()
    assert edges.grad.shape == (0, 5)
