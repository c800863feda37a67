"""The six energies against closed forms, finite differences, and the laws of mechanics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.physics.shapes import (
    DT,
    EVALUATION,
    at_rest,
    capsule,
    collider,
    colliders,
    packed,
    potential_of,
    sheet,
    tube,
)  # fmt: skip
from tests.readable_stiffness import dense, made_of, readable_stiffness, times

from pb4u.measures.released_energies import released_potential
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms import friction
from pb4u.physics.terms.collision import REFERENCE_AREA
from pb4u.physics.terms.element_loops import element_loops
from pb4u.physics.terms.energy_term import CompiledTerm, EnergyTerm
from pb4u.physics.terms.friction import Friction
from pb4u.physics.terms.gravity import Gravity
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern
from pb4u.scene.state import State

DTYPES = [(torch.float64, 1e-10), (torch.float32, 1e-5)]
FLOOR = np.array([[-9.0, 0.0, -9.0], [-9.0, 0.0, 9.0], [9.0, 0.0, 9.0], [9.0, 0.0, -9.0]])
FLOOR_FACES = np.array([[0, 1, 2], [0, 2, 3]])
NAMES = ("stretch", "bending", "gravity", "inertia", "collision", "friction")
LAWS = [*((name, "paper") for name in NAMES), ("friction", "coulomb")]
"""Names of the terms with the law of friction of their potential."""


def vector(x: float, y: float, z: float) -> torch.Tensor:
    return torch.tensor([x, y, z], dtype=torch.float64)


def alone(term: EnergyTerm) -> IncrementalPotential:
    return IncrementalPotential((term,))


def value(step: StepPotential, x: torch.Tensor, name: str) -> float:
    return float(step.energies(x).terms[name].sum())


@pytest.mark.parametrize(("dtype", "tolerance"), DTYPES)
@pytest.mark.parametrize("stretch", [1.1, 1.5, 0.8])
def test_uniform_stretch(dtype: torch.dtype, tolerance: float, stretch: float) -> None:
    garments = packed(sheet(7, 5, 0.7, 0.5), dtype=dtype)
    g = (stretch**2 - 1.0) / 2.0
    expected = 0.35 * EVALUATION.thickness * (2 * EVALUATION.lame_mu + 2 * EVALUATION.lame_lambda) * g**2
    energy = value(potential_of(garments), stretch * garments.rest_positions, "stretch")
    assert energy == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize(("dtype", "tolerance"), DTYPES)
def test_simple_shear(dtype: torch.dtype, tolerance: float) -> None:
    garments = packed(sheet(6, 6), dtype=dtype)
    x = garments.rest_positions.clone()
    x[:, 0] += 0.3 * x[:, 1]
    squares, trace = 2 * 0.15**2 + 0.045**2, 0.045
    density = EVALUATION.lame_mu * squares + EVALUATION.lame_lambda / 2 * trace**2
    assert value(potential_of(garments), x, "stretch") == pytest.approx(EVALUATION.thickness * density, rel=tolerance)


@pytest.mark.parametrize("around", [12, 40])
def test_bending_of_a_discrete_cylinder(around: int) -> None:
    radius, along, height = 0.2, 5, 0.3
    mesh = tube(around, along, radius, height)
    width = 2 * radius * np.sin(np.pi / around)
    face = width * (height / along) / 2
    angle, edge = 2 * np.pi / around, height / along
    expected = around * along * EVALUATION.bending * edge**2 / (8 * face) * angle**2 / 2
    garments = packed(mesh)
    assert value(potential_of(garments), garments.rest_positions, "bending") == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(("dtype", "tolerance"), DTYPES)
def test_falling_sheet(dtype: torch.dtype, tolerance: float) -> None:
    """Free fall minimises inertia plus weight, and both have their textbook values."""
    garments = packed(sheet(4, 4), dtype=dtype)
    v = torch.tensor([0.5, -0.25, 1.0], dtype=dtype).expand(25, 3)
    state = State(garments.rest_positions, v, 0)
    step = potential_of(garments, state, potential=IncrementalPotential((Gravity(), Inertia())))
    fall = torch.tensor([0.0, -9.81 * DT**2, 0.0], dtype=dtype)
    x = garments.rest_positions + DT * v + fall
    mass = EVALUATION.density
    assert value(step, x, "inertia") == pytest.approx(mass * 9.81**2 * DT**2 / 2, rel=max(tolerance, 1e-9) * 20)
    weight = mass * 9.81 * float((x[:, 1] * garments.vertex_areas).sum() / garments.vertex_areas.sum())
    assert value(step, x, "gravity") == pytest.approx(weight, rel=tolerance)
    gradient = step.energies_and_gradient(x)[1]
    balanced = 1e-9 if dtype == torch.float64 else 2e-2
    assert float(gradient.abs().max()) < balanced * float(garments.vertex_masses.max())


@pytest.mark.parametrize("depth", [-1e-3, 0.0, 4e-3])
def test_a_vertex_at_depth(depth: float) -> None:
    garments = packed(sheet(3, 3))
    x = garments.rest_positions[:, [0, 2, 1]] - vector(0.5, depth, 0.5)
    step = potential_of(garments, at_rest(garments, x), collider(FLOOR, FLOOR_FACES))
    expected = 5e3 / REFERENCE_AREA * 1.0 * (2e-3 + depth) ** 3
    assert value(step, x, "collision") == pytest.approx(expected, rel=1e-10)
    on_ground = potential_of(garments, at_rest(garments, x), collider(FLOOR - [0, 5, 0], FLOOR_FACES), ground=0.0)
    assert value(on_ground, x, "collision") == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(("motion", "slip"), [((0, 0, 0), 0.02), ((0.005, 0, 0), 0.015), ((0.02, 0, 0), 0.0)])
@pytest.mark.parametrize("ground", [False, True])
def test_a_sliding_vertex(motion: tuple[float, float, float], slip: float, ground: bool) -> None:
    garments = packed(sheet(3, 3))
    x = garments.rest_positions[:, [0, 2, 1]] + vector(-0.5, 1e-3, -0.5)
    body, height = collider(FLOOR, FLOOR_FACES, np.array(motion)), None
    if ground:
        body, height, slip = collider(FLOOR - [0, 5, 0], FLOOR_FACES), 0.0, 0.02
    step = potential_of(garments, at_rest(garments, x), body, alone(Friction()), ground=height)
    smoothing = 1e-3 * DT
    length = np.sqrt((1 + 1e-4) * slip**2 + smoothing**2) - smoothing
    expected = 0.5 * EVALUATION.density * 9.81 * length
    moved = x + vector(0.02, 0.0, 0.0)
    assert value(step, moved, "friction") == pytest.approx(expected, rel=1e-10, abs=1e-15)
    lifted = potential_of(garments, at_rest(garments, x + vector(0, 3e-3, 0)), body, alone(Friction()), ground=height)
    assert value(lifted, moved, "friction") == 0.0


def test_sliding_down_is_nearly_free() -> None:
    garments = packed(sheet(3, 3))
    wall = FLOOR[:, [0, 2, 1]]
    x = garments.rest_positions + vector(0.0, 0.0, 1e-3)
    body = collider(wall, FLOOR_FACES[:, ::-1].copy())
    step = potential_of(garments, at_rest(garments, x), body)
    down = value(step, x - vector(0.0, 0.02, 0.0), "friction")
    aside = value(step, x - vector(0.02, 0.0, 0.0), "friction")
    assert down == pytest.approx(0.01 * aside, rel=0.2)


def test_by_coulomb_a_wall_holds_alike_in_all_directions_by_what_presses_it() -> None:
    garments = packed(sheet(3, 3))
    wall, apart = FLOOR[:, [0, 2, 1]], 1.2e-3
    x = garments.rest_positions + vector(0.0, 0.0, apart)
    body, law = collider(wall, FLOOR_FACES[:, ::-1].copy()), IncrementalPotential().with_friction("coulomb")
    step, smoothing = potential_of(garments, at_rest(garments, x), body, law), 1e-3 * DT
    pressed = 3 * 5e3 / REFERENCE_AREA * 1.0 * (2e-3 - apart) ** 2
    for direction in (vector(0.0, -1.0, 0.0), vector(1.0, 0.0, 0.0), vector(-0.6, 0.8, 0.0)):
        expected = 0.5 * pressed * (np.hypot(0.02, smoothing) - smoothing)
        assert value(step, x + 0.02 * direction, "friction") == pytest.approx(expected, rel=1e-9)
    above = at_rest(garments, x + vector(0.0, 0.0, 1e-3))
    assert value(potential_of(garments, above, body, law), x + vector(0.02, 0.0, 0.0), "friction") == 0.0


def test_friction_carries_the_load_of_the_step_before() -> None:
    garments = packed(sheet(3, 3))
    x = garments.rest_positions[:, [0, 2, 1]] + vector(-0.5, 1e-3, -0.5)
    body = collider(FLOOR, FLOOR_FACES)
    moved = x + vector(0.02, 0.0, 0.0)
    loaded = potential_of(garments, at_rest(garments, x), body)
    usual = potential_of(garments, at_rest(garments, x), body, alone(Friction()))
    ratio = 3 * 5e3 / REFERENCE_AREA * 1e-3**2 / (EVALUATION.density * 9.81)
    assert ratio > 1
    assert value(loaded, moved, "friction") == pytest.approx(ratio * value(usual, moved, "friction"), rel=1e-9)
    above = at_rest(garments, x + vector(0.0, 1.5e-3, 0.0))
    light = potential_of(garments, above, body)
    assert value(light, moved, "friction") == pytest.approx(value(usual, moved, "friction"), rel=1e-9)


def test_friction_carries_the_load_of_the_ground_too() -> None:
    garments = packed(sheet(3, 3))
    x = garments.rest_positions[:, [0, 2, 1]] + vector(-0.5, 1e-3, -0.5)
    body = collider(FLOOR - [0, 5, 0], FLOOR_FACES)
    moved = x + vector(0.02, 0.0, 0.0)
    loaded = potential_of(garments, at_rest(garments, x), body, ground=0.0)
    usual = potential_of(garments, at_rest(garments, x), body, alone(Friction()), ground=0.0)
    ratio = 3 * 5e3 / REFERENCE_AREA * 1e-3**2 / (EVALUATION.density * 9.81)
    assert value(loaded, moved, "friction") == pytest.approx(ratio * value(usual, moved, "friction"), rel=1e-9)


def crumpled(seed: int = 0, law: str = "paper") -> tuple[StepPotential, torch.Tensor]:
    garments = packed(tube(12, 6, 0.155, 0.5))
    body = capsule()
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(2, garments.vertex_count, 3, generator=generator, dtype=torch.float64)
    state = State(garments.rest_positions, 0.1 * noise[0], 3)
    frame = collider(body.vertices, body.faces, np.array([0.01, 0.002, 0.004]))
    tilted = {"gravity": (1.0, -9.0, 3.0), "ground": 0.0}
    step = potential_of(garments, state, frame, IncrementalPotential().with_friction(law), **tilted)
    return step, garments.rest_positions + 0.004 * noise[1]


@pytest.mark.parametrize(("name", "convention"), [*LAWS, *((name, "released") for name in NAMES)])
def test_gradient_by_hand_is_that_of_autograd(name: str, convention: str) -> None:
    step, x = crumpled(law="paper" if convention == "released" else convention)
    term = released_potential().term(name) if convention == "released" else made_of(step, name)
    frozen = step.with_contact_at(x)
    variable = x.clone().requires_grad_(True)
    energies = term.energies(frozen.step, frozen.contacts, variable)
    (expected,) = torch.autograd.grad(energies.sum(), variable)
    values, gradient = frozen.potential.term(name).energies_and_gradient(frozen.step, frozen.contacts, x)
    if convention == "released":
        values, gradient = term.energies_and_gradient(frozen.step, frozen.contacts, x)
    assert float(expected.abs().max()) > 1e-6, "the case must exercise the term"
    torch.testing.assert_close(values, energies.detach(), rtol=1e-12, atol=1e-15)
    torch.testing.assert_close(gradient, expected, rtol=1e-8, atol=1e-8 * float(expected.abs().max()))


def test_gradient_of_the_exact_potential_is_that_of_finite_differences() -> None:
    """Without frozen contacts: the nearest point moves along, which to first order changes nothing."""
    step, x = crumpled(1)
    direction = torch.randn(x.shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    h = 1e-7
    difference = (step.energies(x + h * direction).total - step.energies(x - h * direction).total) / (2 * h)
    slope = (step.energies_and_gradient(x)[1] * direction).sum()
    assert float(slope) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.parametrize(("name", "law"), LAWS)
def test_compiled_terms_give_what_their_readable_twins_give(name: str, law: str) -> None:
    step, x = crumpled(7, law)
    frozen = step.with_contact_at(x)
    term, at, contacts = made_of(step, name), frozen.step, frozen.contacts
    compiled = frozen.potential.term(name)
    assert isinstance(compiled, CompiledTerm)
    energies, gradient = term.energies_and_gradient(at, contacts, x)
    assert float(gradient.abs().max()) > 1e-6, "the case must exercise the term"
    found, slope = compiled.energies_and_gradient(at, contacts, x)
    torch.testing.assert_close(found, energies, rtol=1e-10, atol=0.0)
    torch.testing.assert_close(compiled.energies(at, contacts, x), energies, rtol=1e-10, atol=0.0)
    torch.testing.assert_close(slope, gradient, rtol=1e-10, atol=1e-10 * float(gradient.abs().max()))
    variable = x.clone().requires_grad_(True)
    (learnt,) = torch.autograd.grad(compiled.energies(at, contacts, variable).sum(), variable)
    torch.testing.assert_close(learnt, slope, rtol=0.0, atol=0.0)


def test_autograd_goes_back_to_the_start_of_a_step() -> None:
    step, x = crumpled(9)
    start = step.step.state.positions.clone().requires_grad_(True)
    at = replace(step.step, state=replace(step.step.state, positions=start))
    (slope,) = torch.autograd.grad(IncrementalPotential().of(at).energies(x).terms["inertia"].sum(), start)
    assert float(slope.abs().max()) > 0.0


def stiffness_of(name: str, frozen: StepPotential, x: torch.Tensor) -> Stiffness:
    """What the term called `name` adds, compiled."""
    only = replace(IncrementalPotential((made_of(frozen, name),)).of(frozen.step), contacts=frozen.contacts)
    return only.stiffness(x, StiffnessPattern(only.step.garments, only.elements()))


@pytest.mark.parametrize(("name", "law"), [each for each in LAWS if each[0] != "gravity"])
def test_the_compiled_stiffness_is_that_of_the_readable_twin(name: str, law: str) -> None:
    step, x = crumpled(8, law)
    frozen = step.with_contact_at(x)
    stiffness = stiffness_of(name, frozen, x)
    positive, negative = readable_stiffness(name, frozen, x)
    assert float(positive.abs().max()) > 1e-6, "the case must exercise the term"
    size = float(positive.abs().max())
    np.testing.assert_allclose(dense(stiffness.matrix()), positive.numpy(), rtol=1e-10, atol=1e-10 * size)
    with_all = dense(stiffness.matrix(1.0)) - dense(stiffness.matrix())
    np.testing.assert_allclose(with_all, negative.numpy(), rtol=1e-10, atol=1e-10 * size)
    assert (float(negative.abs().max()) > 1e-3 * size) == (name == "stretch")


@pytest.mark.parametrize(("name", "law"), [each for each in LAWS if each[0] not in ("gravity", "bending")])
def test_stiffness_is_the_derivative_of_the_gradient(name: str, law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exact for all but bending (Gauss-Newton), deep contacts and slip (changed on purpose)."""
    monkeypatch.setattr(friction, "SOFTENING", 1.0)
    monkeypatch.setattr(Friction, "loops", element_loops(friction._vertex, 1))
    step, x = crumpled(2, law)
    x = step.step.state.positions + 0.1 * (x - step.step.state.positions)
    frozen = step.with_contact_at(x)
    at, contacts = frozen.step, frozen.contacts
    if name == "collision":
        x = x.clone()
        planes = contacts.next
        assert planes is not None
        x += (1.8e-3 - planes.signed_distance(x))[:, None] * planes.normals
        at = replace(at, environment=replace(at.environment, ground=None))
        frozen = replace(frozen, step=at)
    term = made_of(frozen, name)
    direction = torch.randn(x.shape, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    h = 1e-7 if name != "friction" else 1e-9
    plus, minus = (term.energies_and_gradient(at, contacts, x + s * h * direction)[1] for s in (1, -1))
    product = torch.from_numpy(times(stiffness_of(name, frozen, x).matrix(1.0), direction.numpy()))
    expected = (plus - minus) / (2 * h)
    torch.testing.assert_close(product, expected, rtol=1e-4, atol=1e-5 * float(expected.abs().max()))


@pytest.mark.parametrize("name", ["stretch", "bending", "collision", "friction"])
def test_the_positive_part_is_positive_semi_definite(name: str) -> None:
    step, x = crumpled(3)
    values = np.linalg.eigvalsh(dense(stiffness_of(name, step.with_contact_at(x), x).matrix()))
    assert values.min() > -1e-10 * values.max()


def test_stretch_and_bending_do_not_feel_rigid_motion() -> None:
    step, x = crumpled(4)
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))
    turn = turn * torch.det(turn)
    moved = x @ turn.T + vector(3.0, -2.0, 5.0)
    for name in ("stretch", "bending"):
        assert value(step, moved, name) == pytest.approx(value(step, x, name), rel=1e-9)


