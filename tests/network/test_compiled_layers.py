"""Compiled passes of training against the same layers in torch's own operations."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.network.test_pb4u_gnet import TINY, model_of, weights_gradients
from tests.network_scenes import DT, moment, prepared_for, sheet

from pb4u.network import interaction_block, layer_loops, mlp, propagation
from pb4u.network.graph.world_edges import WorldEdgeRule

USERS = (interaction_block, mlp, propagation)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-5)])
def test_gradients_are_those_of_the_plain_layers(monkeypatch, dtype, tolerance):
    configuration = replace(TINY, world_edges=WorldEdgeRule(radius=0.03, neighbours=12))
    model = model_of(configuration, dtype=dtype)
    # More edges than go through the layers at a time, and garments of two depths.
    at = moment([sheet(14, 16), sheet(7, 6, edge=0.02, seed=3)])
    prepared = prepared_for(model, at, steps=(5, 2), dtype=dtype)
    graph = prepared.graph(at.state, at.collider, DT)
    assert all(edges.edge_count > layer_loops.ROWS for edges in graph.edges.values())

    calls = []
    for user in USERS:
        known = user.are_compiled
        monkeypatch.setattr(user, "are_compiled", lambda *given, of=known: calls.append(of(*given)) or calls[-1])
    weighting = torch.randn(at.garments.vertex_count, 3, generator=torch.Generator().manual_seed(1)).to(dtype)
    result = model(graph, prepared)
    found = weights_gradients(model, (result * weighting).sum())
    assert calls
    assert all(calls), "the compiled passes were taken"
    for user in USERS:
        monkeypatch.setattr(user, "are_compiled", lambda *given: False)
    plain = model(graph, prepared)
    expected = weights_gradients(model, (plain * weighting).sum())

    assert (result - plain).abs().max() < tolerance * plain.abs().max()
    for name, gradient in found.items():
        bound = tolerance * float(expected[name].norm())
        assert float((gradient - expected[name]).norm()) < bound, name


def test_what_is_not_a_number_comes_through():
    perceptron = mlp.MLP(3, 16, 16, norm=True)
    values = torch.ones(4, 3)
    values[2, 1] = torch.nan
    finite = torch.isfinite(perceptron(values)).all(dim=1)
    assert finite.tolist() == [True, True, False, True]
