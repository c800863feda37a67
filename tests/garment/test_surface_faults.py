"""What others' meshes are made of besides one layer of sewn cloth is told, and mended where that is safe."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cloth_shapes import CLOTH, quad_tube, saved, triangle_tube
from scipy.spatial import cKDTree

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.errors import InputError, InputNote, InputWarning
from pb4u.garment.diagnosis import Finding, diagnose
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import read_garment
from pb4u.garment.library import build_garment
from pb4u.garment.repair import repair
from pb4u.garment.source_surface import SourceSurface
from pb4u.garment.surface_parts import gap_between, inner_layer
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import read_obj, write_obj
from pb4u.geometry.triangle_mesh import laid_flat


@pytest.fixture(scope="module")
def woman() -> ShapedBody:
    body = load_body("woman")
    assert isinstance(body, ShapedBody)
    return body


def finding(mesh: PolygonMesh, code: str) -> Finding:
    (found,) = (each for each in diagnose(mesh).findings if each.code == code)
    return found


def thick(by: float, rim: bool, around: int = 40, rows: int = 20) -> PolygonMesh:
    """A tube of two layers, the inner one nearer to the axis, closed by rims at both ends or open there."""
    outer = triangle_tube(around=around, rows=rows)
    faces, count = np.stack(outer.polygons), len(outer.vertices)
    inside = outer.vertices * [1.0 - by / 0.25, 1.0, 1.0 - by / 0.25]
    all_faces = [faces, faces[:, ::-1] + count]
    if rim:
        for row, way in ((0, 1), (rows, -1)):
            a = np.arange(around) + row * around
            b = (np.arange(around) + 1) % around + row * around
            all_faces += [
                np.column_stack([b, a, a + count])[:, ::way],
                np.column_stack([b, a + count, b + count])[:, ::way],
            ]
    return PolygonMesh(np.concatenate([outer.vertices, inside]), tuple(np.concatenate(all_faces)))


@pytest.mark.parametrize("by", [0.0005, 0.002, 0.006])
@pytest.mark.parametrize("rim", [True, False])
@pytest.mark.parametrize("first", ["outer", "inner"])
def test_the_outer_layer_of_double_cloth_is_kept(by: float, rim: bool, first: str) -> None:
    mesh, single = thick(by, rim), triangle_tube()
    if first == "inner":
        order = np.roll(np.arange(len(mesh.vertices)), len(single.vertices))
        mesh = PolygonMesh(mesh.vertices[order], tuple(np.argsort(order)[polygon] for polygon in mesh.polygons))
    assert finding(mesh, "double-layer").mendable
    mended, said, left = repair(mesh)
    assert said[0] == f"Kept the outer layer of its cloth, and dropped {len(mesh.polygons) - 1600} faces."
    assert left == ()
    assert len(mended.polygons) == len(single.polygons)
    radius = np.hypot(mended.vertices[:, 0], mended.vertices[:, 2])
    np.testing.assert_allclose(radius, 0.25, atol=1e-9)


def test_the_layer_farther_from_the_body_is_the_outer_one() -> None:
    mesh = thick(0.002, True)
    surface, around = SourceSurface.of(mesh), np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 2])
    for heights, kept in ((around, 0.25), (-around, 0.248)):
        faces = surface.faces[~inner_layer(surface, heights)]
        assert len(faces) == 1600
        np.testing.assert_allclose(around[faces], kept, atol=1e-9)


def test_simulation_tells_of_double_cloth_too(tmp_path: Path) -> None:
    path = saved(tmp_path, thick(0.002, True))
    with pytest.warns(
        InputWarning, match=rf"9\d% of the cloth is double.*keep the outer layer only with .*{path} --fix"
    ):
        read_garment(path, CLOTH)


def with_pocket() -> PolygonMesh:
    """A tube with a patch of its own vertices sewn on along three of its sides, and open at the top."""
    tube = triangle_tube()
    rows, columns = np.arange(5, 10), np.arange(8, 14)
    patch = {(r, c): r * 40 + c for r in rows for c in columns}
    vertices = list(tube.vertices)
    for (r, c), at in list(patch.items()):
        if r != rows[0] and c not in (columns[0], columns[-1]):
            patch[r, c] = len(vertices)
            vertices.append(tube.vertices[at] * [1.05, 1.0, 1.05])
    faces = []
    for r in rows[:-1]:
        for c in columns[:-1]:
            a, b, d, e = patch[r, c], patch[r, c + 1], patch[r + 1, c + 1], patch[r + 1, c]
            faces += [[a, b, d], [a, d, e]]
    return PolygonMesh(np.array(vertices), (*tube.polygons, *np.array(faces)))


def test_a_pocket_is_told_and_taken_off(tmp_path: Path) -> None:
    mesh, tube = with_pocket(), triangle_tube()
    found = finding(mesh, "non-manifold")
    assert "39 faces are sewn on there, such as a pocket or a flap" in found.sentence
    assert found.mendable
    with pytest.raises(InputError, match=r"three or more faces.*sewn on there.*remove them.* with `pb4u check"):
        read_garment(saved(tmp_path, mesh), CLOTH)
    mended, said, _ = repair(mesh)
    assert said == (
        "Removed 39 faces of parts sewn on, such as pockets or flaps.",
        "Dropped 1 face(s) without area or repeated.",
    )
    np.testing.assert_array_equal(mended.vertices, tube.vertices)
    np.testing.assert_array_equal(np.stack(mended.polygons), np.stack(tube.polygons))


@pytest.mark.parametrize("apart", [0.0006, 0.004, 0.015])
def test_the_distance_of_loose_pieces_is_told(apart: float) -> None:
    low, high = triangle_tube(low=0.5, high=0.75, rows=10), triangle_tube(low=0.75 + apart, high=1.0, rows=10)
    two = PolygonMesh(
        np.concatenate([low.vertices, high.vertices]),
        (*low.polygons, *(polygon + len(low.vertices) for polygon in high.polygons)),
    )
    gap = gap_between(SourceSurface.of(two))
    assert gap is not None
    assert gap.pairs == 40
    assert gap.along == pytest.approx(apart)
    assert (
        f"40 vertices of their borders face each other {1000 * apart:.2g} mm apart" in finding(two, "pieces").sentence
    )


def test_pieces_that_nothing_joins_are_not_to_be_pinned_at_the_waist(woman: ShapedBody) -> None:
    shirt = build_garment("tshirt", woman, 600)
    right = shirt.vertices[shirt.faces, 0].mean(axis=1) > 0.0
    count, apart = len(shirt.vertices), np.array([0.0006, 0.0, 0.0])
    two = PolygonMesh(
        np.concatenate([shirt.vertices, shirt.vertices + apart]),
        (*shirt.faces[~right], *(shirt.faces[right] + count)),
    )
    assert "of their borders face each other 0.6 mm apart" in finding(two, "pieces").sentence
    (found,) = (each for each in diagnose(two, woman).findings if each.code == "unsupported")
    assert found.fix == "join its pieces first"


@pytest.fixture
def panels(woman: ShapedBody) -> tuple[PolygonMesh, Garment]:
    """A T-shirt cut along its sides, front and back 6 cm apart and joined by threads; and the T-shirt."""
    shirt = build_garment("tshirt", woman, 1200)
    front = shirt.vertices[shirt.faces][:, :, 2].mean(axis=1) > 0.0
    count, apart = len(shirt.vertices), np.array([0.0, 0.0, 0.03])
    both = np.intersect1d(shirt.faces[front], shirt.faces[~front])
    mesh = PolygonMesh(
        np.concatenate([shirt.vertices + apart, shirt.vertices - apart]),
        (*shirt.faces[front], *(shirt.faces[~front] + count)),
        lines=np.column_stack([both, both + count]),
    )
    return mesh, shirt


def test_threads_sew_the_seams_of_panels(
    tmp_path: Path, woman: ShapedBody, panels: tuple[PolygonMesh, Garment]
) -> None:
    mesh, shirt = panels
    write_obj(tmp_path / "panels.obj", repair(mesh, woman).mesh)
    with pytest.warns(InputNote, match="lines of its file are threads of seams, up to 6 cm long; they are sewn"):
        garment = read_garment(tmp_path / "panels.obj", CLOTH)
    assert len(garment.vertices) == len(shirt.vertices)
    assert len(garment.topology.boundary_loops) == 4
    assert cKDTree(shirt.vertices).query(garment.vertices)[0].max() < 1e-6
    found = diagnose(mesh, woman)
    assert not found.is_refused
    assert found.held_by == "shoulders"
    assert "threads" in found.codes
    assert not {"pieces", "unsewn"} & set(found.codes)


def test_sewn_triangles_keep_their_shapes_at_rest(tmp_path: Path, panels: tuple[PolygonMesh, Garment]) -> None:
    mesh, _ = panels
    assert mesh.lines is not None
    right = mesh.lines[:, 0][mesh.vertices[mesh.lines[:, 0], 0] > 0.0]
    narrower = mesh.vertices.copy()
    narrower[right, 0] += 0.02
    write_obj(tmp_path / "panels.obj", replace(mesh, vertices=narrower))
    garment = read_garment(tmp_path / "panels.obj", CLOTH)
    own = laid_flat(narrower[np.stack(mesh.polygons)])
    np.testing.assert_allclose(garment.rest_shape, own, atol=1e-7)
    assert np.abs(laid_flat(garment.vertices[garment.faces]) - own).max() > 0.001


def test_threads_of_panels_far_apart_are_not_sewn(panels: tuple[PolygonMesh, Garment]) -> None:
    mesh, shirt = panels
    far = np.where(np.arange(len(mesh.vertices))[:, None] < len(shirt.vertices), 0.03, -0.03) * np.array([0, 0, 1.0])
    found = finding(replace(mesh, vertices=mesh.vertices + far), "unsewn")
    assert "longer than 10 cm" in found.fix


def test_threads_that_are_not_sewn_are_told(tmp_path: Path) -> None:
    path = saved(tmp_path, triangle_tube())
    path.write_text(path.read_text() + "l 1 2\nl 3/1 200/1 400\nl -1 5\nl x y\nl 7\n")
    mesh = read_obj(path)
    assert mesh.lines is not None
    assert mesh.lines.tolist() == [[0, 1], [2, 199], [199, 399], [839, 4]]
    # The first is an edge of the cloth, such as a seam that was drawn.
    found = finding(mesh, "unsewn")
    assert "3 lines of its file join vertices like threads of a seam, the first 2-199, 199-399, 839-4" in found.sentence
    with pytest.warns(InputWarning, match="3 lines of its file join vertices.*they are not sewn"):
        read_garment(path, CLOTH)


def test_faces_without_uvs_among_others_are_told() -> None:
    mesh = quad_tube()
    assert mesh.uvs is not None
    assert mesh.polygon_uvs is not None
    bare = tuple(np.zeros(4, dtype=np.int64) if k < 3 else corners for k, corners in enumerate(mesh.polygon_uvs))
    assert (
        "3 of its 800 faces have no UVs, the first 0, 1, "
        "2" in finding(replace(mesh, polygon_uvs=bare), "no-uvs").sentence
    )
    assert "no-uvs" not in diagnose(mesh).codes
