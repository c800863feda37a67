"""Air against the closed forms of falling and hanging plates, and the laws of mechanics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import brentq
from tests.physics.shapes import at_rest, capsule, collider, packed, sheet, time_step, tube
from tests.readable_stiffness import dense, times

from pb4u.environment import Environment
from pb4u.garment.material import MATERIALS, Material
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.integrator import SECOND_ORDER
from pb4u.physics.solver.implicit_steps import free_flight
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.air import CARRIED_ALONG, OPEN_AIR, TURBULENCE, Air, air_velocities
from pb4u.physics.terms.gravity import Gravity
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.terms.stiffness_matrix import StiffnessPattern
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State

WIND = (1.0, -0.4, 2.0)


def blown(seed: int = 0) -> tuple[StepPotential, torch.Tensor]:
    """The air alone on a crumpled tube in the wind, part of it near a body."""
    garments, body = packed(tube(12, 6, 0.18, 0.5)), capsule()
    noise = torch.randn(2, garments.vertex_count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    state = State(garments.rest_positions, 0.1 * noise[0], 3)
    step = time_step(garments, state, collider(body.vertices, body.faces), wind=WIND)
    return IncrementalPotential((Air(),)).of(step), garments.rest_positions + 0.004 * noise[1]


def test_compiled_and_differentiated_by_hand_it_is_what_is_written() -> None:
    step, x = blown()
    term, compiled = Air(), step.potential.term("air")
    variable = x.clone().requires_grad_(True)
    energies = term.energies(step.step, step.contacts, variable)
    (expected,) = torch.autograd.grad(energies.sum(), variable)
    values, gradient = compiled.energies_and_gradient(step.step, step.contacts, x)
    assert float(expected.abs().max()) > 1e-4
    torch.testing.assert_close(values, energies.detach(), rtol=1e-10, atol=0.0)
    torch.testing.assert_close(gradient, expected, rtol=1e-9, atol=1e-10 * float(expected.abs().max()))


def test_the_second_derivative_is_that_of_differences_and_positive() -> None:
    step, x = blown(1)
    matrix = step.stiffness(x, StiffnessPattern(step.step.garments, step.elements())).matrix(1.0)
    direction = torch.randn(x.shape, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    h = 1e-7
    plus, minus = (step.energies_and_gradient(x + s * h * direction)[1] for s in (1, -1))
    expected = ((plus - minus) / (2 * h)).numpy()
    found = times(matrix, direction.numpy())
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    values = np.linalg.eigvalsh(dense(matrix))
    assert values.min() > -1e-10 * values.max()


def test_no_force_on_cloth_that_moves_with_the_air() -> None:
    step, _ = blown(2)
    carried = step.step.state.positions + step.step.dt * torch.tensor(WIND, dtype=torch.float64)
    assert float(step.energies_and_gradient(carried)[1].abs().max()) < 1e-15


@pytest.mark.parametrize("fabric", ["silk", "cotton", "default", "denim"])
def test_a_level_sheet_falls_as_fast_as_a_plate_does(fabric: str) -> None:
    cloth = sheet(3, 3, material=MATERIALS[fabric])
    level = replace(cloth, vertices=cloth.vertices[:, [0, 2, 1]])
    garments = packed(level)
    potential = IncrementalPotential((Gravity(), Inertia(), Air()))
    state = at_rest(garments)
    for _ in range(90):
        step = replace(time_step(garments, state), integrator=SECOND_ORDER)
        state = step.reached(Solver(1e-9).minimise(potential.of(step), free_flight(step)).positions)
    expected = np.sqrt(2.0 * 9.81 * MATERIALS[fabric].density / (1.2 * 1.2))
    assert -state.velocities[:, 1].numpy() == pytest.approx(np.full(16, expected), rel=0.01)
    # What the cloth loses the air gets.
    before, momentum = step.state, garments.vertex_masses[:, None] * (state.velocities - step.state.velocities)
    air = -Air().energies_and_gradient(step, potential.of(step).contacts, state.positions)[1].sum(0)
    pull = garments.vertex_masses.sum() * 9.81 * step.dt
    assert float(momentum[:, 1].sum()) == pytest.approx(float(air[1] * step.dt - pull), abs=2e-3 * float(pull))
    assert before.frame == 89


def hanging(speed: float, air: Air) -> float:
    """Angle from the vertical at which a stiff sheet stands in the wind, hinged along its upper border."""
    cloth = sheet(1, 5, 0.2, 0.5, Material.isotropic(density=0.2, lame_mu=2e8, lame_lambda=0.0, bending=40.0))
    garments: PackedGarments = packed(cloth.with_pins(cloth.vertices[:, 1] > 0.499))
    potential, state = IncrementalPotential().with_term(air), at_rest(garments)
    for _ in range(150):
        step = time_step(garments, state, wind=(0.0, 0.0, speed))
        step = replace(step, pin_positions=garments.rest_positions)
        state = step.reached(Solver(1e-6).minimise(potential.of(step), free_flight(step)).positions)
    lower = state.positions[garments.rest_positions[:, 1] < 1e-9].mean(0)
    return float(torch.atan2(lower[2], 0.5 - lower[1]))


@pytest.mark.parametrize("speed", [1.0, 2.0, 5.0])
def test_a_hinged_sheet_stands_where_pressure_and_weight_balance(speed: float) -> None:
    pressure = 1.2 * 1.2 * speed**2 / (2.0 * 0.2 * 9.81)
    expected = brentq(lambda a: np.sin(a) - pressure * np.cos(a) ** 2, 0.0, 1.57)
    assert np.sin(hanging(speed, Air(skin_friction=0.0))) == pytest.approx(np.sin(expected), rel=0.05)


def test_skin_carries_the_air_along() -> None:
    body = capsule(radius=0.15)
    forces = []
    for gap in (0.5 * CARRIED_ALONG, 0.5 * (CARRIED_ALONG + OPEN_AIR), 2.0 * OPEN_AIR):
        garments = packed(tube(24, 4, 0.15 + gap, 0.2))
        step = time_step(garments, None, collider(body.vertices, body.faces), wind=(0.0, 0.0, 3.0))
        frozen = IncrementalPotential((Air(),)).of(step)
        force = frozen.energies_and_gradient(garments.rest_positions)[1].norm(dim=1).sum()
        forces.append(float(force / garments.face_areas.sum()))
    assert forces[0] == 0.0
    assert forces[1] == pytest.approx(0.5 * forces[2], rel=0.15)


def test_gusts_blow_about_the_wind_and_are_carried_along_by_it() -> None:
    gusty = Environment(wind=(0.0, 0.0, 4.0), gusts=3)
    random = torch.Generator().manual_seed(0)
    points = 200.0 * torch.rand(20_000, 3, generator=random, dtype=torch.float64)
    found = air_velocities(gusty, points, 1.7)
    np.testing.assert_allclose(found.mean(0).numpy(), gusty.wind, atol=0.1)
    assert float((found - found.mean(0)).square().mean().sqrt()) == pytest.approx(4.0 * TURBULENCE, rel=0.1)
    later = air_velocities(gusty, points + 0.5 * torch.tensor(gusty.wind, dtype=torch.float64), 2.2)
    torch.testing.assert_close(later, found)
    # Air is neither pressed together nor drawn apart.
    h, spread = 1e-5, torch.zeros(len(points), dtype=torch.float64)
    for axis in range(3):
        way = torch.zeros(3, dtype=torch.float64)
        way[axis] = h
        spread += ((air_velocities(gusty, points + way, 0.0) - air_velocities(gusty, points - way, 0.0)) / (2 * h))[
            :, axis
        ]
    assert float(spread.abs().max()) < 1e-5
    assert not torch.equal(air_velocities(replace(gusty, gusts=4), points, 1.7), found)
    steady = air_velocities(replace(gusty, gusts=None), points, 1.7)
    assert steady.tolist()[0] == list(gusty.wind)
