"""Energy above a step's minimum: what ranks methods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ball_scene import ball_scene

from pb4u.errors import InputError
from pb4u.measures.excess import Reference, distance_to, excess_heights, series
from pb4u.measures.metrics import measure
from pb4u.measures.run_report import run_report
from pb4u.network.acceleration_model import GraphNetwork
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.paper.controls import GRADIENT_DESCENT, WARM_START, ControlSimulator
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.stepwise_simulator import SolverSimulator
from pb4u.simulation.timeline import Timeline

LIKE = Pb4uConfiguration(
    width=4, blocks=0, passes=2, conjugate=True, further_passes=8, warm_start_shares=(0.25, 0.5, 0.75, 1.0)
)


@pytest.fixture(scope="module")
def solved() -> Trajectory:
    return SolverSimulator().simulate(ball_scene(frames=5, speed=0.0))


@pytest.fixture(scope="module")
def reference() -> Reference:
    timeline = Timeline.of(ball_scene(frames=8))
    return Reference.of(IncrementalPotential(), timeline, timeline.skinned_state(0), 8, every=2)


def floating(like: Trajectory) -> Trajectory:
    """The sheet at rest in the air, 1 m above where it lies, in every frame."""
    still = np.repeat((like.header.rest_positions + [0.0, 1.0, 0.0])[None], like.frame_count, axis=0)
    return replace(like, positions=still.astype(np.float32), velocities=np.zeros_like(like.velocities))


def without_gravity(trajectory: Trajectory) -> float:
    metrics = measure(trajectory)["metrics"]
    return float(metrics["total"]["mean"] - metrics["gravity"]["mean"])


def test_floating_cloth_wins_by_energy_without_gravity_and_loses_by_excess_height(solved: Trajectory) -> None:
    afloat = floating(solved)
    assert without_gravity(afloat) < 0.01 * without_gravity(solved)
    excess, of_solver = excess_heights(afloat)[1:], excess_heights(solved)[1:]
    # It should have fallen by g dt^2, which costs inertia half of what it frees.
    assert excess == pytest.approx([9.81 / 30**2 / 2] * len(excess), rel=1e-3)
    assert max(of_solver) < 0.01 * min(excess)


def test_the_first_frame_and_what_is_not_finite_have_no_excess(solved: Trajectory) -> None:
    broken = np.array(solved.positions)
    broken[3, 0] = np.nan
    heights = excess_heights(replace(solved, positions=broken))
    assert [bool(np.isnan(height)) for height in heights] == [True, False, False, True, True]
    measured = series(heights)
    assert measured["max"] == max(heights[1:3])


def test_on_shared_states_the_solver_leaves_nothing_and_the_controls_follow_in_order(reference: Reference) -> None:
    assert len(reference.shared) == 3

    def mean(simulator: SolverSimulator | ControlSimulator) -> float:
        heights = reference.excess(simulator.method(reference.timeline, RunRecord()))
        return float(np.mean(heights))

    network: GraphNetwork = LIKE.network()
    start, descent = (mean(ControlSimulator(name, network)) for name in (WARM_START, GRADIENT_DESCENT))
    refined = mean(ControlSimulator(WARM_START, network, refine=5))
    assert abs(mean(SolverSimulator())) < 1e-6
    assert 1e-5 < descent < 0.8 * start
    assert refined < descent


def test_a_result_below_the_reference_stays_negative(reference: Reference) -> None:
    weight = float(reference.timeline.garments.world_weights.sum())
    worse = replace(reference, shared=tuple(replace(s, least=s.least + 1e-3 * weight) for s in reference.shared))
    heights = worse.excess(SolverSimulator().method(worse.timeline, RunRecord()))
    assert heights == pytest.approx([-1e-3] * 3, abs=1e-6)


def test_passes_of_gradient_descent_are_those_of_its_network() -> None:
    network = LIKE.network()
    timeline = Timeline.of(ball_scene())
    method = ControlSimulator(GRADIENT_DESCENT, network).method(timeline, RunRecord())
    assert (method.network.passes, method.network.further) == (2, 8)
    assert ControlSimulator(GRADIENT_DESCENT, network, passes=3).method(timeline, RunRecord()).network.further == 0
    assert ControlSimulator(WARM_START, network).method(timeline, RunRecord()).network is None
    assert ControlSimulator(WARM_START, network).settings()["passes"] == 0


def test_distances_are_the_mean_over_vertices_and_other_meshes_are_refused(solved: Trajectory) -> None:
    moved = replace(solved, positions=np.array(solved.positions) + np.float32([0.003, 0.0, 0.004]))
    assert distance_to(moved, solved) == pytest.approx([5e-3] * solved.frame_count, rel=1e-4)
    short = replace(solved, positions=solved.positions[:2], velocities=solved.velocities[:2])
    with pytest.raises(InputError, match="has 2 frames, fewer than the 5"):
        distance_to(moved, short)
    other = SolverSimulator(1).simulate(ball_scene(frames=1, lead_in=0, cells=4))
    with pytest.raises(InputError, match="another mesh: 32 triangles"):
        distance_to(moved, other)


def test_a_report_has_both_where_they_are_asked_for(solved: Trajectory) -> None:
    scene = ball_scene(frames=5, speed=0.0)
    report = run_report(solved, SolverSimulator(), scene, RunRecord(), excess=True, reference=solved)
    assert report["metrics"]["distance_to_reference"]["max"] == 0.0
    assert report["metrics"]["excess_height"]["max"] < 1e-4
    assert report["frames_below_reference"] == 0
    assert "excess_height" not in run_report(solved, SolverSimulator(), scene, RunRecord())["metrics"]