def test_inner_forces_and_torques_sum_to_zero() -> None:
    step, x = crumpled(5)
    for term in (IncrementalPotential().term("stretch"), IncrementalPotential().term("bending")):
        force = term.energies_and_gradient(step.step, step.contacts, x)[1]
        size = float(force.abs().sum())
        assert float(force.sum(0).abs().max()) < 1e-12 * size
        assert float(torch.linalg.cross(x, force).sum(0).abs().max()) < 1e-12 * size


def test_collision_does_not_grow_with_resolution() -> None:
    energies = []
    for n in (8, 32):
        garments = packed(sheet(n, n))
        x = garments.rest_positions[:, [0, 2, 1]] - vector(0.5, 1e-3, 0.5)
        step = potential_of(garments, at_rest(garments, x), collider(FLOOR, FLOOR_FACES))
        energies.append(value(step, x, "collision"))
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)


def test_released_collision_counts_every_vertex_alike() -> None:
    garments = packed(sheet(4, 4))
    x = garments.rest_positions[:, [0, 2, 1]] - vector(0.5, 0.0, 0.5)
    body = collider(FLOOR, FLOOR_FACES)
    step = potential_of(garments, at_rest(garments, x), body, released_potential())
    assert value(step, x, "collision") == pytest.approx(25 * 5e3 * 8e-9, rel=1e-10)


