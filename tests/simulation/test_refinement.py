"""A prediction refined by the solver, and made again where iterations do not mend it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from ball_scene import ball_scene, sheet
from test_pierced_edges import pierced

from pb4u.garment.dressing import AttachedPlacement
from pb4u.geometry.principal_stretch import face_strains
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.implicit_steps import free_flight
from pb4u.physics.solver.newton_solver import Solution, Solver
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.time_step import TimeStep
from pb4u.scene.scene import DressedGarment
from pb4u.scene.state import State
from pb4u.simulation import refinement
from pb4u.simulation.first_frame import Settled
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.pierced_edges import newly_pierced
from pb4u.simulation.refinement import ImplicitSteps, SafeguardedRefinement, SolverRefinement, past_bodies
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod
from pb4u.simulation.timeline import Timeline

POTENTIAL = IncrementalPotential().with_self_contact()


def first_step(speed: float, potential: IncrementalPotential = POTENTIAL) -> TimeStep:
    """The first step of a sheet that lies on a ball, which begins to move at `speed` [m/s]."""
    timeline = Timeline.of(ball_scene(speed=speed))
    method = StepMethod(contact=ContactResponse(), potential=potential)
    return timeline.step_from(Settled().start(timeline, method).state)


def left_behind(step: TimeStep) -> State:
    """A prediction that knows nothing of the ball: free flight."""
    return replace(step.state, positions=free_flight(step))


def test_a_prediction_near_balance_is_only_refined() -> None:
    made: list[int] = []
    step = first_step(speed=0.3)
    result = SafeguardedRefinement(POTENTIAL, 5, lambda _: made.append(1)).refine(step, left_behind(step))
    refined = SolverRefinement(POTENTIAL, 5, Solver(refinement._NEAR_BALANCE)).refine(step, left_behind(step))
    assert torch.equal(result.positions, refined.positions)
    assert not made


def test_a_prediction_that_iterations_leave_torn_is_made_anew() -> None:
    made: list[int] = []
    step = first_step(speed=4.0)
    refined = SolverRefinement(POTENTIAL, 1).refine(step, left_behind(step))
    garments = step.garments
    assert face_strains(refined.positions, garments.faces, garments.inverse_rest_shape).max() > 0.6
    result = SafeguardedRefinement(POTENTIAL, 1, lambda solved: made.append(solved.iterations)).refine(
        step, left_behind(step)
    )
    assert made == [refinement._MOST_PRESSING], "these leave nothing strained"
    solved, energies = ImplicitSteps(POTENTIAL).refine(step, step.state), POTENTIAL.of(step).energies
    over = [float(energies(x.positions).total - energies(solved.positions).total) for x in (refined, result)]
    assert over[1] < 0.1 * over[0]


@pytest.mark.parametrize(("freed", "counted"), [(0.9e-3, []), (1.3e-3, [1])])
def test_strained_cloth_that_iterations_free_of_nothing_is_left(
    monkeypatch: pytest.MonkeyPatch, freed: float, counted: list[int]
) -> None:
    """A tight shirt: strained in every step, far from balance at a few vertices, and with no energy to lose."""
    made: list[int] = []
    step = first_step(speed=4.0)
    refining = SafeguardedRefinement(POTENTIAL, 1, lambda _: made.append(1))
    torn = replace(refining.solver.minimise(POTENTIAL.of(step), left_behind(step).positions, 1), decrease=freed)
    assert torn.residual > refinement._BALANCED
    monkeypatch.setattr(refining.solver, "minimise", lambda *_, **__: torn)
    refining.refine(step, left_behind(step))
    assert made == counted
    # Nor is cloth made again that was strained where the step began.
    strained = replace(step, state=replace(step.state, positions=torn.positions))
    refining.refine(strained, left_behind(step))
    assert made == counted


def test_a_prediction_that_iterations_leave_hooked_is_made_anew() -> None:
    made: list[int] = []
    step, _ = pierced(-0.08, 0.0)
    refined = SolverRefinement(POTENTIAL, 1).refine(step, step.state)
    assert newly_pierced(step, refined.positions) > 0
    result = SafeguardedRefinement(POTENTIAL, 1, lambda solved: made.append(solved.converged)).refine(step, step.state)
    assert made == [True], "to the rough tolerance"
    assert newly_pierced(step, result.positions) == 0


def test_what_a_push_leaves_inside_the_body_is_pressed_out_and_gains_no_speed() -> None:
    step, contact = first_step(speed=0.3), ContactResponse()
    settled = SolverRefinement(POTENTIAL).refine(step, left_behind(step))
    refinement, centre = SolverRefinement(POTENTIAL, 5), step.bodies.following.positions.mean(0)
    assert refinement.respond_with_cloth(step, settled, contact) is settled, "nothing is inside"
    inside = replace(settled, positions=settled.positions + 0.04 * (centre - settled.positions))
    depth = contact.depth(step, inside.positions)
    assert depth > 5e-3
    pressed = refinement.respond_with_cloth(step, inside, contact)
    assert contact.depth(step, pressed.positions) < 0.2 * depth
    assert pressed.velocities is inside.velocities


@pytest.mark.parametrize(("left", "best"), [(0.0, "smoothed"), (0.3, "smoothed"), (0.3, "solved"), (2.0, "turned")])
def test_cloth_that_bodies_turned_aside_is_smoothed_or_solved_anew_and_the_least_strained_kept(
    monkeypatch: pytest.MonkeyPatch, left: float, best: str
) -> None:
    """The whole step is solved where smoothing leaves much."""
    potential, starts = IncrementalPotential().with_self_contact(bodies=True), list[torch.Tensor]()
    record = RunRecord(solver_iterations=[7, 2])
    step = first_step(4.0, potential)
    refining = SolverRefinement(potential, 5, retried=record.count_retried)
    behind = step.reached(free_flight(step))
    turned = past_bodies(potential.self_contact, step, behind, apart=True)
    assert float((turned.positions - behind.positions).norm(dim=1).max()) > refinement._TURNED_ASIDE
    strained = refinement._failed_faces(step, turned.positions)
    assert strained > refinement._failed_faces(step, behind.positions)
    faces, solves = len(step.garments.faces), {"smoothed": refining._local, "solved": refining._pressing}
    shares = {"turned": 0.5, "smoothed": left, "solved": 0.1 if best == "solved" else 1.0}
    results = {"turned": turned.positions}

    def noting(name: str) -> Callable[..., Solution]:
        solve = solves[name].minimise

        def noted(of: StepPotential, start: torch.Tensor, *rest: object, **named: object) -> Solution:
            starts.append(start)
            solved = solve(of, start, *rest, **named)
            results[name] = solved.positions
            return solved

        return noted

    def are_failed(_: TimeStep, x: torch.Tensor) -> torch.Tensor:
        share = next((shares[name] for name, result in results.items() if torch.equal(result, x)), 0.0)
        return torch.arange(faces) < share * faces

    for name, solver in solves.items():
        monkeypatch.setattr(solver, "minimise", noting(name))
    monkeypatch.setattr(refinement, "_are_failed", are_failed)
    kept = refining.pressed_past_bodies(step, behind)
    assert torch.equal(starts[0], turned.positions)
    assert len(starts) == (2 if left else 1)
    assert torch.equal(kept.positions, results[best])
    assert record.retried == 1
    assert record.solver_iterations[0] == 7
    assert record.solver_iterations[1] > 2


@pytest.mark.parametrize(("strained_before", "retried"), [(0, 1), (1, 1), (2, 0), (3, 0)])
def test_cloth_is_smoothed_where_more_of_it_is_strained_than_before_bodies_turned_it_aside(
    monkeypatch: pytest.MonkeyPatch, strained_before: int, retried: int
) -> None:
    potential, record = IncrementalPotential().with_self_contact(bodies=True), RunRecord()
    step = first_step(4.0, potential)
    refining = SolverRefinement(potential, 5, retried=record.count_retried)
    behind = step.reached(free_flight(step))

    def are_failed(_: TimeStep, x: torch.Tensor) -> torch.Tensor:
        return torch.arange(len(step.garments.faces)) < (strained_before if x is behind.positions else 2)

    monkeypatch.setattr(refinement, "_are_failed", are_failed)
    refining.pressed_past_bodies(step, behind)
    assert record.retried == retried


@pytest.mark.parametrize(("before", "after", "solved"), [(0, 0, "turned"), (9, 9, "turned"), (0, 9, "solved")])
def test_the_whole_step_is_solved_where_bodies_were_let_through_cloth(
    monkeypatch: pytest.MonkeyPatch, before: int, after: int, solved: str
) -> None:
    """Cloth that a limb has come through need not be strained, and no later step leads it back."""
    potential = IncrementalPotential().with_self_contact(bodies=True)
    step = first_step(4.0, potential)
    refining, behind = SolverRefinement(potential, 5), step.reached(free_flight(step))
    turned = past_bodies(potential.self_contact, step, behind, apart=True)
    anew = step.reached(turned.positions + 0.01)

    def passed(_: TimeStep, x: torch.Tensor | None = None) -> torch.Tensor:
        count = before if x is None else after if torch.equal(x, turned.positions) else 0
        return torch.arange(len(turned.positions)) < count

    monkeypatch.setattr(refinement, "_passed", passed)
    monkeypatch.setattr(refinement, "_are_failed", lambda step, _: torch.zeros(len(step.garments.faces), dtype=bool))
    monkeypatch.setattr(refining._local, "minimise", lambda *_, **__: turned)
    monkeypatch.setattr(refinement, "in_parts", lambda *_: (anew, None))
    kept = refining.pressed_past_bodies(step, behind)
    assert torch.equal(kept.positions, {"turned": turned, "solved": anew}[solved].positions)


def test_vertices_that_a_body_is_through_are_counted_before_and_after_a_step() -> None:
    step = first_step(4.0, IncrementalPotential().with_self_contact(bodies=True))
    assert not refinement._passed(step).any()
    sunk = step.state.positions - torch.tensor([0.0, 0.02, 0.0])
    through = refinement._passed(step, sunk)
    inside = (sunk - step.bodies.following.positions.mean(0)).norm(dim=1) < 0.2
    assert bool(inside.any())
    assert bool(through[inside].all())
    assert not bool(through.all())


def test_a_retry_moves_the_cloth_around_what_bodies_turned_aside(monkeypatch: pytest.MonkeyPatch) -> None:
    potential = IncrementalPotential().with_self_contact(bodies=True)
    step = first_step(4.0, potential)
    refining = SolverRefinement(potential, 5)
    behind = step.reached(free_flight(step))
    turned = past_bodies(potential.self_contact, step, behind, apart=True)
    monkeypatch.setattr(refinement, "_RINGS", 1)
    crumpled = (turned.positions - behind.positions).norm(dim=1) > refinement._TURNED_ASIDE
    crumpled[step.garments.faces[refinement._are_failed(step, turned.positions)].reshape(-1)] = True
    around = refinement._near(step.garments, crumpled)
    assert not bool(around.all())
    kept = refining.pressed_past_bodies(step, behind)
    assert refinement._failed_faces(step, kept.positions) == 0
    stays = (kept.positions == turned.positions).all(1)
    assert torch.equal(stays, ~around)
    assert torch.equal(kept.velocities[stays], turned.velocities[stays])
    speeds = turned.velocities + (kept.positions - turned.positions) / step.dt
    torch.testing.assert_close(kept.velocities, speeds)


def test_a_retry_goes_in_parts_by_the_edges_of_what_is_strained(monkeypatch: pytest.MonkeyPatch) -> None:
    potential = IncrementalPotential().with_self_contact(bodies=True)
    scene, fine = ball_scene(speed=4.0), sheet(8, side=0.05, height=1.5)
    worn = (*scene.garments, DressedGarment(fine, AttachedPlacement(fine, scene.colliders[0])))
    timeline = Timeline.of(replace(scene, garments=worn))
    step, asked = timeline.step_from(timeline.skinned_state(0)), list[float]()
    coarse, least = step.garments.mean_edge_lengths
    assert least < 0.2 * coarse
    wide = torch.where(step.garments.vertex_garment[:, None] == 0, 2.0, 1.0) * step.state.positions
    monkeypatch.setattr(refinement, "past_bodies", lambda _, step, state, apart: replace(state, positions=wide))
    monkeypatch.setattr(refinement, "substep_count", lambda _, longest: asked.append(longest) or 1)
    monkeypatch.setattr(refinement, "in_parts", lambda step, *_: (step.state, None))
    refining = SolverRefinement(potential, 5)
    # The iterations that come before a retry leave it strained.
    monkeypatch.setattr(refining._local, "minimise", lambda *_, **__: replace(step.state, positions=wide))
    refining.pressed_past_bodies(step, step.state)
    assert asked == [refinement._EDGES_IN_A_PART * coarse]


@pytest.mark.parametrize(
    ("strained", "left", "last"),
    [([3, 3], 0, 10), ([4, 2, 1, 1], 0, 20), ([3, 0], 0, 10), ([4, 2], 2, 10), ([3, 0, 0, 0], None, None)],
)
def test_a_retry_ends_where_no_fewer_faces_are_strained_and_perhaps_where_few_are(
    monkeypatch: pytest.MonkeyPatch, strained: list[int], left: int | None, last: int | None
) -> None:
    step, counts = first_step(speed=0.3), iter(strained)
    monkeypatch.setattr(refinement, "_failed_faces", lambda *_: next(counts))
    smooth, made = refinement._Smoothing(step, allowed=left), range(1, 5 * len(strained) + 1)
    ended = [number for number in made if smooth.ended(step.state.positions)]
    assert ended == ([] if last is None else [last])


def test_smoothing_of_crumpled_cloth_goes_on_while_strained_faces_halve(monkeypatch: pytest.MonkeyPatch) -> None:
    step, counts = first_step(speed=0.3), iter([9, 4, 2, 0])
    monkeypatch.setattr(refinement, "_failed_faces", lambda *_: next(counts))

    def ended(failed: int) -> int:
        smooth = refinement._Smoothing(step, allowed=0, failed=failed, share=0.5)
        return next(number for number in range(1, 100) if smooth.ended(step.state.positions))

    assert ended(17) == 5
    assert ended(9) == 10, "two are half of four"
    assert ended(2) == 5
