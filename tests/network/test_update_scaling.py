"""Rules of update scaling: what the split keeps of bulk and of wrinkles, and another rule on trained weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from ball_scene import ball_scene
from tests.network_scenes import COTTON, sheet

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.network.acceleration_model import AccelerationModel, NetworkConfiguration
from pb4u.network.graph.features import MaterialRange
from pb4u.network.graph.garment_graph import GarmentGraph, garment_graph
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.registry import NETWORKS
from pb4u.network.surface_low_pass import SurfaceLowPass
from pb4u.network.update_scaling import (
    SCALINGS,
    BandSplitScaling,
    MeanScaling,
    NoScaling,
    PerVertexScaling,
    scaling_name,
    scaling_of,
    with_scaling,
)
from pb4u.scene.packed import PackedGarments, pack
from pb4u.simulation.checkpoint import Checkpoint, TrainingRecord
from pb4u.simulation.network_configuration import configuration_from_json, configuration_to_json
from pb4u.simulation.stepwise_simulator import NetworkSimulator
from pb4u.training.configuration import TrainingConfiguration, with_settings

SLANT = 0.8
"""Share of an edge by which rows are shifted: some angles are then obtuse."""


def graph_of(garments: PackedGarments) -> GarmentGraph:
    return garment_graph(garments, MaterialRange(), garments.dtype)


def slanted(rows: int, columns: int, edge: float) -> Garment:
    """A sheet sheared so far that edges have cotangents of less than nothing, with a tile by itself beside it."""
    even = sheet(rows, columns, edge)
    vertices = even.vertices + SLANT * even.vertices[:, 2:] * np.array([1.0, 0.0, 0.0])
    tile = np.array([[2.0, 1.0, 0.0], [2.0, 1.0, edge], [2.0 + edge, 1.0, 0.0]])
    faces = np.concatenate([even.faces, len(vertices) + np.array([[0, 1, 2]])])
    return Garment("slanted", np.concatenate([vertices, tile]), faces, COTTON)


def pinned(garments: PackedGarments, vertices: list[int]) -> PackedGarments:
    held = garments.pinned.clone()
    held[vertices] = True
    return replace(garments, pinned=held)


@pytest.mark.parametrize("waves", [1, 2, 6])
def test_a_wave_is_lowered_as_on_a_plane(waves: int) -> None:
    garments, length = pack([sheet(61, 5, edge=0.01)]), 0.03
    along = torch.as_tensor(garments.garments[0].vertices[:, :1])
    number = waves * np.pi / 0.6  # its slope is nothing at both ends, as that of what is not held
    wave = torch.cos(number * along)
    expected = 1.0 / (1.0 + (length * number) ** 2)
    assert float((SurfaceLowPass(garments, length)(wave) * wave).sum() / (wave * wave).sum()) == pytest.approx(
        expected, rel=0.03
    )


def test_factors_and_sweeps_agree_on_every_kind_of_mesh() -> None:
    garments = pinned(pack([sheet(9, 12, 0.02), slanted(10, 8, 0.01)]), [0, 1, 2, 150])
    values = torch.from_numpy(np.random.default_rng(0).standard_normal((garments.vertex_count, 3)))
    for length in (0.03, 0.09):
        exact = SurfaceLowPass(garments, length, sweeps=False)(values)
        swept = SurfaceLowPass(garments, length, sweeps=True)(values)
        assert float((swept - exact).norm() / exact.norm()) < 1e-4


@pytest.mark.parametrize("sweeps", [False, True])
def test_pieces_keep_their_own_motion(sweeps: bool) -> None:
    garments = pack([sheet(7, 8, 0.02), slanted(10, 8, 0.01)])
    piece = torch.zeros(garments.vertex_count, 1, dtype=torch.float64)
    piece[56:], piece[-3:] = 1.0, 2.0
    torch.testing.assert_close(SurfaceLowPass(garments, 0.09, sweeps)(piece), piece, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("sweeps", [False, True])
def test_beside_pins_nothing_is_long_and_what_is_predicted_at_them_tells_nothing(sweeps: bool) -> None:
    held = list(range(20))
    garments = pinned(pack([sheet(40, 20, 0.02)]), held)
    low_pass = SurfaceLowPass(garments, 0.09, sweeps)
    values = torch.ones(garments.vertex_count, 1, dtype=torch.float64)
    smooth = low_pass(values).reshape(40, 20)
    assert float(smooth[0].abs().max()) == 0.0
    # On a strip that is held at one end: 1 - exp(-x / l).
    along = 0.02 * torch.arange(40, dtype=torch.float64)
    torch.testing.assert_close(smooth[:20, 10], 1.0 - torch.exp(-along[:20] / 0.09), rtol=0.0, atol=0.02)
    values[held] = 100.0
    torch.testing.assert_close(low_pass(values), smooth.reshape(-1, 1), rtol=0.0, atol=1e-12)


def test_no_value_leaves_the_range_of_those_given() -> None:
    garments = pack([slanted(12, 12, 0.01)])
    spike = torch.zeros(garments.vertex_count, 1, dtype=torch.float64)
    spike[70] = 1.0
    smooth = SurfaceLowPass(garments, 0.02)(spike)
    assert float(smooth.min()) >= -1e-12
    assert float(smooth.max()) == float(smooth[70])
    torch.testing.assert_close(garments.vertex_areas @ smooth, garments.vertex_areas @ spike)


@pytest.mark.parametrize("sweeps", [False, True])
def test_training_sees_through_the_low_pass(sweeps: bool) -> None:
    garments = pack([slanted(4, 4, 0.02)])
    values = torch.from_numpy(np.random.default_rng(1).standard_normal((garments.vertex_count, 2))).requires_grad_()
    assert torch.autograd.gradcheck(SurfaceLowPass(garments, 0.03, sweeps), (values,))


def test_the_split_leaves_bulk_and_scales_wrinkles() -> None:
    garments = pack([sheet(40, 40, edge=0.01)])
    scale = scaling_of(BandSplitScaling(reference_length=0.04), garments, graph_of(garments))
    assert scale is not None
    fallen = torch.ones(garments.vertex_count, 3, dtype=torch.float64)
    torch.testing.assert_close(scale(fallen), fallen)
    rows, columns = torch.meshgrid(torch.arange(40), torch.arange(40), indexing="ij")
    creased = (1.0 - 2.0 * ((rows + columns) % 2)).reshape(-1, 1).to(fallen)
    left = scale(creased) / creased
    ruled = PerVertexScaling(0.04).factors(graph_of(garments))
    inside = torch.as_tensor(garments.garments[0].vertices[:, [0, 2]]).sub(0.195).abs().amax(dim=1) < 0.15
    assert float((left - ruled)[inside].abs().max()) < 0.01
    coarse = pack([sheet(8, 8, edge=0.05)])
    capped = scaling_of(BandSplitScaling(reference_length=0.04), coarse, graph_of(coarse))
    assert capped is not None
    assert float(capped.wrinkles.max()) == 1.0


def checkpoint(configuration: NetworkConfiguration, triangles: int = 98) -> Checkpoint:
    torch.manual_seed(0)
    record = TrainingRecord(1 / 30, (0.02, 0.06), (1, 30), 0, {"triangles": [triangles]})
    return Checkpoint("tiny", AccelerationModel(configuration.network()).eval(), configuration, record, "CC0-1.0")


TINY = Pb4uConfiguration(width=8, blocks=1, scaling=PerVertexScaling(0.045))


@pytest.mark.parametrize("name", ["mean", "none", "band-split"])
def test_rules_are_one_at_the_resolution_of_the_training_and_part_beyond(name: str) -> None:
    switched = checkpoint(TINY).scaling_in_use(name)
    assert switched is not None
    trained, fine = pack([sheet(8, 8, edge=0.04)]), pack([sheet(15, 15, edge=0.02)])
    there = switched.of(trained, graph_of(trained))
    mean = trained.mean_edge_lengths[0] / 0.045
    assert float(there.wrinkles.mean()) == pytest.approx(mean, rel=0.05)
    beyond, halved = switched.of(fine, graph_of(fine)), 0.5 * mean
    assert float(beyond.wrinkles.mean()) == pytest.approx(mean if name == "none" else halved, rel=0.05)
    fallen = torch.ones(fine.vertex_count, 3, dtype=torch.float64)
    bulk = halved if name == "mean" else mean
    assert float(beyond(fallen).mean()) == pytest.approx(bulk, rel=0.05)


def test_the_rule_of_the_training_is_left_as_it_was() -> None:
    assert checkpoint(TINY).scaling_in_use("per-vertex") is None
    assert checkpoint(TINY).scaling_in_use(None) is None
    garments = pack([sheet(6, 6)], torch.float32)
    graph = graph_of(garments)
    scale = scaling_of(PerVertexScaling(0.045), garments, graph)
    values = torch.randn(36, 3)
    assert scale is not None
    assert torch.equal(scale(values), (graph.incident_length / 0.045)[:, None] * values)
    assert scaling_of(NoScaling(), garments, graph) is None


def test_a_rollout_says_its_rule_and_follows_it() -> None:
    ruled, split = (
        NetworkSimulator(checkpoint(TINY), scaling=name).simulate(ball_scene(frames=2)) for name in (None, "none")
    )
    assert "scaling" not in ruled.metadata
    assert split.metadata["scaling"] == "none"
    assert not np.array_equal(ruled.positions, split.positions)


def test_a_training_takes_the_rule_by_its_name_and_its_checkpoint_says_so() -> None:
    begun = TrainingConfiguration(network=TINY)
    for name, kind in SCALINGS.items():
        network = with_settings(begun, [f"network.scaling={name}"]).network
        assert isinstance(network, Pb4uConfiguration)
        assert type(network.scaling) is kind
        assert getattr(network.scaling, "reference_length", 0.045) == 0.045
        again = configuration_from_json(configuration_to_json(network))
        assert again == network
        assert scaling_name(network.scaling) == name
    both = with_settings(begun, ["network.scaling=band-split", "network.scaling.low_pass_length=0.05"]).network
    assert isinstance(both, Pb4uConfiguration)
    assert both.scaling == BandSplitScaling(0.045, 0.05)
    assert with_scaling(NoScaling(), "mean") == MeanScaling()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: BandSplitScaling(low_pass_length=1.0), "below 1 m"),
        (lambda: BandSplitScaling(low_pass_length=0.0), "above 0"),
        (lambda: BandSplitScaling().low_pass(pack([sheet(4, 4, edge=0.1)])), "sheet: its edges are 1.. mm"),
        (lambda: NetworkSimulator(checkpoint(NETWORKS["mgn_small"]), scaling="none"), "tiny is not of Pb4U-GNet"),
        (lambda: with_settings(TrainingConfiguration(), ["network=mgn", "network.scaling=none"]), "no update scaling"),
        (lambda: with_settings(TrainingConfiguration(), ["network.scaling=means"]), "did you mean mean"),
    ],
)
def test_what_cannot_be_followed_is_refused(make: Callable[[], object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        make()
