"""A prediction refined by the solver, and made anew where iterations do not mend it."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from ball_scene import ball_scene

from pb4u.physics.contact.response import ContactResponse
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver import Solution, free_flight
from pb4u.physics.time_step import TimeStep
from pb4u.scene.state import State
from pb4u.simulation.first_frame import Settled
from pb4u.simulation.refinement import ImplicitSteps, SafeguardedRefinement, SolverRefinement
from pb4u.simulation.step import StepMethod
from pb4u.simulation.timeline import Timeline

POTENTIAL = IncrementalPotential().with_self_contact()


@pytest.fixture(scope="module")
def step() -> TimeStep:
    """The first step of a sheet that lies on a ball, which begins to move."""
    timeline = Timeline.of(ball_scene())
    method = StepMethod(contact=ContactResponse(), self_contact=POTENTIAL.self_contact)
    return timeline.step_from(Settled(potential=POTENTIAL).start(timeline, method))


def wanted(step: TimeStep, noise: float) -> State:
    """The state of free flight, each vertex displaced at random by `noise` [m]."""
    aside = noise * torch.randn(step.state.positions.shape, generator=torch.Generator().manual_seed(0))
    return replace(step.state, positions=free_flight(step) + aside.to(step.state.positions))


def test_a_prediction_near_balance_is_only_refined(step: TimeStep) -> None:
    made: list[int] = []
    near = wanted(step, 0.0)
    result = SafeguardedRefinement(5, POTENTIAL, lambda: made.append(1)).refine(step, near)
    assert torch.equal(result.positions, SolverRefinement(5, potential=POTENTIAL).refine(step, near).positions)
    assert not made


def test_a_prediction_that_iterations_do_not_mend_is_made_anew(step: TimeStep) -> None:
    made: list[int] = []
    far, left = wanted(step, 0.03), list[Solution]()
    refined = SolverRefinement(1, potential=POTENTIAL, watch=left.append).refine(step, far)
    assert left[0].residual > 100
    result = SafeguardedRefinement(1, POTENTIAL, lambda: made.append(1)).refine(step, far)
    assert made == [1]
    solved, energies = ImplicitSteps(potential=POTENTIAL).refine(step, step.state), POTENTIAL.of(step).energies
    over = [float(energies(x.positions).total - energies(solved.positions).total) for x in (refined, result)]
    assert over[1] < 0.05 * over[0]
