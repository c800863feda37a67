"""Cloth with a grain against closed forms: strips by direction, stiffening threads, bending by direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from scipy.spatial import Delaunay
from tests.physics.shapes import EVALUATION, at_rest, packed, potential_of, sheet, time_step, tube
from tests.readable_stiffness import dense, readable_stiffness

from pb4u.environment import STANDARD_GRAVITY
from pb4u.garment.garment import Garment
from pb4u.garment.grain import grained
from pb4u.garment.material import DirectionalBending, Material
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern

TWILL = Material(0.25, 3000.0, 1200.0, 90.0, 40.0, DirectionalBending(2.4e-5, 1.1e-5, 1.2e-5))
KNIT = replace(TWILL, stiffening_strain=0.03, stiffening_stiffness=9000.0)


def cut(garment: Garment, turn: float, material: Material) -> Garment:
    """A flat garment of that material, whose warp lies `turn` from the y axis towards the x axis."""
    c, s = np.cos(turn), np.sin(turn)
    flat = garment.vertices[garment.faces][..., :2] @ np.array([[c, s], [-s, c]])
    return replace(garment, material=material, rest_uv=flat)


def strip_force(material: Material, turn: float, stretch: float) -> float:
    """Force by width [N/m] of a strip along the y axis that is free to narrow and to shear."""
    garments = packed(cut(sheet(2, 2), turn, material))
    rest = garments.rest_positions

    def energy(along: float, free: np.ndarray) -> float:
        x = torch.stack([free[0] * rest[:, 0], free[1] * rest[:, 0] + along * rest[:, 1], rest[:, 2]], dim=1)
        return float(potential_of(garments).energies(x).terms["stretch"].sum())

    # By the theorem of the envelope, the slope of the least energy is that at the least.
    start = np.array([1.0, 0.0])
    options = {"xatol": 1e-9, "fatol": 1e-16, "maxiter": 2000}
    free = minimize(lambda free: energy(stretch, free), start, method="Nelder-Mead", options=options).x
    step = 1e-4
    return (energy(stretch + step, free) - energy(stretch - step, free)) / (2.0 * step)


@pytest.mark.parametrize("stretch", [1.01, 1.08])
@pytest.mark.parametrize("turn", [0.0, 45.0, 90.0])
def test_a_strip_pulls_as_its_direction_says(turn: float, stretch: float) -> None:
    c11, c22, c12, c33 = TWILL.warp_stiffness, TWILL.weft_stiffness, TWILL.coupling_stiffness, TWILL.shear_stiffness
    along_warp, along_weft, narrowing = c11 - c12**2 / c22, c22 - c12**2 / c11, c12 / c22
    bias = 4.0 / (1.0 / along_warp + 1.0 / along_weft - 2.0 * narrowing / along_warp + 1.0 / c33)
    modulus = {0.0: along_warp, 45.0: bias, 90.0: along_weft}[turn]
    strain = 0.5 * (stretch**2 - 1.0)
    expected = modulus * strain * np.sqrt(1.0 + 2.0 * strain)
    assert strip_force(TWILL, np.radians(turn), stretch) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("stretch", [1.02, 1.05, 1.2])
@pytest.mark.parametrize("turn", [0.0, 90.0])
def test_a_thread_stiffens_beyond_its_limit(turn: float, stretch: float) -> None:
    along, across = (3000.0, 1200.0) if turn == 0.0 else (1200.0, 3000.0)
    modulus = along - 90.0**2 / across
    beyond = max(stretch - 1.0 - 0.03, 0.0)
    expected = modulus * 0.5 * (stretch**2 - 1.0) * stretch + 0.5 * 9000.0 * beyond**2
    assert strip_force(KNIT, np.radians(turn), stretch) == pytest.approx(expected, rel=1e-4)


def strained(seed: int, material: Material = KNIT) -> tuple[StepPotential, torch.Tensor]:
    """A sheet cut off the grain, some of its threads beyond their limit, some slack."""
    garments = packed(cut(sheet(6, 5, 0.3, 0.25), 0.4, material))
    noise = torch.randn(garments.vertex_count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return potential_of(garments), 1.05 * garments.rest_positions + 0.004 * noise


def stretch_alone(frozen: StepPotential, x: torch.Tensor) -> Stiffness:
    only = IncrementalPotential((IncrementalPotential().term("stretch"),)).of(frozen.step)
    return only.stiffness(x, StiffnessPattern(only.step.garments, only.elements()))


def test_both_forms_of_a_stiffening_membrane_have_the_slope_of_their_energy() -> None:
    step, x = strained(1)
    stretches = torch.linalg.norm(x[step.step.garments.faces[:, 1]] - x[step.step.garments.faces[:, 0]], dim=1)
    assert bool(torch.isfinite(stretches).all())
    term, compiled = IncrementalPotential().term("stretch"), step.potential.term("stretch")
    energies, gradient = term.energies_and_gradient(step.step, step.contacts, x)
    found, slope = compiled.energies_and_gradient(step.step, step.contacts, x)
    torch.testing.assert_close(found, energies, rtol=1e-12, atol=0.0)
    torch.testing.assert_close(slope, gradient, rtol=1e-10, atol=1e-10 * float(gradient.abs().max()))
    way = torch.randn(x.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    h = 1e-7
    ahead, behind = (compiled.energies(step.step, step.contacts, x + sign * h * way) for sign in (1.0, -1.0))
    assert float((slope * way).sum()) == pytest.approx(float((ahead - behind) / (2.0 * h)), rel=1e-6)


def test_the_second_derivative_of_a_stiffening_membrane_is_that_of_differences() -> None:
    step, x = strained(3)
    compiled = step.potential.term("stretch")
    way = torch.randn(x.shape, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    h = 1e-6
    ahead, behind = (
        compiled.energies_and_gradient(step.step, step.contacts, x + sign * h * way)[1] for sign in (1.0, -1.0)
    )
    expected = ((ahead - behind) / (2.0 * h)).numpy().ravel()
    found = dense(stretch_alone(step, x).matrix(1.0)) @ way.numpy().ravel()
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())
    positive, negative = readable_stiffness("stretch", step, x)
    size = float(positive.abs().max())
    np.testing.assert_allclose(dense(stretch_alone(step, x).matrix()), positive.numpy(), atol=1e-10 * size)
    assert np.linalg.eigvalsh(dense(stretch_alone(step, x).matrix())).min() > -1e-10 * size
    assert float(negative.abs().max()) > 0.0


def test_a_step_that_begins_far_beyond_the_limit_is_solved() -> None:
    hard = replace(KNIT, stiffening_strain=0.01, stiffening_stiffness=1e5)
    garment = cut(sheet(10, 10, 0.3, 0.3), 0.3, hard)
    garments = packed(garment.with_pins(np.isin(garment.vertices[:, 1], [0.0, 0.3])))
    start = garments.rest_positions * torch.tensor([1.0, 1.25, 1.0], dtype=torch.float64)
    solution = Solver().minimise(potential_of(garments, at_rest(garments, start)), start)
    assert solution.converged


def test_equal_constants_are_the_isotropic_cloth() -> None:
    c11, c22, c12, c33 = EVALUATION.membrane
    same = replace(EVALUATION, bending_stiffness=DirectionalBending(*3 * [EVALUATION.bending / 4.0]))
    assert (c11, c22) == (c22, c12 + 2.0 * c33)
    step, x = strained(5, EVALUATION)
    turned = packed(cut(sheet(6, 5, 0.3, 0.25), 1.1, same))
    expected = step.energies(x).terms
    for name, values in potential_of(turned).energies(x).terms.items():
        torch.testing.assert_close(values, expected[name], rtol=1e-12, atol=1e-18)


def test_a_tube_is_as_stiff_upwards_as_the_warp_that_is_laid_so() -> None:
    garment = grained(tube(12, 4, 0.2, 0.4, TWILL), (0.0, 1.0, 0.0))
    garments = packed(garment)
    x = garments.rest_positions.clone()
    x[:, 1] *= 1.02
    strain = 0.5 * (1.02**2 - 1.0)
    expected = 0.5 * TWILL.warp_stiffness * strain**2 * garment.face_areas.sum()
    assert float(potential_of(garments).energies(x).terms["stretch"].sum()) == pytest.approx(expected, rel=1e-9)


def irregular(width: float, height: float, edge: float, material: Material, turn: float = 0.0) -> Garment:
    """A rectangle of triangles of all directions, its lower corner at the origin."""
    columns, rows = round(width / edge), round(height / edge)
    x, y = np.linspace(0.0, width, columns + 1), np.linspace(0.0, height, rows + 1)
    border = np.concatenate(
        [np.column_stack([x, np.full(len(x), at)]) for at in (0.0, height)]
        + [np.column_stack([np.full(len(y) - 2, at), y[1:-1]]) for at in (0.0, width)]
    )
    count = round(width * height / (edge**2 * np.sqrt(3.0) / 2.0)) - len(border) // 2
    inner = np.random.default_rng(7).uniform(0.03, 0.97, (count, 2)) * [width, height]
    points = np.concatenate([border, inner])
    # Evened out, so that no triangle is a sliver.
    for _ in range(30):
        faces = Delaunay(points).simplices
        middles, around = np.zeros_like(points), np.zeros(len(points))
        for corner in range(3):
            np.add.at(middles, faces[:, corner], points[faces].mean(axis=1))
            np.add.at(around, faces[:, corner], 1.0)
        points[len(border) :] = (middles / around[:, None])[len(border) :]
    sides = points[faces][:, 1:] - points[faces][:, :1]
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    faces = np.where(area[:, None] < 0.0, faces[:, ::-1], faces)[np.abs(area) > 1e-3 * edge**2]
    return cut(
        Garment("piece", np.column_stack([points, 0.0 * points[:, 0]]), faces.astype(np.int64), material),
        turn,
        material,
    )


@pytest.mark.parametrize(
    "bending",
    [
        DirectionalBending(2.4e-5, 1.1e-5, 1.2e-5),
        DirectionalBending(1e-5, 1e-5, 6e-6),
        DirectionalBending(3e-6, 9e-6, 5e-6),
    ],
)
def test_hinges_of_all_directions_bend_as_warp_weft_and_bias_say(bending: DirectionalBending) -> None:
    plain, grained = (irregular(0.15, 0.15, 0.004, replace(TWILL, bending_stiffness=each)) for each in (1e-5, bending))

    def energy(garment: Garment, turn: float) -> float:
        garments = packed(garment)
        x = garments.rest_positions.clone()
        # Rolled around an axis across the direction that lies `turn` from the warp.
        x[:, 2] = 0.5 * 0.1 * (np.sin(turn) * x[:, 0] + np.cos(turn) * x[:, 1]) ** 2
        return float(potential_of(garments).energies(x).terms["bending"].sum())

    for turn, stiffness in ((0.0, bending.warp), (45.0, bending.bias), (90.0, bending.weft), (135.0, bending.bias)):
        made = 1e-5 * energy(grained, np.radians(turn)) / energy(plain, np.radians(turn))
        assert made == pytest.approx(stiffness, rel=0.1)


@pytest.mark.parametrize("turn", [0.0, 45.0, 90.0])
def test_a_strip_bends_over_an_edge_as_in_astm_d1388(turn: float) -> None:
    """Peirce's formula from the angle of what hangs over gives the bending length, within 4 %.

    The sides of a narrow strip are free, so that it is softer than a plate of Poisson's ratio 1/3 by 1 - 1/9.
    """
    bending = DirectionalBending(1.6e-5, 0.7e-5, 0.8e-5)
    stiffness = {0.0: bending.warp, 45.0: bending.bias, 90.0: bending.weft}[turn]
    expected = ((1.0 - 1.0 / 9.0) * stiffness / (TWILL.density * STANDARD_GRAVITY)) ** (1.0 / 3.0)
    over, held = 2.0 * expected, 0.01
    strip = irregular(0.02, over + held, 0.0035, replace(TWILL, bending_stiffness=bending), np.radians(turn))
    lying = strip.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    garments = packed(replace(strip, vertices=lying, pinned=-lying[:, 2] <= held + 1e-9))
    x, solver = garments.rest_positions, Solver(max_iterations=200)
    for _ in range(40):
        step = IncrementalPotential().of(time_step(garments, at_rest(garments, x), dt=0.1))
        before, x = x, solver.minimise(step, x).positions
        if float((x - before).abs().max()) < 1e-6:
            break
    end = x[garments.rest_positions[:, 2] < -(over + held) + 1e-9].mean(0)
    angle = float(torch.atan2(-end[1], -end[2] - held))
    found = over * (np.cos(0.5 * angle) / (8.0 * np.tan(angle))) ** (1.0 / 3.0)
    assert found == pytest.approx(expected, rel=0.04)
