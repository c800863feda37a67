"""A garment of several materials: what each face, hinge and vertex has, and how files keep it."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from ball_scene import ball_scene
from tests.physics.shapes import packed, potential_of, sheet

from pb4u.errors import InputError
from pb4u.garment.material import Material
from pb4u.measures.metrics import garments_of
from pb4u.scene.packed import pack
from pb4u.scene.scene import DressedGarment
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

SOFT = Material.isotropic(density=0.1, lame_mu=2e4, lame_lambda=3e4, bending=1e-5, friction=0.2)
STIFF = Material.isotropic(density=0.4, lame_mu=6e4, lame_lambda=9e4, bending=3e-5, friction=0.8)


def halves(columns=4, rows=4):
    """A sheet whose right half is stiff, and the mask of that half."""
    garment = sheet(columns, rows, material=SOFT)
    right = garment.vertices[garment.faces][:, :, 0].mean(axis=1) > 0.5
    return garment.with_part(STIFF, right), right


def test_one_material_for_all_faces_is_that_material_alone() -> None:
    garment = sheet(3, 3, material=STIFF)
    named = replace(garment, materials=(SOFT, STIFF), face_material=np.ones(len(garment.faces), dtype=np.int64))
    one, other = pack([garment]), pack([named])
    for name in ("membrane", "bending", "friction", "vertex_masses"):
        torch.testing.assert_close(getattr(other, name), getattr(one, name), rtol=1e-12, atol=0.0)


def test_the_one_of_the_materials_needs_no_faces() -> None:
    garment = replace(sheet(3, 3, material=SOFT), materials=(STIFF,))
    assert garment.material == STIFF
    assert set(garment.of_faces("density")) == {STIFF.density}


def test_faces_hinges_and_vertices_have_their_share_of_each() -> None:
    garment, right = halves()
    assert garment.vertex_masses.sum() == pytest.approx(0.5 * (SOFT.density + STIFF.density), rel=1e-12)
    made = pack([garment])
    assert np.array_equal(made.membrane.numpy()[right], np.tile(STIFF.membrane, (right.sum(), 1)))
    sides = right[garment.topology.hinge_faces]
    assert made.bending[~sides.any(axis=1)].unique().tolist() == [SOFT.bending]
    assert made.bending[sides.all(axis=1)].unique().tolist() == [STIFF.bending]
    # Half as wide each, in series.
    between = made.bending[sides.any(axis=1) & ~sides.all(axis=1)].numpy()
    assert len(between) == 4
    assert between == pytest.approx(2.0 / (1.0 / SOFT.bending + 1.0 / STIFF.bending), rel=1e-9)
    x = garment.vertices[:, 0]
    assert made.friction[x < 0.4].unique().tolist() == pytest.approx([SOFT.friction])
    assert made.friction[x > 0.6].unique().tolist() == pytest.approx([STIFF.friction])
    border = made.friction[np.isclose(x, 0.5)]
    assert ((border > SOFT.friction) & (border < STIFF.friction)).all()


def test_the_material_that_covers_most_stands_for_the_garment() -> None:
    garment = sheet(4, 4, material=SOFT)
    right = garment.vertices[garment.faces][:, :, 0].mean(axis=1) > 0.3
    assert garment.with_part(STIFF, right).material == STIFF
    assert garment.with_part(STIFF, right).with_material(SOFT).materials == ()


def test_a_hinge_without_bending_makes_its_seam_free() -> None:
    garment = sheet(4, 4, material=SOFT)
    right = garment.vertices[garment.faces][:, :, 0].mean(axis=1) > 0.5
    limp = garment.with_part(replace(STIFF, bending_stiffness=0.0), right)
    sides = right[garment.topology.hinge_faces].any(axis=1)
    assert (limp.hinge_bending[sides] == 0.0).all()
    assert (limp.hinge_bending[~sides] == SOFT.bending).all()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_membrane_is_as_stiff_along_each_axis_as_its_moduli_say(axis: int) -> None:
    garment = sheet(5, 5, material=SOFT)
    garments = packed(replace(garment, rest_uv=garment.vertices[garment.faces][..., :2]))
    moduli = torch.tensor([900.0, 300.0, 60.0, 20.0], dtype=torch.float64)
    garments = replace(garments, membrane=moduli.expand_as(garments.membrane))
    x = garments.rest_positions.clone()
    x[:, axis] *= 1.1
    strain = (1.1**2 - 1.0) / 2.0
    energy = potential_of(garments).energies(x).terms["stretch"]
    assert float(energy) == pytest.approx(0.5 * float(moduli[axis]) * strain**2, rel=1e-10)
    x = garments.rest_positions.clone()
    x[:, axis] += 0.2 * x[:, 1 - axis]
    along, shear = 0.5 * 0.2**2, 0.5 * 0.2
    expected = 0.5 * float(moduli[1 - axis]) * along**2 + 2.0 * float(moduli[3]) * shear**2
    assert float(potential_of(garments).energies(x).terms["stretch"]) == pytest.approx(expected, rel=1e-10)


def test_a_trajectory_names_every_material_with_its_triangles() -> None:
    scene, (garment, right) = ball_scene(2), halves(10, 10)
    scene = replace(scene, garments=(DressedGarment(garment, scene.garments[0].placement),))
    header = TrajectoryHeader.of(scene, {})
    assert set(header.metadata["material"]) == {"density", "lame_mu", "lame_lambda", "bending", "thickness"}
    soft, stiff = header.metadata["materials"]
    assert {key: stiff[key] for key in asdict(STIFF)} == asdict(STIFF)
    covered = np.zeros(len(garment.faces), dtype=bool)
    for first, stop in stiff["faces"]:
        covered[first:stop] = True
    assert np.array_equal(covered, right)
    assert sum(stop - first for first, stop in soft["faces"]) == (~right).sum()
    still = Frame(garment.vertices, np.zeros_like(garment.vertices), scene.colliders[0].rest_vertices)
    (read,) = garments_of(Trajectory.collect(header, [still]))
    assert np.array_equal(read.of_faces("density"), garment.of_faces("density"))
    np.testing.assert_allclose(read.hinge_bending, garment.hinge_bending, rtol=1e-6)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"materials": (SOFT, STIFF)}, "2 materials"),
        ({"materials": (SOFT,), "face_material": [0, 1]}, "whole number for each of its 32 faces"),
        ({"materials": (SOFT,), "face_material": [1] * 32}, "0 to 0"),
        ({"materials": ("cotton",), "face_material": [0] * 32}, "'cotton'"),
    ],
)
def test_materials_that_do_not_fit_the_faces_are_refused(changed: dict, named: str) -> None:
    with pytest.raises(InputError, match=named):
        replace(sheet(4, 4), **changed)
