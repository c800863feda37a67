"""Simulators: the same Scene in, the same kind of Trajectory out, kept when the state fails."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from ball_scene import Ball, ball_scene, sheet

from pb4u.collision.crossings import crossings, self_crossings
from pb4u.environment import Environment
from pb4u.errors import InputError, InputWarning, Pb4uError
from pb4u.garment.dressing import AttachedPlacement
from pb4u.measures.metrics import measure
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep
from pb4u.run import Run
from pb4u.scene.scene import DressedGarment
from pb4u.scene.state import State
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.first_frame import AsPlaced, OneLongStep, Settled
from pb4u.simulation.models import load_simulator, simulator_of
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.run_simulation import frame_count, roll_out
from pb4u.simulation.simulator import RunRecord, SkinningSimulator
from pb4u.simulation.step import StepMethod, Taken, take
from pb4u.simulation.stepwise_simulator import SolverSimulator, StepwiseSimulator
from pb4u.simulation.timeline import Timeline


class FreeFall(StepwiseSimulator):
    """Flight without any physics, turning to NaN at a frame."""

    name = "free fall"
    first_frame, contact, potential = AsPlaced(), None, IncrementalPotential()

    def __init__(self, fails_at: int | None = None) -> None:
        self.fails_at = fails_at

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        fails_at = self.fails_at

        class Failing:
            passes, further = 1, 0

            def correction(self, step: TimeStep, accelerations: torch.Tensor) -> torch.Tensor:
                return torch.full_like(accelerations, torch.nan if step.state.frame + 1 == fails_at else 0.0)

        return StepMethod(network=Failing())


@pytest.mark.parametrize(
    ("model", "options", "law"),
    [
        ("solver", {}, "coulomb"),
        ("quick-solver", {"refine": 3}, "coulomb"),
        ("quick-solver", {"friction_law": "paper"}, "paper"),
        ("pb4u-small", {}, "coulomb"),
        ("pb4u-small", {"refine": 0}, "paper"),
        ("pb4u-small", {"refine": 0, "friction_law": "coulomb"}, "coulomb"),
    ],
)
def test_friction_is_coulombs_where_the_solver_takes_part(model: str, options: dict[str, object], law: str) -> None:
    simulator = load_simulator(model, **options)
    assert simulator.settings()["friction_law"] == law
    assert simulator.header(ball_scene(2)).metadata["friction_law"] == law


@pytest.mark.parametrize(
    ("model", "options", "laws"),
    [
        ("quick-solver", {}, True),
        ("pb4u-small", {}, True),
        ("pb4u-small", {"refine": 0}, False),
        ("pb4u-small", {"refine": 0, "environment": Environment(wind=(0.0, 0.0, 2.0))}, True),
        ("solver", {"air": "off"}, False),
    ],
)
def test_cloth_meets_air_where_the_solver_takes_part(model: str, options: dict[str, Any], laws: bool) -> None:
    """And in a wind that is asked for."""
    assert simulator_of(Run(model=model, **options)).settings()["air"] is laws


def test_lead_in_is_simulated_but_not_written() -> None:
    scene = ball_scene(frames=5, lead_in=3)
    record, seen = RunRecord(), []
    frames = list(SkinningSimulator().written_frames(scene, record, lambda done, total: seen.append((done, total))))
    assert len(frames) == 5
    assert seen[-1] == (8, 8)
    np.testing.assert_allclose(frames[0].body_positions, scene.colliders[0].positions(3, 4)[0])


def test_skinning_carries_the_garment_with_the_body_at_its_speed() -> None:
    trajectory = SkinningSimulator().simulate(ball_scene(frames=6, lead_in=0, speed=0.3))
    moved = trajectory.positions[5] - trajectory.positions[0]
    np.testing.assert_allclose(moved, np.broadcast_to([5 / 30 * 0.3, 0, 0], moved.shape), atol=1e-5)
    np.testing.assert_allclose(trajectory.velocities[3, :, 0], 0.3, atol=1e-4)


def test_solver_drapes_the_sheet_without_stretch_or_penetration() -> None:
    trajectory = SolverSimulator(contact=ContactResponse()).simulate(ball_scene(frames=10))
    measured = measure(trajectory)
    assert not measured["diverged"]
    assert measured["metrics"]["strain_p95"]["max"] < 0.1
    assert measured["metrics"]["penetration_percent"]["max"] == 0.0
    fallen = trajectory.positions[-1, :, 1].min()
    assert fallen < 0.66, "the corners of the sheet should have fallen"
    assert trajectory.positions[-1, :, 1].max() > 0.69, "the middle of the sheet should rest on the ball"


def test_quick_solver_drapes_the_sheet_as_the_solver_does_in_fewer_iterations() -> None:
    scene = ball_scene(frames=20)
    quick, full = load_simulator("quick-solver", refine=5), load_simulator("solver")
    fallen, exact = quick.simulate(scene), full.simulate(scene)
    assert np.abs(fallen.positions[-1] - exact.positions[-1]).mean() < 2e-3
    assert measure(fallen)["metrics"]["strain_p95"]["max"] < 1.05 * measure(exact)["metrics"]["strain_p95"]["max"]
    with pytest.raises(InputError, match="1 iteration a step or more, not 0"):
        load_simulator("quick-solver", refine=0)


def test_a_body_that_leaps_a_metre_leaves_the_sheet_behind_whole() -> None:
    class Leaping(Ball):
        def positions(self, start: int, stop: int) -> torch.Tensor:
            placed = super().positions(start, stop)
            placed[np.arange(start, stop) >= 5, :, 0] += 1.0
            return placed

    body, cloth = Leaping(10), sheet(8)
    scene = replace(
        ball_scene(8, cells=8), garments=(DressedGarment(cloth, AttachedPlacement(cloth, body)),), colliders=(body,)
    )
    record = RunRecord()
    trajectory = Trajectory.collect(
        load_simulator("quick-solver").header(scene), load_simulator("quick-solver").written_frames(scene, record)
    )
    assert record.failed_at is None
    strains = measure(trajectory)["metrics"]["strain_max"]["per_frame"]
    assert strains[-1] < 0.3, "the side of the ball strikes it once"
    for x, solid in zip(trajectory.positions, trajectory.body_positions, strict=True):
        assert not len(crossings(x, cloth.faces, solid, body.faces))


def test_run_record_says_what_the_solver_did() -> None:
    record = RunRecord()
    list(SolverSimulator().written_frames(ball_scene(frames=3, lead_in=0), record))
    assert len(record.step_seconds) == 3
    assert record.ms_per_step > 0
    assert len(record.solver_iterations) == 2


def test_a_failure_is_told_in_frames_of_the_scenes_own_rate() -> None:
    simulator, record = FreeFall(fails_at=5), RunRecord()
    run = Run(frames=16, fps=60.0)
    trajectory = roll_out(run, simulator, ball_scene(frames=8, lead_in=0), record=record)
    assert record.failed_at == trajectory.frame_count == 9


def test_a_run_that_is_lost_in_its_lead_in_says_so_however_it_is_kept(tmp_path: Path) -> None:
    scene, simulator, says = ball_scene(frames=8, lead_in=4), FreeFall(fails_at=2), "2 frames before the first one"
    with pytest.raises(Pb4uError, match=says):
        simulator.simulate(scene)
    with pytest.raises(Pb4uError, match=says):
        roll_out(Run(frames=8), simulator, scene)
    with pytest.raises(Pb4uError, match=says):
        roll_out(Run(frames=8), simulator, scene, tmp_path / "a.npz")


def test_the_frames_of_a_run_are_known_before_it() -> None:
    scene = ball_scene(frames=8, lead_in=0)
    for run in (Run(fps=60.0), Run(frames=9, fps=60.0), Run(fps=24.0), Run(frames=8)):
        assert roll_out(run, SkinningSimulator(), scene).frame_count == frame_count(run, scene)


@pytest.mark.parametrize(("lead_in", "fps"), [(1, 60), (3, 60), (7, 24), (30, 25), (31, 60), (None, 50)])
@pytest.mark.parametrize("kept", [False, True])
def test_a_kept_lead_in_is_counted_and_told_at_the_rate_that_is_written(
    lead_in: int | None, fps: float, kept: bool
) -> None:
    run = Run(fps=fps, keep_lead_in=kept, frames=5, lead_in=lead_in)
    simulated = run.at_rate(30.0)
    led = simulated.led_frames
    scene = ball_scene(simulated.frames + (led if kept else 0), 0 if kept else led, cells=2)
    assert frame_count(run, scene) == run.written_frames
    trajectory = roll_out(run, SkinningSimulator(), scene)
    assert trajectory.frame_count == run.written_frames == 5 + kept * run.led_frames
    assert trajectory.metadata["lead_in"] == (0 if kept else pytest.approx(run.led_frames, abs=1))


@pytest.mark.parametrize(("self_contact", "pinned"), [(True, False), (True, True), (False, False)])
def test_frames_between_those_that_are_simulated_are_untangled_where_cloth_feels_cloth(
    self_contact: bool, pinned: bool
) -> None:
    """A strip passes the border of a sheet: above it, then beneath it, and half-way straight through."""
    sheets = [sheet(), sheet(4, side=0.1, height=0.0)]
    x = sheets[1].vertices[:, 0]
    sheets[1] = replace(
        sheets[1], vertices=sheets[1].vertices + np.array([0.25, 0.732, 0.013]) + np.outer(x, [0, 0.2, 0])
    )
    worn = [each.with_pins(np.full(len(each.vertices), pinned)) for each in sheets]
    scene = ball_scene(frames=2, lead_in=0)
    dressed = tuple(DressedGarment(each, AttachedPlacement(each, scene.colliders[0])) for each in worn)
    scene = replace(scene, garments=dressed)
    above = torch.from_numpy(np.concatenate([each.vertices for each in worn]))
    beneath = above - 0.05 * (torch.arange(len(above)) >= len(worn[0].vertices))[:, None] * torch.tensor(
        [0.0, 1.0, 0.0]
    )
    states = [State(at, torch.zeros_like(at), frame) for frame, at in enumerate((above, beneath))]
    simulator = load_simulator("quick-solver", self_contact=self_contact)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", InputWarning)
        made = roll_out(Run(fps=60.0, frames=3), simulator, scene, simulated=states)
    counts = [len(self_crossings(at, made.faces, sharing=True)) for at in np.asarray(made.positions)]
    assert (counts[0], counts[2]) == (0, 0)
    assert (counts[1] > 0) == (pinned or not self_contact)
    said = [str(each.message) for each in told]
    assert bool(said) == pinned
    assert all(f"in 1 of 3 frames, in {counts[1]} pairs" in each for each in said)
    for number in (0, 2):
        np.testing.assert_array_equal(made.positions[number], states[number // 2].positions.numpy().astype(np.float32))


def test_what_was_simulated_is_kept_when_the_state_fails(tmp_path: Path) -> None:
    record = RunRecord()
    trajectory = FreeFall(fails_at=7).simulate_to(ball_scene(frames=8, lead_in=2), tmp_path / "a.npz", record)
    assert record.failed_at == 5
    assert trajectory.frame_count == 5
    assert np.isfinite(trajectory.positions).all()


def test_a_step_changes_nothing_that_it_was_given() -> None:
    scene = ball_scene()
    timeline = Timeline.of(scene)
    state = timeline.skinned_state(0)
    before = state.positions.clone(), state.velocities.clone()
    method = SolverSimulator(contact=ContactResponse()).method(timeline, RunRecord())
    after = take(timeline.step_from(state), method).state
    assert torch.equal(state.positions, before[0])
    assert torch.equal(state.velocities, before[1])
    assert after.frame == 1


def test_pins_follow_the_body() -> None:
    scene = ball_scene(frames=4, lead_in=0)
    pinned = np.zeros(len(scene.garments[0].garment.vertices), dtype=bool)
    pinned[:11] = True
    worn = scene.garments[0].garment.with_pins(pinned)
    scene = replace(scene, garments=(replace(scene.garments[0], garment=worn),))
    trajectory = SolverSimulator().simulate(scene)
    skinned = scene.garments[0].placement.positions(3, 4)[0].numpy()
    np.testing.assert_allclose(trajectory.positions[3, :11], skinned[:11], atol=1e-6)


def test_settling_lowers_the_sheet_and_leaves_it_at_rest() -> None:
    timeline, method = Timeline.of(ball_scene()), StepMethod(contact=ContactResponse())
    settled = Settled().start(timeline, method).state
    assert settled.frame == 0
    assert float(settled.positions[:, 1].min()) < 0.62
    assert float(settled.velocities.abs().max()) == 0.0
    flown = OneLongStep().start(timeline, method).state
    torch.testing.assert_close(flown.positions, timeline.skinned(0))


def test_settling_goes_on_until_every_garment_is_still(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small garment still falls when the mean over it and a large one that lies is below the limit."""
    scene, small = ball_scene(), sheet(1, side=0.05, height=0.9)
    worn = (*scene.garments, DressedGarment(small, AttachedPlacement(small, scene.colliders[0])))
    timeline, steps = Timeline.of(replace(scene, garments=worn)), list[int]()
    falls = timeline.garments.vertex_garment == 1

    def taken(step: TimeStep, _: StepMethod) -> Taken:
        steps.append(len(steps))
        by = 3e-3 if len(steps) < 4 else 1e-3
        fallen = step.state.positions - by * falls[:, None] * torch.tensor([0.0, 1.0, 0.0])
        return Taken(replace(step.state, positions=fallen))

    monkeypatch.setattr("pb4u.simulation.first_frame.take", taken)
    Settled().start(timeline, StepMethod())
    assert len(steps) == 4


def test_scene_is_repeatable() -> None:
    first, second = (SolverSimulator().simulate(ball_scene(frames=3)) for _ in range(2))
    np.testing.assert_array_equal(first.positions, second.positions)


def test_unknown_model_lists_near_names() -> None:
    with pytest.raises(InputError, match="did you mean solver"):
        load_simulator("sovler")
    with pytest.raises(InputError, match="no model file"):
        load_simulator("absent.safetensors")
    with pytest.raises(InputError, match="from 0 to 10,000"):
        load_simulator("solver", refine=-1)
