"""One step of Jacobi descent: where the energies push."""

from __future__ import annotations

import torch
from tests.physics.shapes import DT, potential_of, sheet, time_step

from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.solver.descent import JacobiDescent, membrane_stiffness
from pb4u.physics.terms.stretch import Stretch
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.state import State


def crumpled(garments: PackedGarments) -> State:
    generator = torch.Generator().manual_seed(3)
    noise = 2e-3 * torch.randn(garments.rest_positions.shape, generator=generator, dtype=torch.float64)
    return State(garments.rest_positions + noise, 0.2 * noise / DT, 0)


def test_a_part_of_the_descent_lowers_the_potential() -> None:
    garments = pack([sheet(12, 12)])
    state = crumpled(garments)
    potential = potential_of(garments, state)
    x = state.positions + DT * state.velocities
    step = JacobiDescent(garments, DT).at(potential, x)
    before, after = (float(potential.energies(at).total) for at in (x, x + 0.2 * step))
    assert after < before - 1e-4


def test_pinned_vertices_are_not_pushed() -> None:
    pins = torch.zeros(13 * 13, dtype=torch.bool)
    pins[:13] = True
    garment = sheet(12, 12)
    garments = pack([type(garment)(garment.name, garment.vertices, garment.faces, garment.material, pins.numpy())])
    state = crumpled(garments)
    step = JacobiDescent(garments, DT).at(potential_of(garments, state), state.positions)
    assert torch.equal(step[pins], torch.zeros_like(step[pins]))
    assert (step[~pins].norm(dim=1) > 0).all()


def test_membrane_stiffness_is_half_the_trace_of_the_second_derivative() -> None:
    garments = pack([sheet(5, 4)])
    rest = garments.rest_positions
    still = time_step(garments, gravity=(0, 0, 0))
    second = torch.autograd.functional.hessian(lambda x: Stretch().energies(still, ContactSet(), x).sum(), rest)
    vertex = torch.arange(garments.vertex_count)
    expected = 0.5 * second[vertex, :, vertex].diagonal(dim1=1, dim2=2).sum(-1)
    assert torch.allclose(membrane_stiffness(garments), expected, rtol=1e-10)
