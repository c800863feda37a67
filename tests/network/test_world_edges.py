"""Both searches find what exhaustive search finds."""

from __future__ import annotations

import pytest
import torch

from pb4u.network.graph.world_edges import WorldEdgeRule, _nearest_by_chunks, _nearest_by_grid, nearest_within


def exhaustive(points, targets, rule):
    return [
        [t for t in row.argsort().tolist()[: rule.neighbours] if row[t] <= rule.radius]
        for row in torch.cdist(points, targets)
    ]


@pytest.mark.parametrize("search", [_nearest_by_grid, lambda p, t, r: _nearest_by_chunks(p, t, r, rows=7)])
@pytest.mark.parametrize("neighbours", [1, 3, 40])
@pytest.mark.parametrize("target_count", [1, 30])
def test_the_nearest_in_reach_are_found_nearest_first(search, neighbours, target_count):
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(25, 3, generator=generator, dtype=torch.float64) * 0.1
    targets = torch.rand(target_count, 3, generator=generator, dtype=torch.float64) * 0.1
    rule = WorldEdgeRule(0.03, neighbours)
    index, found = search(points, targets, rule)
    assert index.shape == found.shape == (25, neighbours)
    assert [row[mask].tolist() for row, mask in zip(index, found, strict=True)] == exhaustive(points, targets, rule)


@pytest.mark.parametrize("targets", [torch.zeros(0, 3), torch.full((4, 3), 9.0)])
def test_nothing_in_reach_is_no_edge(targets):
    index, found = nearest_within(torch.zeros(5, 3), targets, WorldEdgeRule())
    assert not bool(found.any())
    assert bool((index == 0).all())


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_point_that_is_not_finite_is_near_nothing_and_spoils_no_other(value):
    points = torch.zeros(3, 3)
    points[1, 2] = value
    _, found = nearest_within(points, torch.tensor([[0.01, 0.0, 0.0]]), WorldEdgeRule())
    assert found[:, 0].tolist() == [True, False, True]
