"""The compiled network against its twin in torch, and its products against torch's."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
import torch
from tests.network.test_pb4u_gnet import FORMS, model_of
from tests.network_scenes import DT, moment, prepared_for, sheet

from pb4u.network.graph.world_edges import WorldEdgeRule
from pb4u.network.kernels.compiled_mlp import as_array
from pb4u.network.kernels.compiled_pb4u_gnet import CompiledPb4uGNet
from pb4u.network.kernels.products import multiplies_in, multiply, packed
from pb4u.network.pb4u_gnet import Pb4uConfiguration

SMALL = Pb4uConfiguration(width=64, blocks=3)
needs_matrix_units = pytest.mark.skipif(not multiplies_in(torch.bfloat16), reason="no matrix units for bfloat16")
needs_vectors = pytest.mark.skipif(not multiplies_in(torch.float32), reason="no vectors of 16 numbers")
PRECISIONS = [pytest.param(torch.float32, marks=needs_vectors), pytest.param(torch.bfloat16, marks=needs_matrix_units)]


@numba.njit
def compiled_product(values, weight, out):
    multiply(values, weight, out)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("rows", "inputs", "outputs"), [(1, 64, 64), (5, 32, 3), (16, 128, 64), (203, 64, 130)])
def test_products_are_those_of_torch(precision, rows, inputs, outputs):
    generator = torch.Generator().manual_seed(rows)
    values, weight = (torch.randn(n, inputs, generator=generator).to(precision) for n in (rows, outputs))
    # Rows that lie apart, as those of nodes among the sums that enter with them.
    apart = torch.full((rows, 2 * inputs), torch.nan, dtype=precision)
    apart[:, :inputs] = values
    blocks = packed(weight.float(), precision)
    out = np.full((rows + 1, 64 * len(blocks)), np.nan, np.float32)
    compiled_product(as_array(apart)[:, :inputs], blocks, out[:rows])
    expected = values.double() @ weight.double().t()
    np.testing.assert_allclose(out[:rows, :outputs], expected, rtol=0, atol=1e-5 * inputs**0.5)
    assert (out[:rows, outputs:] == 0).all()
    assert np.isnan(out[rows]).all(), "nothing is written beyond the rows"


@pytest.mark.parametrize("form", [name for name, form in FORMS.items() if not form.message_norm])
@pytest.mark.parametrize("neighbours", [1, 3])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_it_computes_what_its_twin_does(form, neighbours, precision, monkeypatch):
    monkeypatch.setattr("pb4u.network.kernels.compiled_block.TILE_ROWS", 150)
    monkeypatch.setattr("pb4u.network.kernels.compiled_mlp.TILE_ROWS", 150)
    configuration = replace(SMALL, propagation=FORMS[form], world_edges=WorldEdgeRule(neighbours=neighbours))
    exact = model_of(configuration, dtype=torch.float32)
    at = moment([sheet(9, 12), sheet(7, 6, edge=0.02, seed=3)], dtype=torch.float32)
    prepared = prepared_for(exact, at, steps=(4, 2), dtype=torch.float32)
    graph = prepared.graph(at.state, at.collider, DT)
    compiled = exact.for_inference(precision)
    assert isinstance(compiled.network, CompiledPb4uGNet)
    expected = exact(graph, prepared).detach()
    with torch.inference_mode():
        found = compiled(graph, prepared)
    assert float((found - expected).abs().max() / expected.abs().max()) < (1e-5 if precision == torch.float32 else 0.02)
    assert torch.equal(found, compiled(graph, prepared)), "the graph is left as it was"


def test_without_a_body_near_it_runs_on_the_garment_alone():
    exact = model_of(SMALL, dtype=torch.float32)
    at = moment([sheet(6, 7)], body=False, dtype=torch.float32)
    prepared = prepared_for(exact, at, steps=3, dtype=torch.float32)
    graph = prepared.graph(at.state, None, DT)
    torch.testing.assert_close(exact.for_inference()(graph, prepared), exact(graph, prepared), rtol=0, atol=1e-8)


def test_what_is_no_number_is_not_hidden():
    exact = model_of(SMALL, dtype=torch.float32)
    at = moment([sheet(6, 7)], dtype=torch.float32)
    prepared = prepared_for(exact, at, steps=3, dtype=torch.float32)
    velocities = at.state.velocities.clone()
    velocities[3] = torch.nan
    graph = prepared.graph(replace(at.state, velocities=velocities), at.collider, DT)
    assert bool(exact.for_inference()(graph, prepared)[3].isnan().all())


def test_a_form_or_width_that_is_not_compiled_is_left_to_torch():
    for configuration in (replace(SMALL, width=16), replace(SMALL, propagation=FORMS["release"])):
        network = model_of(configuration, dtype=torch.float32).for_inference().network
        assert not isinstance(network, CompiledPb4uGNet)
