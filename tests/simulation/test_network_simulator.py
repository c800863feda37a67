"""A network rolled out: by itself, refined, and at a resolution it has not seen."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from ball_scene import ball_scene

from pb4u.errors import InputError, InputWarning, Pb4uError
from pb4u.measures.metrics import measure
from pb4u.network.acceleration_model import AccelerationModel, PreparedGarments
from pb4u.network.graph.graph import Graph
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.physics.time_step import TimeStep
from pb4u.simulation.checkpoint import TrainingRecord, load_checkpoint, save_checkpoint
from pb4u.simulation.first_frame import FirstFrame, OneLongStep, Settled
from pb4u.simulation.models import load_simulator
from pb4u.simulation.network_pass import NetworkPass, local_origins
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.stepwise_simulator import NetworkSimulator
from pb4u.simulation.timeline import Timeline

TINY = Pb4uConfiguration(width=16, blocks=2)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """A network that was never trained: what refinement has to survive."""
    torch.manual_seed(0)
    path = tmp_path / "tiny.safetensors"
    record = TrainingRecord(1 / 30, (0.01, 0.06), (1, 30))
    save_checkpoint(path, AccelerationModel(TINY.network()), TINY, record)
    return path


def test_untrained_network_with_solver_and_contact_does_not_diverge(weights: Path) -> None:
    simulator = NetworkSimulator(load_checkpoint(weights), refine=5, contact=ContactResponse(), first_frame=Settled())
    trajectory = simulator.simulate(ball_scene(frames=12))
    measured = measure(trajectory)
    assert not measured["diverged"]
    assert measured["metrics"]["strain_p95"]["max"] < 0.2
    assert measured["metrics"]["penetration_depth_max"]["max"] < 2e-3


@pytest.mark.parametrize(("refine", "expected"), [(2, 2), (0, 5)])  # by itself it makes the first state too
def test_where_a_solver_refines_it_leads_in_alone(
    weights: Path, monkeypatch: pytest.MonkeyPatch, refine: int, expected: int
) -> None:
    asked: list[int] = []
    correction = NetworkPass.correction

    def counted(own: NetworkPass, step: TimeStep, accelerations: torch.Tensor) -> torch.Tensor:
        asked.append(1)
        return correction(own, step, accelerations)

    monkeypatch.setattr(NetworkPass, "correction", counted)
    load_simulator(weights, refine=refine).simulate(ball_scene(frames=2, lead_in=3))
    assert len(asked) == expected


def test_a_lead_in_that_is_written_is_the_one_that_is_not(weights: Path) -> None:
    scene, simulator = ball_scene(frames=2, lead_in=3), load_simulator(weights, refine=2)
    written = simulator.simulate(replace(scene, frames=5, lead_in=0, kept_lead_in=3))
    np.testing.assert_array_equal(written.positions[3:], simulator.simulate(scene).positions)


def test_k_follows_the_resolution_and_can_be_overridden(weights: Path) -> None:
    checkpoint = load_checkpoint(weights)
    coarse, fine = ball_scene(cells=10), ball_scene(cells=20)
    steps = [NetworkSimulator(checkpoint).propagation_steps(scene) for scene in (coarse, fine)]
    lengths = [scene.garments[0].garment.mean_edge_length for scene in (coarse, fine)]
    assert steps == [int(0.225 / length + 1e-6) for length in lengths]
    assert NetworkSimulator(checkpoint, propagation_steps=7).simulate(coarse).metadata["propagation_steps"] == 7


def test_the_precision_of_products_is_chosen_told_and_close(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ball_scene(frames=3)
    found = {}
    for name in ("float32", "bfloat16"):
        simulator = load_simulator(weights, refine=0, precision=name)
        found[name] = simulator.simulate(scene)
        assert found[name].metadata["precision"] == name
    exact, rounded = (trajectory.positions.astype(float) for trajectory in found.values())
    # As a share of how far the cloth moved.
    assert 0 < np.abs(exact - rounded).max() < 0.02 * np.abs(exact[-1] - exact[0]).max()
    for has_units, expected in ((True, "bfloat16"), (False, "float32")):
        monkeypatch.setattr("pb4u.simulation.models.has_bfloat16_units", lambda _, found=has_units: found)
        assert load_simulator(weights).settings()["precision"] == expected
    with pytest.raises(InputError, match="no precision 'half'"):
        load_simulator(weights, precision="half")
    with pytest.raises(InputError, match="no device 'gpu0'"):
        load_simulator(weights, device="gpu0")


@pytest.mark.parametrize("steps", [0, 10_000])
def test_impossible_k_is_refused(weights: Path, steps: int) -> None:
    with pytest.raises(InputError, match=r"propagation_steps .*1 to 500"):
        load_simulator(weights, propagation_steps=steps)


def test_resolution_outside_the_range_seen_is_warned_of(weights: Path) -> None:
    checkpoint = load_checkpoint(weights)
    narrow = replace(checkpoint, record=replace(checkpoint.record, mean_edge_lengths=(0.001, 0.002)))
    with pytest.warns(InputWarning, match="coarser"):
        NetworkSimulator(narrow).simulate(ball_scene(frames=2))
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        NetworkSimulator(narrow, refine=1, first_frame=Settled()).simulate(ball_scene(frames=2))


def test_rollout_is_the_same_wherever_the_scene_stands(weights: Path) -> None:
    simulator = NetworkSimulator(load_checkpoint(weights))
    here = simulator.simulate(ball_scene(frames=5, speed=0.0))
    there = ball_scene(frames=5, speed=0.0)
    shift = np.array([8.0, 0.0, -6.0])
    body, worn = there.colliders[0], there.garments[0]
    body.rest_vertices = body.rest_vertices + shift
    worn = replace(worn, garment=replace(worn.garment, vertices=worn.garment.vertices + shift))
    from pb4u.garment.dressing import AttachedPlacement

    worn = replace(worn, placement=AttachedPlacement(worn.garment, body))
    moved = simulator.simulate(replace(there, garments=(worn,)))
    np.testing.assert_allclose(moved.positions - shift, here.positions, atol=2e-5)
    origin = local_origins(Timeline.of(there).step_from(Timeline.of(there).skinned_state(0)).collider, 1)
    assert torch.equal(origin * 16, (origin * 16).round())


def test_velocity_after_refinement_is_the_displacement(weights: Path) -> None:
    simulator = NetworkSimulator(load_checkpoint(weights), refine=3, first_frame=Settled())
    trajectory = simulator.simulate(ball_scene(frames=4, lead_in=0))
    displacement = (trajectory.positions[3] - trajectory.positions[2]) * 30.0
    np.testing.assert_allclose(trajectory.velocities[3], displacement, atol=1e-3)


@pytest.mark.parametrize("contact", [None, ContactResponse()])
@pytest.mark.parametrize("refine", [0, 2])
def test_frames_before_a_network_ran_away_are_kept(
    weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, contact: ContactResponse | None, refine: int
) -> None:
    checkpoint = load_checkpoint(weights)
    original, calls = checkpoint.model.forward, [0]

    def late(graph: Graph, prepared: PreparedGarments) -> torch.Tensor:
        calls[0] += 1
        return original(graph, prepared) * (torch.nan if calls[0] > 3 - bool(refine) else 1.0)

    monkeypatch.setattr(checkpoint.model, "forward", late)
    record = RunRecord()
    start: FirstFrame = Settled() if refine else OneLongStep()
    simulator = NetworkSimulator(checkpoint, refine=refine, contact=contact, first_frame=start)
    trajectory = simulator.simulate_to(ball_scene(frames=6, lead_in=0), tmp_path / "kept.npz", record)
    assert record.failed_at == trajectory.frame_count == 3
    assert all(np.isfinite(trajectory.positions[t]).all() for t in range(3))


def test_a_network_that_never_was_finite_writes_nothing(weights: Path, tmp_path: Path) -> None:
    checkpoint = load_checkpoint(weights)
    with torch.no_grad():
        for parameter in checkpoint.model.network.decoder.parameters():
            parameter.fill_(float("inf"))
    record = RunRecord()
    assert not list(NetworkSimulator(checkpoint).written_frames(ball_scene(frames=4, lead_in=0), record))
    assert record.failed_at == 0
    with pytest.raises(Pb4uError, match="in the very first frame"):
        NetworkSimulator(checkpoint).simulate_to(ball_scene(frames=4, lead_in=0), tmp_path / "none.npz")
    assert not (tmp_path / "none.npz").exists()
