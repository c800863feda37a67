"""Grain: where it comes from, and that a strip answers a pull by it after every stage that a garment goes through."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.physics.shapes import potential_of, sheet

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import read_garment, read_source
from pb4u.garment.grain import grained
from pb4u.garment.material import Material
from pb4u.garment.repair import repair
from pb4u.garment.source_map import remeshed
from pb4u.garment.tacks import tacked
from pb4u.geometry.obj_file import write_obj
from pb4u.measures.metrics import garments_of
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.scene import DressedGarment
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

WEFT, WARP, COUPLING, SHEAR = 300.0, 900.0, 60.0, 20.0


CLOTH = Material(0.1, WARP, WEFT, COUPLING, SHEAR, 1e-5)


def expected(angle: float) -> float:
    """Young's modulus [N/m] of a strip whose warp runs at an angle [rad] to the pull."""
    one, two = WEFT - COUPLING**2 / WARP, WARP - COUPLING**2 / WEFT
    s, c = np.sin(angle) ** 2, np.cos(angle) ** 2
    return float(1.0 / (c**2 / two + s**2 / one + s * c * (1.0 / SHEAR - 2.0 * COUPLING / (WEFT * WARP - COUPLING**2))))


def young(garments: PackedGarments, number: int = 0) -> float:
    """Young's modulus [N/m] along x of a flat sheet of them, by the energy of the softest even strain."""
    potential, rest = potential_of(garments), garments.rest_positions
    area, pull = float(garments.face_areas[garments.face_garment == number].sum()), 1e-3

    def energy(others: np.ndarray) -> float:
        x = rest.clone()
        x[:, 0] += pull * rest[:, 0] + pull * others[1] * rest[:, 1]
        x[:, 1] += pull * others[0] * rest[:, 1]
        return float(potential.energies(x).terms["stretch"].reshape(-1)[number]) / (0.5 * pull**2 * area)

    return float(minimize(energy, np.zeros(2), tol=1e-8).fun)


def strip(angle: float, scale: float = 1.0) -> Garment:
    """A sheet whose UVs are turned so that its warp runs at an angle [rad] to x; its faces begin at any corner."""
    made = sheet(6, 4, 0.3, 0.2, CLOTH)
    first = np.arange(len(made.faces))[:, None]
    made = replace(made, faces=np.take_along_axis(made.faces, (first + np.arange(3)) % 3, axis=1))
    x, y = made.vertices[:, 0], made.vertices[:, 1]
    c, s = np.cos(angle), np.sin(angle)
    return replace(made, uvs=scale * np.column_stack([s * x - c * y, c * x + s * y]), uv_faces=made.faces)


ANGLES = pytest.mark.parametrize("angle", [0.0, 0.25 * np.pi, 0.5 * np.pi])


@ANGLES
def test_a_strip_answers_a_pull_by_its_grain(angle: float) -> None:
    assert young(pack([grained(strip(angle))])) == pytest.approx(expected(angle), rel=0.01)


def of_uvs(garment: Garment, tmp_path: Path) -> Garment:
    return grained(garment)


def in_other_triangles(garment: Garment, tmp_path: Path) -> Garment:
    other = grained(remeshed(garment, 150))
    assert other.uvs is None
    return other


def tacked_to_itself(garment: Garment, tmp_path: Path) -> Garment:
    """Two halves of the strip that a tack makes one again."""
    right = garment.vertices[garment.faces][..., 0].mean(axis=1) > 0.15
    size = len(garment.vertices)
    faces = np.where(right[:, None], garment.faces + size, garment.faces)
    used = np.unique(faces)
    torn = Garment(
        "torn", np.tile(garment.vertices, (2, 1))[used], np.searchsorted(used, faces), CLOTH,
        uvs=garment.uvs, uv_faces=garment.uv_faces,
    )  # fmt: skip
    ends = [(a, a + size) for a in np.flatnonzero(np.isclose(garment.vertices[:, 0], 0.15))]
    sewn = tacked(torn, [(int(np.searchsorted(used, a)), int(np.searchsorted(used, b))) for a, b in ends])
    assert len(sewn.vertices) == size
    assert not sewn.has_grain
    return grained(sewn)


