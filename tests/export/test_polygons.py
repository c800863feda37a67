"""The author's quads and n-gons, kept by the formats that have them."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from pb4u.export.registry import export
from pb4u.export.selection import on_source
from pb4u.geometry.obj_file import read_obj
from pb4u.scene.author_mesh import Polygons, SourceTrack
from pb4u.scene.trajectory import Trajectory

POLYGONS = [[4, 2, 0], [1, 3, 4, 0], [0, 1, 2, 3, 4]]
UVS = [[5, 4, 3], [0, 1, 2, 3], [4, 3, 2, 1, 0]]

CORNERS, UV_CORNERS = (list(chain.from_iterable(rows)) for rows in (POLYGONS, UVS))


@pytest.fixture
def authored(trajectory: Trajectory) -> Trajectory:
    """The trajectory carried to an author's mesh of a triangle, a quad and a pentagon."""
    rng = np.random.default_rng(4)
    track = SourceTrack(
        faces=np.array([[4, 2, 0], [1, 3, 4], [1, 4, 0], [0, 1, 2], [0, 2, 3], [0, 3, 4]]),
        triangle=rng.integers(0, len(trajectory.faces), 5),
        barycentric=rng.dirichlet(np.ones(3), 5),
        uvs=rng.random((6, 2)),
        uv_faces=np.array([[5, 4, 3], [0, 1, 2], [0, 2, 3], [4, 3, 2], [4, 2, 1], [4, 1, 0]]),
        polygons=Polygons.of([np.array(p) for p in POLYGONS], [np.array(p) for p in UVS]),
    )
    return on_source(replace(trajectory, header=replace(trajectory.header, source=track)))


@pytest.mark.parametrize("name", ["mine.obj", "mine.pc2", "mine.mdd"])
def test_an_obj_has_the_author_s_faces_with_their_uvs(authored: Trajectory, tmp_path: Path, name: str) -> None:
    export(authored, tmp_path / name)
    written = read_obj(tmp_path / ("mine_0000.obj" if name == "mine.obj" else "mine.obj"))
    assert [p.tolist() for p in written.polygons] == POLYGONS
    assert written.polygon_uvs is not None
    assert [p.tolist() for p in written.polygon_uvs] == UVS
    np.testing.assert_allclose(written.uvs, authored.header.uvs, atol=1e-6)


def test_polygons_without_uvs(authored: Trajectory, tmp_path: Path) -> None:
    bare = replace(authored.header, uvs=None, uv_faces=None)
    export(replace(authored, header=bare), tmp_path / "mine.obj")
    written = read_obj(tmp_path / "mine_0000.obj")
    assert [p.tolist() for p in written.polygons] == POLYGONS
    assert written.uvs is None


def test_a_stage_has_the_author_s_faces_with_their_uvs(authored: Trajectory, tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr", reason='the "usd" extra is not installed')
    from pxr import Usd, UsdGeom

    assert pxr
    stage = Usd.Stage.Open(str(export(authored, tmp_path / "mine.usdc")))
    garment = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Garment"))
    assert list(garment.GetFaceVertexCountsAttr().Get()) == [3, 4, 5]
    assert list(garment.GetFaceVertexIndicesAttr().Get()) == CORNERS
    st = UsdGeom.PrimvarsAPI(garment).GetPrimvar("st").ComputeFlattened()
    np.testing.assert_allclose(st, authored.header.uvs[UV_CORNERS], atol=1e-6)


def test_a_trajectory_on_the_author_s_mesh_keeps_them(authored: Trajectory, tmp_path: Path) -> None:
    again = Trajectory.open(authored.save(tmp_path / "mine.npz"))
    assert again.header.polygons is not None
    np.testing.assert_array_equal(again.header.polygons.corners, CORNERS)
    export(again, tmp_path / "mine.obj")
    assert [p.tolist() for p in read_obj(tmp_path / "mine_0003.obj").polygons] == POLYGONS
