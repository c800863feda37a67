"""Running statistics: what they hold, that they add up over devices, that they freeze."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from tests.network_scenes import DT, moment, prepared_for, sheet

from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.graph.features import Feature
from pb4u.network.normaliser import Normaliser
from pb4u.network.pb4u_gnet import Pb4uConfiguration

COLUMNS = (Feature("a", 2, "m", True, 1.0, "test"), Feature("b", 1, "1", False, 1.0, "test"))


def rows(count: int, seed: int, scale: float = 2.0, shift: float = 5.0) -> torch.Tensor:
    return shift + scale * torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))


def test_one_garment_gives_its_own_mean_and_spread_and_other_columns_pass():
    normaliser, values = Normaliser(COLUMNS), rows(50, 0)
    normaliser.gather(values, torch.zeros(50, dtype=torch.int64), 1)
    torch.testing.assert_close(normaliser.mean[:2], values[:, :2].mean(0))
    torch.testing.assert_close(normaliser.spread[:2], values[:, :2].std(0, correction=0))
    out = normaliser(values)
    torch.testing.assert_close(out[:, :2].mean(0), torch.zeros(2), atol=1e-5, rtol=0)
    assert torch.equal(out[:, 2], values[:, 2])
    torch.testing.assert_close(normaliser.restore(out), values)


def test_a_large_garment_weighs_no_more_than_a_small_one():
    normaliser = Normaliser(COLUMNS)
    values = torch.cat([torch.zeros(1000, 3), torch.ones(10, 3)])
    owner = torch.tensor([0] * 1000 + [1] * 10)
    normaliser.gather(values, owner, 2)
    torch.testing.assert_close(normaliser.mean[:2], torch.full((2,), 0.5))
    normaliser.gather(values[1000:], torch.zeros(10, dtype=torch.int64), 1)
    torch.testing.assert_close(normaliser.mean[:2], torch.full((2,), 2 / 3))


def test_a_garment_without_a_row_weighs_nothing():
    normaliser, values = Normaliser(COLUMNS), rows(10, 1)
    normaliser.gather(values, torch.zeros(10, dtype=torch.int64), 3)
    assert float(normaliser.sums[0]) == 1.0
    torch.testing.assert_close(normaliser.mean[:2], values[:, :2].mean(0))


def test_statistics_of_two_devices_add_up_to_those_of_one():
    one, first, second = (Normaliser(COLUMNS) for _ in range(3))
    owner = torch.zeros(30, dtype=torch.int64)
    for seed in range(4):
        one.gather(rows(30, seed), owner, 1)
        (first if seed % 2 else second).gather(rows(30, seed), owner, 1)
    first.sums += second.sums
    first.refresh()
    torch.testing.assert_close(first.mean, one.mean)
    torch.testing.assert_close(first.spread, one.spread)


def test_a_constant_column_is_not_blown_up():
    normaliser = Normaliser(COLUMNS)
    normaliser.gather(torch.full((9, 3), 1 / 3), torch.zeros(9, dtype=torch.int64), 1)
    assert float(normaliser(torch.full((1, 3), 1 / 3 + 1e-3)).abs().max()) < 0.5


def test_frozen_statistics_are_not_gathered_and_survive_saving():
    normaliser, other = Normaliser(COLUMNS), Normaliser(COLUMNS)
    normaliser.gather(rows(5, 0), torch.zeros(5, dtype=torch.int64), 1)
    normaliser.freeze()
    with pytest.raises(RuntimeError, match="frozen"):
        normaliser.gather(rows(5, 0), torch.zeros(5, dtype=torch.int64), 1)
    other.load_state_dict(normaliser.state_dict())
    assert torch.equal(other(rows(5, 1)), normaliser(rows(5, 1)))
    with pytest.raises(RuntimeError, match="frozen"):
        other.gather(rows(5, 0), torch.zeros(5, dtype=torch.int64), 1)


def test_a_model_gathers_every_normaliser_from_a_graph():
    at = moment([sheet(6, 7), sheet(9, 9, edge=0.02)])
    model = AccelerationModel(Pb4uConfiguration(width=4, blocks=0).network())
    graph = prepared_for(model, at, dtype=torch.float32).graph(at.state, at.collider, DT)
    acceleration = 1e-3 * torch.randn(at.garments.vertex_count, 3)
    model.gather_statistics(graph, acceleration)
    model.freeze_statistics()
    assert [float(normaliser.sums[0]) for normaliser in model.normalisers()] == [2.0, 2.0, 4.0, 2.0]
    offsets = at.garments.vertex_offsets
    means = [acceleration[start:stop].mean(0) for start, stop in pairwise(offsets)]
    torch.testing.assert_close(model.acceleration_normaliser.mean, 0.5 * (means[0] + means[1]))


def test_normalised_accelerations_come_back_in_metres_per_step_squared():
    at = moment([sheet(6, 7)], dtype=torch.float32)
    model = AccelerationModel(Pb4uConfiguration(width=4, blocks=1).network())
    prepared = model.prepare(at.garments)
    graph = prepared.graph(at.state, at.collider, DT)
    model.acceleration_normaliser.mean.copy_(torch.tensor([0.0, 1.0, 0.0]))
    model.acceleration_normaliser.spread.fill_(2.0)
    raw = model.network(model.normalised(graph), prepared.steps)
    expected = prepared.scale.wrinkles * (2.0 * raw + torch.tensor([0.0, 1.0, 0.0]))
    torch.testing.assert_close(model(graph, prepared), expected)