def test_regions_left_out_of_contact_cost_nothing() -> None:
    garments = packed(sheet(3, 3))
    body = capsule(count=12)
    x = garments.rest_positions * 0.05
    off = collider(body.vertices, body.faces, contact=np.asarray(body.vertices[:, 1] < -0.2))
    step = potential_of(garments, at_rest(garments, x), off)
    assert value(step, x, "collision") == 0.0
    on = potential_of(garments, at_rest(garments, x), collider(body.vertices, body.faces))
    assert value(on, x, "collision") > 1.0


def test_two_garments_packed_are_two_garments_apart() -> None:
    first, second = tube(10, 4, 0.155, 0.4), tube(16, 6, 0.152, 0.5)
    small, large = capsule(count=10), capsule(count=14)
    away = np.array([0.1, 0.0, 0.0])
    bodies = [(small.vertices, small.faces), (large.vertices + away, large.faces)]
    both = packed(first, second)
    generator = torch.Generator().manual_seed(2)
    x = both.rest_positions + 0.003 * torch.randn(both.vertex_count, 3, generator=generator, dtype=torch.float64)
    cut = both.vertex_offsets[1]
    together = potential_of(both, collider=colliders(bodies, [0, 1], np.array([0.004, 0, 0])), ground=0.0)
    energies, gradient = together.energies_and_gradient(x)
    for g, (mesh, body, rows) in enumerate([(first, bodies[0], slice(0, cut)), (second, bodies[1], slice(cut, None))]):
        frame = collider(*body, np.array([0.004, 0, 0]))
        step = potential_of(packed(mesh), collider=frame, ground=0.0)
        alone_energies, alone_gradient = step.energies_and_gradient(x[rows])
        for name, term in energies.terms.items():
            assert float(term[g]) == pytest.approx(float(alone_energies.terms[name][0]), rel=1e-10, abs=1e-15)
        torch.testing.assert_close(gradient[rows], alone_gradient, rtol=1e-9, atol=1e-12)
