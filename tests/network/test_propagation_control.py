"""How many steps, and how large."""

from __future__ import annotations

import pytest
import torch
from tests.network_scenes import sheet

from pb4u.errors import InputError
from pb4u.network.graph.features import MaterialRange
from pb4u.network.graph.garment_graph import garment_graph
from pb4u.network.propagation_control import ConstantDistance, FixedSteps
from pb4u.network.update_scaling import MeanScaling, NoScaling, PerVertexScaling
from pb4u.scene.packed import pack


@pytest.mark.parametrize(("length", "steps"), [(0.015, 15), (0.0113, 19), (0.0076, 29), (0.225, 1), (3.0, 1)])
def test_the_papers_rule(length, steps):
    assert ConstantDistance(0.225).steps(length) == steps


def test_fixed_steps_ignore_the_resolution():
    assert {FixedSteps(7).steps(length) for length in (0.001, 0.1)} == {7}


def test_senseless_controls_are_refused():
    for make in (
        lambda: ConstantDistance(0.0),
        lambda: ConstantDistance(float("nan")),
        lambda: FixedSteps(0),
    ):
        with pytest.raises(InputError):
            make()


def test_scaling_per_vertex_is_the_mean_of_its_rest_edges():
    garments = [sheet(4, 5), sheet(5, 5, edge=0.03)]
    packed = pack(garments)
    static = garment_graph(packed, MaterialRange(), torch.float64)
    edges, lengths = packed.edges, packed.edge_lengths
    expected = [lengths[(edges == vertex).any(dim=1)].mean() / 0.015 for vertex in range(packed.vertex_count)]
    torch.testing.assert_close(PerVertexScaling(0.015).factors(static)[:, 0], torch.stack(expected))
    mean = MeanScaling(0.01).factors(static)[:, 0]
    torch.testing.assert_close(mean[:20], torch.full((20,), garments[0].mean_edge_length / 0.01, dtype=torch.float64))
    torch.testing.assert_close(mean[20:], torch.full((25,), garments[1].mean_edge_length / 0.01, dtype=torch.float64))
    assert NoScaling().factors(static) is None