def mended(garment: Garment, tmp_path: Path) -> Garment:
    """As `check --fix` gives it: a face was there twice, another was turned over."""
    mesh = garment.mesh
    broken = [polygon[::-1] if k == 7 else polygon for k, polygon in enumerate((*mesh.polygons, mesh.polygons[0]))]
    uvs = [polygon[::-1] if k == 7 else polygon for k, polygon in enumerate((*mesh.polygon_uvs, mesh.polygon_uvs[0]))]
    write_obj(tmp_path / "broken.obj", replace(mesh, polygons=tuple(broken), polygon_uvs=tuple(uvs)))
    fixed, said, _ = repair(read_source(tmp_path / "broken.obj"))
    assert len(said) == 2
    write_obj(tmp_path / "fixed.obj", fixed)
    return grained(read_garment(tmp_path / "fixed.obj", CLOTH))


def given(garment: Garment, tmp_path: Path) -> Garment:
    """By a direction, of UVs that say nothing."""
    _, v = np.linalg.lstsq(garment.uvs, garment.vertices[:, :2], rcond=None)[0]
    return grained(replace(garment, uvs=None, uv_faces=None), (*v, 0.3))


@ANGLES
@pytest.mark.parametrize("stage", [in_other_triangles, tacked_to_itself, mended, given])
def test_grain_lives_as_long_as_the_garment(stage, angle: float, tmp_path: Path) -> None:
    made = stage(strip(angle), tmp_path)
    assert made.has_grain
    assert young(pack([made])) == pytest.approx(expected(angle), rel=0.01)
    batch = pack([grained(strip(angle + 0.25 * np.pi)), made])
    assert young(batch, 1) == pytest.approx(expected(angle), rel=0.01)


@ANGLES
def test_a_trajectory_keeps_the_grain_in_its_file(angle: float, tmp_path: Path) -> None:
    from ball_scene import ball_scene

    scene, garment = ball_scene(2), grained(strip(angle))
    for made in (garment, strip(angle)):
        scene = replace(scene, garments=(DressedGarment(made, scene.garments[0].placement),))
        still = Frame(made.vertices, np.zeros_like(made.vertices), scene.colliders[0].rest_vertices)
        Trajectory.collect(TrajectoryHeader.of(scene, {}), [still]).save(tmp_path / "a.npz")
        (read,) = garments_of(Trajectory.open(tmp_path / "a.npz"))
        assert read.has_grain == made.has_grain
        if made.has_grain:
            assert young(pack([read])) == pytest.approx(expected(angle), rel=0.01)


def test_packed_uvs_are_no_grain_and_the_cloth_is_then_the_same_in_all_directions() -> None:
    for scale in (0.5, 1.1):
        assert not grained(strip(0.0, scale)).has_grain
    turned = [young(pack([strip(angle, 0.5)])) for angle in (0.0, 0.4)]
    assert turned[0] == pytest.approx(turned[1], rel=1e-9)
    assert expected(0.25 * np.pi) < turned[0] < WARP
    kept = pack([replace(strip(0.0), material=Material.isotropic(0.1, 2e4, 3e4, 1e-5))])
    np.testing.assert_array_equal(kept.membrane[0], kept.garments[0].material.membrane)


def test_a_face_across_the_direction_follows_its_neighbours() -> None:
    """As a sheet that lies over a shoulder."""
    made = sheet(4, 6, 0.2, 0.3, CLOTH)
    tilt = np.radians([0.0, 0.0, 30.0, 60.0, 90.0, 90.0])
    row = np.rint(made.vertices[:, 1] / 0.05).astype(int)
    y, z = (np.concatenate([[0.0], np.cumsum(0.05 * way(tilt))])[row] for way in (np.cos, np.sin))
    bent = replace(made, vertices=np.column_stack([made.vertices[:, 0], y, z]))
    turned, flat = grained(bent, (0.0, 1.0, 0.0)).rest_shape, made.vertices[made.faces][..., :2]
    np.testing.assert_allclose(turned - turned[:, :1], flat - flat[:, :1], atol=1e-12)


def test_a_direction_for_what_has_a_grain_is_refused() -> None:
    with pytest.raises(InputError, match="leave out --grain"):
        grained(grained(strip(0.0)), (0.0, 1.0, 0.0))
