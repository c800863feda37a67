"""The solver reaches the tolerance, as fast on fine meshes as on coarse ones, and survives what is thrown at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from tests.physics.shapes import DT, at_rest, capsule, collider, nobody, packed, potential_of, sheet, time_step, tube
from tests.readable_stiffness import dense, preconditioned, readable_stiffness, times

import pb4u.physics.solver.newton_solver as solver_module
import pb4u.physics.step_potential as potential_module
from pb4u.environment import STANDARD_GRAVITY, Environment
from pb4u.errors import InputError
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.implicit_steps import implicit_steps, substep_count
from pb4u.physics.solver.linear_solver import conjugate_gradient
from pb4u.physics.solver.newton_solver import Iteration, Solver
from pb4u.physics.solver.preconditioner import PRECISION, PatchBasis, TwoLevelPreconditioner
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.bending import Bending
from pb4u.physics.terms.gravity import Gravity
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern
from pb4u.physics.terms.stretch import Stretch
from pb4u.physics.time_step import DivergedError, TimeStep, integrate, require_finite
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State


def hanging_sheet(n: int) -> tuple[PackedGarments, StepPotential, torch.Tensor]:
    """A sheet held by two corners, started with a wave in its velocity."""
    mesh = sheet(n, n, 0.5, 0.5)
    pinned = np.zeros(len(mesh.vertices), dtype=bool)
    pinned[np.flatnonzero((mesh.vertices[:, 1] == 0.5) & np.isin(mesh.vertices[:, 0], [0.0, 0.5]))] = True
    garments = packed(mesh.with_pins(pinned))
    x = garments.rest_positions
    v = torch.zeros_like(x)
    v[:, 2] = torch.sin(7 * x[:, 0]) + x[:, 1]
    step = potential_of(garments, State(x, v, 0))
    return garments, step, torch.where(garments.pinned[:, None], x, x + DT * v)


def dressed_capsule(around: int, along: int) -> tuple[PackedGarments, StepPotential, torch.Tensor]:
    """A tube on a capsule that starts to move."""
    garments = packed(tube(around, along, 0.155, 0.5))
    body = capsule(count=40)
    frame = collider(body.vertices + [0, 0.25, 0], body.faces, np.array([0.02, 0.0, 0.01]))
    step = potential_of(garments, at_rest(garments), frame)
    return garments, step, garments.rest_positions


@pytest.mark.parametrize("scene", ["sheet", "tube"])
def test_iterations_do_not_depend_on_resolution(scene: str) -> None:
    """A sixteenth of the triangle area takes less than twice the iterations, and costs the same energy."""
    coarse = hanging_sheet(12) if scene == "sheet" else dressed_capsule(24, 12)
    fine = hanging_sheet(48) if scene == "sheet" else dressed_capsule(96, 48)
    solutions = [Solver().minimise(step, start) for _, step, start in (coarse, fine)]
    assert all(s.converged and s.residual <= 1e-3 for s in solutions)
    assert solutions[1].iterations < 2 * solutions[0].iterations
    # Weight on its own is not a measure: it depends on where the origin is.
    energies = [float(s.energies.total) - float(s.energies.terms["gravity"].sum()) for s in solutions]
    assert energies[0] == pytest.approx(energies[1], rel=0.3)


def test_the_energy_falls_and_pins_stay() -> None:
    garments, step, start = hanging_sheet(16)
    seen: list[Iteration] = []
    solution = Solver().minimise(step, start, watch=seen.append)
    totals = [p.total for p in seen]
    assert all(b <= a + 1e-12 for a, b in pairwise(totals))
    assert torch.equal(solution.positions[garments.pinned], start[garments.pinned])
    assert solution.iterations == len(seen) - 1


def test_the_solution_is_a_stationary_point() -> None:
    _, step, start = hanging_sheet(8)
    solution = Solver(tolerance=1e-7, max_iterations=100).minimise(step, start)
    assert solution.converged
    direction = torch.randn(start.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    direction[step.step.garments.pinned] = 0.0
    for size in (1e-4, -1e-4):
        assert float(step.energies(solution.positions + size * direction).total) > float(solution.energies.total)


def test_refine_makes_the_iterations_asked_for() -> None:
    _, step, start = dressed_capsule(24, 12)
    noise = 0.003 * torch.randn(start.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    before = float(step.energies(start + noise).total)
    refined = Solver().minimise(step, start + noise, 3)
    assert refined.iterations == 3
    assert float(refined.energies.total) < 0.05 * before


def test_a_settled_iteration_is_the_last() -> None:
    garments, step, start = dressed_capsule(24, 12)
    noise = 0.003 * torch.randn(start.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    solved = Solver(1e-5).minimise(step, start + noise)
    weight = STANDARD_GRAVITY * float(garments.vertex_masses.sum())
    for height in (1e-3, 1e-5):
        seen: list[Iteration] = []
        settled = Solver(1e-5, settled=height).minimise(step, start + noise, watch=seen.append)
        assert 0 < settled.iterations < solved.iterations
        assert not settled.converged
        freed = [before.total - after.total for before, after in pairwise(seen)]
        assert freed[-1] <= height * weight < min(freed[:-1])
        assert 0 <= float(settled.energies.total - solved.energies.total) < height * weight


def test_free_fall_is_found() -> None:
    garments = packed(sheet(6, 6))
    free = IncrementalPotential((Stretch(), Bending(), Gravity(), Inertia()))
    step = potential_of(garments, potential=free)
    solution = Solver().minimise(step, garments.rest_positions)
    fall = torch.tensor([0.0, -9.81 * DT**2, 0.0], dtype=torch.float64)
    torch.testing.assert_close(solution.positions, garments.rest_positions + fall, rtol=0, atol=1e-5)
    assert solution.iterations <= 5


def test_cloth_between_two_surfaces_comes_to_rest() -> None:
    """Nearest points jump from one wall to the other; the iterations must end all the same."""
    garments = packed(sheet(6, 6, 0.1, 0.1))
    wall = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    vertices = np.concatenate([wall - [0, 0, 1e-3], wall + [0, 0, 1e-3]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]])
    x = garments.rest_positions.clone()
    x[:, 2] += 4e-4 * torch.sin(100 * x[:, 0])
    frame = collider(vertices, faces)
    step = potential_of(garments, at_rest(garments, x), frame)
    solution = Solver().minimise(step, x)
    assert solution.converged
    assert float(solution.positions[:, 2].abs().max()) < 5e-4


def test_a_body_that_moves_a_metre_in_a_frame_is_followed() -> None:
    garments = packed(tube(20, 10, 0.155, 0.4))
    body = capsule(count=24)
    frame = collider(body.vertices + [0, 0.2, 0], body.faces, np.array([1.0, 0.0, 0.0]))
    state = at_rest(garments)
    step = time_step(garments, state, frame)
    assert substep_count(step) >= 6
    after, solution = implicit_steps(IncrementalPotential(), Solver(), step)
    assert solution.iterations >= substep_count(step)
    assert after.frame == 1
    assert torch.isfinite(after.positions).all()
    inside = IncrementalPotential().of(step).contact_at(after.positions)
    assert inside is not None
    assert float((inside.distance < -5e-3).double().mean()) < 0.02


def test_a_solve_ends_where_it_is_told_to() -> None:
    _, step, start = dressed_capsule(20, 10)
    asked: list[torch.Tensor] = []

    def until(x: torch.Tensor) -> bool:
        asked.append(x)
        return len(asked) == 2

    solution = Solver().minimise(step, start, until=until)
    assert solution.iterations == 2
    assert torch.equal(asked[-1], solution.positions)
    assert not solution.converged


def test_one_step_is_enough_for_a_slow_body() -> None:
    garments, step, _ = dressed_capsule(20, 10)
    assert substep_count(step.step) == 1
    after, solution = implicit_steps(IncrementalPotential(), Solver(), step.step)
    torch.testing.assert_close(after.velocities, (solution.positions - garments.rest_positions) / DT)


def test_a_state_that_is_not_finite_is_named_with_its_frame() -> None:
    garments = packed(sheet(3, 3))
    x = garments.rest_positions.clone()
    x[5, 1] = torch.nan
    with pytest.raises(DivergedError, match=r"frame 7.*first vertex 5") as caught:
        require_finite(State(x, torch.zeros_like(x), 7))
    assert caught.value.frame == 7
    step = potential_of(garments, at_rest(garments, frame=6))
    with pytest.raises(DivergedError, match="frame 7"):
        Solver().minimise(step, x)


@pytest.mark.parametrize("dt", [0.0, -0.1, float("nan"), float("inf")])
def test_a_time_step_must_be_positive(dt: float) -> None:
    garments = packed(sheet(2, 2))
    state = at_rest(garments)
    with pytest.raises(InputError, match="time step"):
        time_step(garments, state, dt=dt)


def test_isolated_vertices_stay_where_they_are() -> None:
    mesh = sheet(3, 3)
    garments = packed(replace(mesh, vertices=np.vstack([mesh.vertices, [[5.0, 5.0, 5.0]]]), pinned=np.zeros(17, bool)))
    step = potential_of(garments)
    solution = Solver().minimise(step, garments.rest_positions)
    assert solution.converged
    assert solution.positions[16].tolist() == [5.0, 5.0, 5.0]


def test_integrator() -> None:
    garments = packed(sheet(1, 1).with_pins(np.arange(4) == 1), dtype=torch.float32)
    velocities = torch.zeros(4, 3)
    velocities[0, 0] = 3.0
    acceleration = torch.tensor([[0.0, -0.01, 0]] * 4, requires_grad=True)
    pins = torch.full((4, 3), 9.0)
    pins[1] = torch.tensor([0.1, 0.2, 0.3])
    state = State(torch.zeros(4, 3), velocities, 4)
    after = integrate(TimeStep(garments, state, nobody(), 0.1, Environment((0, 0, 0)), pins), acceleration)
    torch.testing.assert_close(after.positions[0], torch.tensor([0.3, -0.01, 0.0]))
    torch.testing.assert_close(after.velocities[0], torch.tensor([3.0, -0.1, 0.0]))
    torch.testing.assert_close(after.positions[1], pins[1])
    torch.testing.assert_close(after.velocities[1], pins[1] / 0.1)
    assert after.frame == 5
    after.positions.sum().backward()
    assert acceleration.grad is not None
    assert acceleration.grad[:2].tolist() == [[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]


def system(
    precision: type[np.floating] = np.float64,
) -> tuple[Stiffness, PairStiffness, TwoLevelPreconditioner, np.ndarray]:
    """A shaken sheet with two pinned corners: its stiffness, contacts, preconditioner and a right side."""
    garments, step, start = hanging_sheet(8)
    x = start + 0.01 * torch.randn(start.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    pattern = StiffnessPattern(garments, step.elements())
    stiffness, rng = step.stiffness(x, pattern), np.random.default_rng(4)
    contacts = PairStiffness(rng.integers(garments.vertex_count, size=(5, 4)), 3.0 * rng.normal(size=(5, 4, 3)))
    pairs = PairStiffness.summed([contacts], pattern.free)
    basis = PatchBasis(garments, pattern.free)
    preconditioner = TwoLevelPreconditioner(basis, stiffness.matrix(), pairs, pattern.free, precision)
    return stiffness, pairs, preconditioner, rng.normal(size=x.shape) * pattern.free[:, None]


@pytest.mark.parametrize("few", [0, 4096])
def test_the_stiffness_matrix_is_the_sum_of_its_terms_and_holds_pins(few: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(potential_module, "_FEW", few)
    garments, step, start = hanging_sheet(5)
    x = start + 0.01 * torch.randn(start.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    pattern = StiffnessPattern(garments, step.elements())
    stiffness = step.stiffness(x, pattern)
    parts = [readable_stiffness(name, step, x) for name in ("stretch", "bending", "inertia")]
    positive, negative = (torch.stack(matrices).sum(0).numpy() for matrices in zip(*parts, strict=True))
    held = np.repeat(~pattern.free, 3)
    assert held.any()
    for matrix in (positive, negative):
        matrix[held], matrix[:, held] = 0.0, 0.0
    size = positive.max()
    np.testing.assert_allclose(dense(stiffness.matrix()), positive, rtol=1e-10, atol=1e-12 * size)
    extra = np.arange(float(garments.vertex_count))
    whole = positive + 0.8 * negative + np.diag(np.repeat(extra, 3))
    damped = stiffness.matrix(0.8, extra)
    np.testing.assert_allclose(dense(damped), whole, rtol=1e-10, atol=1e-12 * size)
    vector = np.random.default_rng(0).normal(size=x.shape)
    np.testing.assert_allclose(times(damped, vector).reshape(-1), whole @ vector.reshape(-1), rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(dense(stiffness.matrix()), positive, rtol=1e-10, atol=1e-12 * size)


def test_the_preconditioner_adds_a_diagonal_and_a_coarse_solve() -> None:
    stiffness, pairs, preconditioner, residual = system()
    free = stiffness.pattern.free
    root = pairs.root(len(free)).toarray()
    whole = dense(stiffness.matrix()) + root.T @ root
    functions = np.kron(preconditioner.basis.functions.toarray(), np.eye(3))
    coarse = functions @ np.linalg.solve(functions.T @ whole @ functions, functions.T @ residual.reshape(-1))
    own = whole.reshape(len(free), 3, len(free), 3)[np.arange(len(free)), :, np.arange(len(free))]
    own[~free] = np.eye(3)
    fine = np.linalg.solve(own, residual[:, :, None]).reshape(-1)
    found = preconditioned(preconditioner, residual).reshape(-1)
    np.testing.assert_allclose(found, fine + coarse, rtol=0, atol=1e-5 * np.abs(found).max())


def readable_conjugate_gradient(
    matrix: np.ndarray,
    right: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    tolerance: float,
    max_iterations: int,
) -> tuple[np.ndarray, int, np.ndarray | None]:
    """Solution, iterations and a direction of negative curvature; of Nocedal and Wright, algorithm 7.1."""
    solution, residual = np.zeros_like(right), right.copy()
    direction = precondition(residual)
    measure = residual @ direction
    target = tolerance**2 * measure
    for iteration in range(1, max_iterations + 1):
        product = matrix @ direction
        curvature = direction @ product
        if curvature <= 0:
            return solution, iteration, direction
        solution = solution + measure / curvature * direction
        residual = residual - measure / curvature * product
        conditioned = precondition(residual)
        new_measure = residual @ conditioned
        if new_measure <= target:
            return solution, iteration, None
        direction = conditioned + new_measure / measure * direction
        measure = new_measure
    return solution, max_iterations, None


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_conjugate_gradient_solves_and_notices_negative_curvature(share: float) -> None:
    stiffness, pairs, preconditioner, right = system()
    matrix = stiffness.matrix(share)
    root = pairs.root(len(right)).toarray()
    whole = dense(matrix) + root.T @ root

    def precondition(residual: np.ndarray) -> np.ndarray:
        return preconditioned(preconditioner, residual.reshape(-1, 3)).reshape(-1)

    for tolerance, most in ((1e-6, 300), (1e-6, 3)):
        solved = conjugate_gradient(matrix, pairs, right, preconditioner, tolerance, most)
        expected = readable_conjugate_gradient(whole, right.reshape(-1), precondition, tolerance, most)
        assert solved.iterations == expected[1]
        found = solved.solution.reshape(-1)
        np.testing.assert_allclose(found, expected[0], rtol=0, atol=1e-7 * np.abs(expected[0]).max())
        assert (solved.negative is None) == (expected[2] is None)
    solved = conjugate_gradient(matrix, pairs, right, preconditioner, 1e-9, 1000)
    if share:
        assert solved.negative is not None
        assert solved.negative.reshape(-1) @ whole @ solved.negative.reshape(-1) <= 0
    else:
        assert solved.negative is None
        np.testing.assert_allclose(whole @ solved.solution.reshape(-1), right.reshape(-1), atol=1e-5)


def test_linear_solves_in_single_precision_come_as_near_as_newton_asks() -> None:
    stiffness, pairs, exact, right = system()
    single = system(PRECISION)[2]
    for share in (0.0, 0.3):
        expected = conjugate_gradient(stiffness.matrix(share), pairs, right, exact, 1e-3, 300)
        solved = conjugate_gradient(stiffness.matrix(share, precision=PRECISION), pairs, right, single, 1e-3, 300)
        assert solved.solution.dtype == np.float64
        assert abs(solved.iterations - expected.iterations) <= 1
        assert (solved.negative is None) == (expected.negative is None)
        missed = np.abs(solved.solution - expected.solution).max()
        assert missed < 1e-2 * np.abs(expected.solution).max()


def test_tangents_have_the_force_of_where_a_step_leads() -> None:
    """Laid there, the model's force of contact and friction is the true one, whatever it was where the step begins."""
    garments, step, _ = dressed_capsule(24, 12)
    generator = torch.Generator().manual_seed(0)
    x = garments.rest_positions + 1e-3 * torch.randn(garments.vertex_count, 3, generator=generator).double()
    moves = 3e-3 * torch.randn(garments.vertex_count, 3, generator=generator).double()
    frozen = step.with_contact_at(x)
    terms = tuple(term for term in frozen.potential.terms if term.name in ("collision", "friction"))
    frozen = replace(frozen, potential=replace(frozen.potential, terms=terms))
    pattern = StiffnessPattern(garments, frozen.elements())
    stiffness, slope = frozen.stiffness(x, pattern), frozen.energies_and_gradient(x)[1].numpy().copy()
    true = frozen.energies_and_gradient(x + moves)[1].numpy()
    tangents = frozen.tangents(x, pattern)
    model = slope + times(stiffness.matrix(), moves.numpy())
    wrong = []
    for _ in range(8):
        missed = np.zeros_like(slope)
        for tangent in tangents:
            tangent(moves.numpy(), stiffness, slope, missed)
        assert np.allclose(model + missed, true, rtol=0.0, atol=1e-9 * np.abs(true).max())
        model = slope + times(stiffness.matrix(), moves.numpy())
        wrong.append(np.abs(missed).max())
    assert wrong[0] > 0.1 * np.abs(true).max()
    assert np.allclose(model, true, rtol=0.0, atol=1e-9 * np.abs(true).max())
    np.linalg.cholesky(dense(stiffness.matrix(extra=np.full(garments.vertex_count, 1e-6))))


def test_a_step_onto_a_body_is_not_cut_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two iterations that look where they lead leave less energy than four that do not."""
    _, step, start = dressed_capsule(48, 24)
    least = float(Solver().minimise(step, start).energies.total)

    def left(iterations: int) -> float:
        return float(Solver().minimise(step, start, iterations).energies.total) - least

    ahead = left(2)
    monkeypatch.setattr(solver_module, "_LOOKS_AHEAD", 0)
    assert ahead < left(4)
