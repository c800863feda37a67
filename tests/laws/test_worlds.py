"""Worlds: what is in one can touch; what is in two cannot, and neither decides for the other."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.physics.shapes import at_rest, capsule, collider, colliders, packed, potential_of, sheet, tube

from pb4u.garment.garment import Garment
from pb4u.physics.solver import newton_solver
from pb4u.physics.solver.newton_solver import Solver
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State

APART = np.array([3.0, 0.0, 0.0])
MOTION = np.array([0.004, 0.001, 0.0])
CONTACT = ("collision", "friction")


def dressed(around: int, along: int) -> tuple[Garment, tuple[np.ndarray, np.ndarray]]:
    """A tube that touches the capsule inside it."""
    body = capsule(count=16)
    return tube(around, along, 0.152, 0.4), (np.asarray(body.vertices) + [0.0, 0.2, 0.0], np.asarray(body.faces))


def shaken(garments: PackedGarments, size: float = 0.002) -> torch.Tensor:
    generator = torch.Generator().manual_seed(4)
    return size * torch.randn(garments.vertex_count, 3, generator=generator, dtype=torch.float64)


def test_one_world_of_two_dressed_bodies_has_the_energies_of_two_worlds() -> None:
    """Each garment is nearest to its own body, so that what can touch decides nothing."""
    (first, body), (second, other) = dressed(16, 8), dressed(20, 10)
    second = Garment("second", second.vertices + APART, second.faces, second.material)
    bodies = [body, (other[0] + APART, other[1])]
    energies, gradients = [], []
    for worlds in ([0, 0], [0, 1]):
        garments = packed(first, second, worlds=worlds)
        state = State(garments.rest_positions, 10.0 * shaken(garments), 0)
        step = potential_of(garments, state, colliders(bodies, worlds, MOTION), ground=0.0)
        found, gradient = step.energies_and_gradient(garments.rest_positions + shaken(garments))
        energies.append(found)
        gradients.append(gradient)
        assert found.per_world(garments).shape == (worlds[-1] + 1,)
        torch.testing.assert_close(found.per_world(garments).sum(), found.total)
    one, two = energies
    for name in one.terms:
        assert one.terms[name].shape == (2,)
        torch.testing.assert_close(one.terms[name], two.terms[name], rtol=1e-10, atol=1e-14)
        if name in CONTACT:
            assert bool((one.terms[name] > 1e-9).all()), "the case must exercise contact"
    torch.testing.assert_close(*gradients, rtol=1e-9, atol=1e-12)


def test_garments_of_one_world_touch_the_same_body_and_those_of_another_do_not() -> None:
    """Two garments on one body: each has the contact energies that it has alone on it."""
    (inner, body), (outer, _) = dressed(16, 8), dressed(20, 10)
    shared = packed(inner, outer, worlds=[0, 0])
    frame = collider(*body, motion=MOTION)
    x = shared.rest_positions + shaken(shared)
    together = potential_of(shared, at_rest(shared), frame).energies(x).terms
    cut = shared.vertex_offsets[1]
    for g, (garment, rows) in enumerate(((inner, slice(0, cut)), (outer, slice(cut, None)))):
        alone = packed(garment)
        by_itself = potential_of(alone, at_rest(alone), frame).energies(x[rows]).terms
        for name in CONTACT:
            assert float(together[name][g]) > 1e-6
            assert float(together[name][g]) == pytest.approx(float(by_itself[name][0]), rel=1e-10)
    apart = packed(inner, outer, worlds=[0, 1])
    elsewhere = potential_of(apart, at_rest(apart), frame).energies(x).terms
    for name in CONTACT:
        assert float(elsewhere[name][0]) == pytest.approx(float(together[name][0]), rel=1e-10)
        assert float(elsewhere[name][1]) == 0.0


def swinging_sheet() -> tuple[Garment, torch.Tensor]:
    """A sheet held by two corners, and a wave in its velocity [m/s]."""
    mesh = sheet(8, 8, 0.5, 0.5)
    held = (mesh.vertices[:, 1] == 0.5) & np.isin(mesh.vertices[:, 0], [0.0, 0.5])
    velocities = np.zeros_like(mesh.vertices)
    velocities[:, 2] = np.where(held, 0.0, np.sin(7 * mesh.vertices[:, 0]) + mesh.vertices[:, 1])
    aside = Garment("aside", mesh.vertices - APART, mesh.faces, mesh.material, held)
    return aside, torch.from_numpy(velocities)


@pytest.mark.parametrize("worlds", [[0, 1], [0, 0]])
def test_what_does_not_touch_is_minimised_to_where_each_ends_alone(worlds: list[int]) -> None:
    swinging, velocities = swinging_sheet()
    covering, body = dressed(16, 8)
    # The first body stands where nothing touches it.
    bodies = [(body[0] + APART + [0.0, 0.7, 0.0], body[1]), body]
    both = packed(swinging, covering, worlds=worlds)
    cut = both.vertex_offsets[1]
    moving = torch.cat([velocities, torch.zeros(both.vertex_count - cut, 3, dtype=torch.float64)])
    solver, start = Solver(tolerance=1e-6), both.rest_positions + moving / 30.0
    potential = potential_of(both, State(both.rest_positions, moving, 0), colliders(bodies, worlds, MOTION))
    together = solver.minimise(potential, start)
    assert together.converged
    for g, (garment, worn_on, rows) in enumerate(
        ((swinging, bodies[0], slice(0, cut)), (covering, bodies[1], slice(cut, None)))
    ):
        alone = packed(garment)
        state = State(alone.rest_positions, moving[rows], 0)
        by_itself = potential_of(alone, state, collider(*worn_on, motion=MOTION))
        expected = solver.minimise(by_itself, start[rows])
        assert float((together.positions[rows] - state.positions).norm(dim=1).max()) > 1e-3, "the case must move"
        assert float((together.positions[rows] - expected.positions).norm(dim=1).max()) < 1e-6
        if worlds == [0, 1]:
            for name, value in potential.energies(start).terms.items():
                assert float(value[g]) == pytest.approx(float(by_itself.energies(start[rows]).terms[name]), rel=1e-9)


@pytest.mark.parametrize(("case", "largest"), [("torn", 0.2), ("flung", 4.0 / 30.0 / 4.0)])
def test_a_world_that_takes_a_short_step_does_not_shorten_that_of_another(
    case: str, largest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No step moves a vertex by more than 0.2 m, and one is halved until the energy falls; each world by itself."""
    falling, other = sheet(6, 6), sheet(6, 6)
    if case == "torn":
        other = other.with_pins(np.arange(49) < 7)
    both = packed(falling, other)
    velocities, start = torch.zeros_like(both.rest_positions), both.rest_positions.clone()
    if case == "torn":
        start[49 + 7 :, 0] += 1.0
    else:
        # Neighbours fly apart, out of the plane: to first order that stretches nothing, so two halvings are needed.
        velocities[49:, 2] = 4.0 * (-1.0) ** torch.arange(49)
    potential = potential_of(both, State(both.rest_positions, velocities, 0))
    monkeypatch.setattr(newton_solver, "_FINELY", 1e-6)
    solution = Solver().minimise(potential, start, iterations=1)
    moved = solution.positions - start
    assert not solution.converged
    assert float(moved[49:].norm(dim=1).max()) == pytest.approx(largest, rel=0.01)
    fall = torch.tensor([0.0, -9.81 / 30.0**2, 0.0], dtype=torch.float64).expand(49, 3)
    torch.testing.assert_close(moved[:49], fall, rtol=0, atol=1e-5)
