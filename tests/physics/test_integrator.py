"""Another rule of integration is one class: inertia, velocities and what a state keeps of those before follow it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.physics.shapes import DT, packed, sheet, time_step
from tests.scene.test_without_a_body import alone
from torch import Tensor

import pb4u
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.integrator import IMPLICIT_EULER, Integrator
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.time_step import integrate
from pb4u.scene.state import State
from pb4u.simulation.first_frame import AsPlaced
from pb4u.simulation.stepwise_simulator import SolverSimulator


class SecondOrder:
    """Backward differences of two steps (BDF2), and implicit Euler where no state before is known."""

    name = "bdf2"

    def inertial_dt(self, state: State, dt: float) -> float:
        return 2.0 * dt / 3.0 if state.history else dt

    def free_move(self, state: State, dt: float) -> Tensor:
        if not state.history:
            return dt * state.velocities
        before, slower = state.history
        return (state.positions - before) / 3.0 + dt * (8.0 * state.velocities - 2.0 * slower) / 9.0

    def velocities(self, state: State, dt: float, move: Tensor) -> Tensor:
        return (3.0 * move - (state.positions - state.history[0])) / (2.0 * dt) if state.history else move / dt

    def history(self, state: State) -> tuple[Tensor, ...]:
        return state.positions, state.velocities


@pytest.mark.parametrize("rule", [IMPLICIT_EULER, SecondOrder()])
def test_inertia_is_zero_where_nothing_acts_and_divides_by_its_own_time(rule: Integrator) -> None:
    garments = packed(sheet(3, 2))
    noise = torch.randn(4, garments.vertex_count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    state = State(garments.rest_positions + 0.01 * noise[0], noise[1], 4, (garments.rest_positions, noise[2]))
    step = replace(time_step(garments, state), integrator=rule)
    free, way = state.positions + step.free_move, 0.01 * noise[3]
    for term in (Inertia(), Inertia().compiled(step, ContactSet())):
        assert float(term.energies(step, ContactSet(), free).abs().max()) < 1e-20
        _, gradient = term.energies_and_gradient(step, ContactSet(), free + way)
        expected = garments.vertex_masses[:, None] * way / rule.inertial_dt(state, DT) ** 2
        torch.testing.assert_close(gradient, expected, rtol=1e-9, atol=1e-12)
    reached = step.reached(free + way)
    predicted = integrate(step, way)
    torch.testing.assert_close(predicted.velocities, reached.velocities)
    assert (reached.frame, predicted.frame, len(reached.history)) == (5, 5, len(rule.history(state)))
    # A move changes the velocity by itself over the time of inertia.
    torch.testing.assert_close(reached.velocities - step.reached(free).velocities, way / step.inertial_dt)


def test_a_part_of_a_step_knows_nothing_of_states_a_whole_step_apart() -> None:
    garments = packed(sheet(1, 1))
    x = garments.rest_positions
    step = replace(time_step(garments, State(x, x, 3, (x, x))), integrator=SecondOrder())
    assert step.part(0, 2, step.state).state.history == ()
    assert len(step.part(1, 2, step.part(0, 2, step.state).reached(x)).state.history) == 2


def test_a_simulation_falls_by_its_rule() -> None:
    errors, frames = [], 13
    scene = replace(alone(1.0, frames=frames), environment=pb4u.Environment(ground=None))
    for rule in (IMPLICIT_EULER, SecondOrder()):
        simulator = SolverSimulator(integrator=rule, first_frame=AsPlaced())
        made = simulator.simulate(scene, pb4u.no_progress)
        fallen = 1.0 - np.asarray(made.positions, dtype=np.float64)[-1, :, 1].mean()
        errors.append((fallen - 9.81 * ((frames - 1) / 30) ** 2 / 2) * 900 / 9.81)
        assert made.metadata["time_integration"] == rule.name
    # In g dt^2: half of a step each for implicit Euler; three quarters in all, from its first step, for the other.
    assert errors == pytest.approx([(frames - 1) / 2, 0.75], abs=0.01)
