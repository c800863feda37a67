"""Damping of cloth against the decay of one mode, and what it must not do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.physics.shapes import EVALUATION, nobody, packed, sheet, time_step, tube
from tests.readable_stiffness import dense

from pb4u.environment import Environment
from pb4u.garment.material import Material
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.integrator import SECOND_ORDER
from pb4u.physics.solver.implicit_steps import free_flight
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.bending import Bending, bends, hinge_stiffness
from pb4u.physics.terms.damping import DAMPED
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.terms.stiffness_matrix import StiffnessPattern
from pb4u.physics.terms.stretch import Stretch, elastic_density, green_strains
from pb4u.physics.time_step import TimeStep
from pb4u.scene.state import State

STIFF = Material.isotropic(density=0.2, lame_mu=1e6, lame_lambda=0.0, bending=0.016)


def damped() -> IncrementalPotential:
    potential = IncrementalPotential()
    for term in DAMPED:
        potential = potential.with_term(term)
    return potential


def shaken() -> tuple[StepPotential, torch.Tensor]:
    """Both damped energies of a tube, between two crumpled states."""
    garments = packed(tube(8, 4, 0.15, 0.3, replace(EVALUATION, damping_time=0.02)))
    noise = torch.randn(2, garments.vertex_count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    before = garments.rest_positions + 0.003 * noise[0]
    step = time_step(garments, State(before, torch.zeros_like(before), 0))
    return IncrementalPotential(DAMPED).of(step), before + 0.003 * noise[1]


@pytest.mark.parametrize("name", [term.name for term in DAMPED])
def test_both_forms_have_the_slope_of_their_energy(name: str) -> None:
    step, x = shaken()
    term, compiled = next(each for each in DAMPED if each.name == name), step.potential.term(name)
    energies, expected = term.energies_and_gradient(step.step, step.contacts, x)
    found, gradient = compiled.energies_and_gradient(step.step, step.contacts, x)
    assert float(expected.abs().max()) > 1e-6
    torch.testing.assert_close(found, energies, rtol=1e-10, atol=0.0)
    torch.testing.assert_close(gradient, expected, rtol=1e-9, atol=1e-10 * float(expected.abs().max()))


def damping_alone(step: TimeStep, x: torch.Tensor) -> torch.Tensor:
    """Energy [J] of the change of shape from the start of `step` to x (vertices, 3) [m], as the papers have it."""
    garments, before = step.garments, step.state.positions
    strains = green_strains(garments, x) - green_strains(garments, before)
    bent = bends(garments, x) - bends(garments, before)
    stretch = (garments.damping * garments.face_areas * elastic_density(garments, strains)).sum()
    bending = 0.5 * (garments.hinge_damping * hinge_stiffness(garments) * bent**2).sum()
    return (stretch + bending) / step.dt


def test_a_damped_energy_is_the_elastic_one_and_that_of_the_change() -> None:
    potential, x = shaken()
    step, elastic = potential.step, IncrementalPotential((Stretch(), Bending())).of(potential.step)
    places = [x, step.state.positions, step.garments.rest_positions]
    sums = [float(elastic.energies(at).total + damping_alone(step, at)) for at in places]
    found = [float(potential.energies(at).total) for at in places]
    assert found[1] - found[0] == pytest.approx(sums[1] - sums[0], rel=1e-9)
    assert found[2] - found[0] == pytest.approx(sums[2] - sums[0], rel=1e-9)
    assert abs(sums[1] - sums[0]) > 1e-3


def test_the_second_derivative_is_positive() -> None:
    step, x = shaken()
    matrix = dense(step.stiffness(x, StiffnessPattern(step.step.garments, step.elements())).matrix())
    assert np.linalg.eigvalsh(matrix).min() > -1e-10 * np.abs(matrix).max()


def test_cloth_that_keeps_its_shape_is_not_damped() -> None:
    potential, _ = shaken()
    step = potential.step
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))
    moved = step.state.positions @ (turn * torch.det(turn)).T + 1.0
    elastic = IncrementalPotential((Stretch(), Bending())).of(step).energies_and_gradient(moved)[1]
    assert float((potential.energies_and_gradient(moved)[1] - elastic).abs().max()) < 1e-9


def test_cloth_without_damping_has_the_elastic_energies_alone() -> None:
    garments = packed(sheet(2, 2))
    x = garments.rest_positions * 1.1
    step = time_step(garments, State(x, torch.zeros_like(x), 0))
    expected = IncrementalPotential((Stretch(), Bending())).of(step).energies(x).total
    assert float(IncrementalPotential(DAMPED).of(step).energies(x).total) == float(expected)


def decrement(damping_time: float, fps: int) -> tuple[float, float]:
    """Logarithmic decrement of a strip that vibrates about its clamped end, and its angular frequency [1/s]."""
    strip = sheet(8, 1, 0.2, 0.025, replace(STIFF, damping_time=damping_time))
    garments = packed(strip.with_pins(strip.vertices[:, 0] < 0.026))
    rest, potential = garments.rest_positions, damped().with_term(Inertia())
    along = ((rest[:, 0] - 0.025) / 0.175).clamp_min(0.0)
    # The first mode of a clamped beam, nearly.
    velocities = torch.zeros_like(rest)
    velocities[:, 2] = 0.02 * along**2 * (6.0 - 4.0 * along + along**2) / 3.0
    state, ends = State(rest, velocities, 0), []
    around = Environment((0.0, 0.0, 0.0), ground=None)
    for _ in range(round(1.6 * fps)):
        step = TimeStep(garments, state, nobody(), 1.0 / fps, around, rest, integrator=SECOND_ORDER)
        state = step.reached(Solver(1e-9).minimise(potential.of(step), free_flight(step)).positions)
        ends.append(float(state.positions[rest[:, 0] > 0.199, 2].mean()))
    places = np.array(ends)
    middle = places[1:-1]
    tops = 1 + np.flatnonzero((middle > places[:-2]) & (middle >= places[2:]))
    curve = places[tops - 1] - 2.0 * places[tops] + places[tops + 1]
    slope = 0.5 * (places[tops + 1] - places[tops - 1])
    heights, times = places[tops] - slope**2 / (2.0 * curve), (tops - slope / curve) / fps
    return float(-np.polyfit(np.arange(len(tops)), np.log(heights), 1)[0]), float(2 * np.pi / np.diff(times).mean())


@pytest.mark.parametrize("fps", [60, 120])
def test_a_mode_decays_by_its_damping_time_at_any_rate_of_frames(fps: int) -> None:
    own, _ = decrement(0.0, fps)
    found, frequency = decrement(0.004, fps)
    assert found - own == pytest.approx(np.pi * 0.004 * frequency, rel=0.05)
