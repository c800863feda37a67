"""Alembic read back by its own library: points as float32, polygons, UVs, normals and times."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pb4u.export.registry import export
from pb4u.export.selection import on_source
from pb4u.scene.trajectory import Trajectory

alembic3d = pytest.importorskip("alembic3d", reason='the "abc" extra is not installed')
from alembic3d import Abc, AbcGeom  # noqa: E402


def meshes(path: Path) -> tuple[Any, dict[str, Any]]:
    """The archive, which has to outlive them, and the schemas of its meshes by name."""
    archive = Abc.IArchive(str(path))
    top = archive.getTop()
    return archive, {
        name: AbcGeom.IPolyMesh(top.getChild(name), f"{name}Shape").getSchema() for name in ("Garment", "Body")
    }


@pytest.mark.parametrize("fps", [24.0, 25.0, 30000 / 1001, 60.0])
def test_points_polygons_and_times_are_those_of_the_trajectory(
    trajectory: Trajectory, tmp_path: Path, fps: float
) -> None:
    trajectory = replace(trajectory, header=replace(trajectory.header, fps=fps))
    archive, read = meshes(export(trajectory, tmp_path / "walk.abc"))
    for schema, positions, faces in (
        (read["Garment"], trajectory.positions, trajectory.faces),
        (read["Body"], trajectory.body_positions, trajectory.header.body_faces),
    ):
        assert schema.getNumSamples() == trajectory.frame_count
        times = schema.getTimeSampling()
        for t in (0, 1, trajectory.frame_count - 1):
            assert times.getSampleTime(t) == pytest.approx(t / fps, abs=1e-9)
            sample = schema.getValue(Abc.ISampleSelector(t / fps))
            np.testing.assert_array_equal(np.array([tuple(p) for p in sample.getPositions()], np.float32), positions[t])
        assert set(sample.getFaceCounts()) == {3}
        # Wound the other way round, as Alembic has it.
        np.testing.assert_array_equal(np.reshape(list(sample.getFaceIndices()), (-1, 3))[:, ::-1], faces)
    normals = [tuple(n) for n in read["Garment"].getNormalsParam().getExpandedValue().getVals()]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    uvs = [tuple(p) for p in read["Garment"].getUVsParam().getExpandedValue().getVals()]
    expected = trajectory.header.uvs[trajectory.header.uv_faces[:, ::-1]].reshape(-1, 2)
    np.testing.assert_allclose(uvs, expected, atol=1e-6)
    del archive


def test_the_authors_own_mesh_is_written(trajectory: Trajectory, tmp_path: Path) -> None:
    own = on_source(trajectory)
    archive, read = meshes(export(own, tmp_path / "own.abc"))
    sample = read["Garment"].getValue(Abc.ISampleSelector(3 / own.fps))
    np.testing.assert_array_equal(np.array([tuple(p) for p in sample.getPositions()], np.float32), own.positions[3])
    del archive


def hierarchy(path: Path) -> dict[str, list[str]]:
    """Names of what lies below the top of an archive -> names of the meshes below each, which holds nothing else."""
    archive = Abc.IArchive(str(path))
    below = {}
    for transform in archive.getTop().children:
        assert AbcGeom.IXform.matches(transform.getHeader()), "Maya shows nothing of a mesh at the top"
        assert all(AbcGeom.IPolyMesh.matches(child.getHeader()) for child in transform.children)
        schema = AbcGeom.IXform(archive.getTop(), transform.getName()).getSchema()
        identity = [tuple(row) for row in schema.getValue().getMatrix()]
        np.testing.assert_array_equal(identity, np.eye(4))
        below[transform.getName()] = [child.getName() for child in transform.children]
    return below


@pytest.mark.parametrize("names", [[], ["tank top", "cardigan"], ["Body", "Body"], ["a/b", "a b"]])
def test_every_mesh_hangs_from_a_transform_of_its_own(trajectory: Trajectory, tmp_path: Path, names: list[str]) -> None:
    header = trajectory.header
    if names:
        half = len(header.rest_positions) // 2
        header = replace(
            header,
            faces=header.faces[(header.faces < half).all(axis=1) | (header.faces >= half).all(axis=1)],
            vertex_garment=np.repeat(np.arange(2, dtype=np.int32), half),
            metadata={"garments": [{"name": name} for name in names]},
            source=None,
            uvs=None,
            uv_faces=None,
        )
    below = hierarchy(export(replace(trajectory, header=header), tmp_path / "walk.abc"))
    assert len(below) == max(len(names), 1) + 1
    assert below == {name: [f"{name}Shape"] for name in below}
    assert "Body" in below
