"""Another rule of integration is one class: inertia, velocities and what a state keeps of those before follow it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from tests.physics.shapes import DT, packed, sheet, time_step
from tests.scene.test_without_a_body import alone
from torch import Tensor

import pb4u
from pb4u.garment.material import Material
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.integrator import IMPLICIT_EULER, INTEGRATORS, SECOND_ORDER, Integrator
from pb4u.physics.solver.implicit_steps import free_flight
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.time_step import integrate
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State
from pb4u.simulation.first_frame import AsPlaced
from pb4u.simulation.stepwise_simulator import SolverSimulator


def before(positions: Tensor, velocities: Tensor, dt: float = DT) -> tuple[Tensor, ...]:
    """History of a state whose step began at `positions` with `velocities`, by the rule of second order."""
    start = State(positions - dt * velocities, velocities, 2)
    return SECOND_ORDER.arrived(start, dt, positions, dt * velocities).history


ANGLE = np.pi / 6
"""From which the strip swings."""


def strip() -> PackedGarments:
    """A strip of half a metre that is as good as rigid, and is held at its upper end."""
    cloth = sheet(1, 5, 0.05, 0.5, Material.isotropic(density=0.2, lame_mu=2e8, lame_lambda=0.0, bending=40.0))
    return packed(cloth.with_pins(cloth.vertices[:, 1] > 0.499))


def swung(rule: Integrator, fps: int, seconds: float) -> np.ndarray:
    """Sideways places [m] of the lower end of the strip, a frame each."""
    garments = strip()
    down = torch.tensor([0.0, -np.cos(ANGLE), np.sin(ANGLE)], dtype=torch.float64)
    x = (0.5 - garments.rest_positions[:, 1:2]) * down
    x = x + garments.rest_positions * torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    state, ends = State(x, torch.zeros_like(x), 0), []
    for _ in range(round(seconds * fps)):
        step = replace(time_step(garments, state, dt=1.0 / fps), integrator=rule, pin_positions=x)
        state = step.reached(Solver(1e-6).minimise(IncrementalPotential().of(step), free_flight(step)).positions)
        ends.append(float(state.positions[0, 2]))
    return np.array(ends)


def swung_exactly(seconds: float) -> float:
    """Sideways place [m] of that end where the strip is rigid: a physical pendulum."""
    garments = strip()
    arms, masses = 0.5 - garments.rest_positions[:, 1].numpy(), garments.vertex_masses.numpy()
    pull = 9.81 * (masses * arms).sum() / (masses * arms**2).sum()
    way = solve_ivp(lambda _, y: (y[1], -pull * np.sin(y[0])), (0.0, seconds), (ANGLE, 0.0), rtol=1e-10, atol=1e-12)
    return 0.5 * float(np.sin(way.y[0, -1]))


@pytest.mark.parametrize("rule", INTEGRATORS.values())
def test_inertia_is_zero_where_nothing_acts_and_divides_by_its_own_time(rule: Integrator) -> None:
    garments = packed(sheet(3, 2))
    noise = torch.randn(4, garments.vertex_count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    state = State(garments.rest_positions + 0.01 * noise[0], noise[1], 4)
    if rule is SECOND_ORDER:
        state = replace(state, history=before(garments.rest_positions, noise[2]))
    step = replace(time_step(garments, state), integrator=rule)
    free, way = state.positions + step.free_move, 0.01 * noise[3]
    for term in (Inertia(), Inertia().compiled(step, ContactSet())):
        assert float(term.energies(step, ContactSet(), free).abs().max()) < 1e-20
        _, gradient = term.energies_and_gradient(step, ContactSet(), free + way)
        expected = (garments.vertex_masses / step.inertial_dt**2)[:, None] * way
        torch.testing.assert_close(gradient, expected, rtol=1e-9, atol=1e-12)
    reached = step.reached(free + way)
    predicted = integrate(step, way)
    torch.testing.assert_close(predicted.velocities, reached.velocities)
    assert (reached.frame, predicted.frame, len(reached.history)) == (5, 5, len(state.history))
    # A move changes the velocity by itself over the time of inertia.
    inertial_dt = torch.as_tensor(step.inertial_dt).reshape(-1, 1)
    torch.testing.assert_close(reached.velocities - step.reached(free).velocities, way / inertial_dt)


def test_parts_of_a_step_lead_where_nothing_acts_to_the_same_state() -> None:
    garments = packed(sheet(1, 1))
    x, v = garments.rest_positions, torch.full_like(garments.rest_positions, 0.3)
    step = replace(time_step(garments, State(x, v, 3, before(x - DT * v, v))), integrator=SECOND_ORDER)
    state = step.state
    for k in range(3):
        part = step.part(k, 3, state)
        state = part.reached(part.state.positions + part.free_move)
    whole, by_parts = step.reached(x + step.free_move), step.reached_by_parts(state)
    for ours, theirs in ((whole.positions, by_parts.positions), (whole.velocities, by_parts.velocities)):
        torch.testing.assert_close(ours, theirs, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(replace(step, state=whole).free_move, replace(step, state=by_parts).free_move)


def test_a_step_much_longer_than_that_before_begins_anew() -> None:
    garments = packed(sheet(1, 1))
    x, v = garments.rest_positions, torch.full_like(garments.rest_positions, 0.3)
    step = replace(time_step(garments, State(x, v, 3, before(x, 5.0 * v, DT / 10.0))), integrator=SECOND_ORDER)
    assert (torch.as_tensor(step.inertial_dt) == DT).all()
    torch.testing.assert_close(step.free_move, DT * v)


def test_contact_that_moves_cloth_without_giving_it_speed_leaves_no_speed_behind() -> None:
    garments = packed(sheet(1, 1))
    x, v = garments.rest_positions, torch.full_like(garments.rest_positions, 0.3)
    step = replace(time_step(garments, State(x, v, 3, before(x - DT * v, v))), integrator=SECOND_ORDER)
    after = step.reached(x + step.free_move)
    pushed = replace(after, positions=after.positions + 0.01)
    torch.testing.assert_close(replace(step, state=pushed).free_move, replace(step, state=after).free_move)


@pytest.mark.parametrize("rule", INTEGRATORS.values())
def test_contact_stops_a_state_that_no_step_led_to(rule: Integrator) -> None:
    x = packed(sheet(1, 1)).rest_positions
    placed = State(x, torch.zeros_like(x), 0)
    stopped = rule.turned_aside(placed, DT, x + 0.01)
    torch.testing.assert_close(stopped.positions, x + 0.01)
    torch.testing.assert_close(stopped.velocities, torch.full_like(x, 0.01 / DT))
    assert (stopped.frame, stopped.history) == (0, ())


def test_a_vertex_that_contact_struck_is_not_thrown_back() -> None:
    garments = packed(sheet(1, 1))
    x, v = garments.rest_positions, torch.full_like(garments.rest_positions, -1.0)
    step = replace(time_step(garments, State(x, v, 3, before(x - DT * v, v))), integrator=SECOND_ORDER)
    struck = torch.arange(len(x)) < 2
    stopped = step.reached(x, struck)
    assert (stopped.velocities[struck] == 0.0).all()
    assert (stopped.velocities[~struck] == 0.5).all()
    next_step = replace(step, state=stopped)
    assert (next_step.free_move[struck] == 0.0).all()
    assert (torch.as_tensor(next_step.inertial_dt)[struck] == DT).all()
    # So is one that contact stops after the step was made.
    late = step.turned_aside(step.reached(x + DT * v), x)
    torch.testing.assert_close(late.velocities, torch.zeros_like(x), atol=1e-12, rtol=0.0)


@pytest.mark.parametrize("self_contact", [False, True])
def test_a_sheet_that_falls_flat_lies_down(self_contact: bool) -> None:
    simulator = pb4u.load_simulator(
        "quick-solver", first_frame="placed", self_contact=self_contact, time_integration="bdf2"
    )
    heights = simulator.simulate(alone(0.2, frames=12)).positions[:, :, 1]
    landed = int(np.argmax(heights.max(axis=1) < 3e-3))
    assert 0 < landed < 10
    assert (heights[landed:] < 5e-3).all()


def test_constant_acceleration_is_followed_by_steps_of_any_length() -> None:
    """The rule of second order is exact for it, whatever the lengths of steps are."""
    x, v, time = torch.zeros(1, 3, dtype=torch.float64), torch.zeros(1, 3, dtype=torch.float64), 0.1
    down = torch.tensor([[0.0, -9.81, 0.0]], dtype=torch.float64)
    # One step of another rule led there, with its mean velocity.
    state = SECOND_ORDER.arrived(State(x, v, 0), time, 0.5 * down * time**2, 0.5 * down * time**2)
    lag = state.history[1] + state.velocities - down * time
    state = replace(state, velocities=down * time, history=(state.history[0], lag, *state.history[2:]))
    for dt in (0.1, 0.15, 0.05, 0.09):
        inertial_dt = torch.as_tensor(SECOND_ORDER.inertial_dt(state, dt))
        move = SECOND_ORDER.free_move(state, dt) + inertial_dt[:, None] ** 2 * down
        state, time = SECOND_ORDER.arrived(state, dt, state.positions + move, move), time + dt
        torch.testing.assert_close(state.velocities, down * time)
        torch.testing.assert_close(state.positions, 0.5 * down * time**2)


@pytest.mark.parametrize("fps", [30, 60])
def test_a_swing_keeps_its_height(fps: int) -> None:
    places = swung(SECOND_ORDER, fps, 2.0)
    peaks = np.abs(places[1:-1][np.diff(np.sign(np.diff(places))) != 0])
    assert len(peaks) == 3
    assert ((peaks[1:] / peaks[:-1] > 0.97) & (peaks[1:] / peaks[:-1] < 1.0)).all()


def test_errors_fall_by_the_order_of_the_rule() -> None:
    for rule, order in ((IMPLICIT_EULER, 1.0), (SECOND_ORDER, 2.0)):
        errors = [abs(swung(rule, fps, 0.4)[-1] - swung_exactly(0.4)) for fps in (30, 60, 120)]
        assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([order, order], abs=0.15)


def test_a_simulation_falls_by_its_rule() -> None:
    errors, frames = [], 13
    scene = replace(alone(1.0, frames=frames), environment=pb4u.Environment(ground=None))
    for rule in INTEGRATORS.values():
        simulator = SolverSimulator(integrator=rule, first_frame=AsPlaced())
        made = simulator.simulate(scene, pb4u.no_progress)
        fallen = 1.0 - np.asarray(made.positions, dtype=np.float64)[-1, :, 1].mean()
        errors.append((fallen - 9.81 * ((frames - 1) / 30) ** 2 / 2) * 900 / 9.81)
        assert made.metadata["time_integration"] == rule.name
    # In g dt^2: half of a step each for implicit Euler; three quarters in all, from its first step, for the other.
    assert errors == pytest.approx([(frames - 1) / 2, 0.75], abs=0.01)
