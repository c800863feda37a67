"""The garments of an outfit are objects of their own in the files of studios."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.export.readers import Glb

from pb4u.export.pieces import names_apart, pieces
from pb4u.export.registry import export
from pb4u.export.shading import cloth_parts
from pb4u.scene.trajectory import Trajectory, TrajectoryHeader


@pytest.fixture
def outfit(trajectory: Trajectory) -> Trajectory:
    """The tube twice, the outer half as wide again, with UVs, as two garments."""
    header, count, faces = trajectory.header, len(trajectory.header.rest_positions), len(trajectory.faces)
    described = [
        {"name": name, "material": None, "vertices": [k * count, (k + 1) * count], "source": None,
         "triangles": [k * faces, (k + 1) * faces]}
        for k, name in enumerate(("tank top", "cardigan"))
    ]  # fmt: skip
    wide = np.array((1.5, 1.0, 1.5), dtype=np.float32)
    assert header.uvs is not None
    assert header.uv_faces is not None
    joined = replace(
        header,
        faces=np.concatenate([header.faces, header.faces + count]),
        rest_positions=np.concatenate([header.rest_positions, wide * header.rest_positions]),
        pinned=np.tile(header.pinned, 2),
        vertex_garment=np.repeat(np.arange(2, dtype=np.int32), count),
        uvs=np.concatenate([header.uvs, 0.5 * header.uvs]),
        uv_faces=np.concatenate([header.uv_faces, header.uv_faces + len(header.uvs)]),
        source=None,
        metadata={**header.metadata, "garments": described},
    )
    positions = np.concatenate([trajectory.positions, wide * trajectory.positions], axis=1)
    return Trajectory(joined, positions, np.zeros_like(positions), trajectory.body_positions)


def uv_corners(header: TrajectoryHeader) -> np.ndarray:
    assert header.uvs is not None
    assert header.uv_faces is not None
    return np.asarray(header.uvs[header.uv_faces])


def test_pieces_are_the_garments_one_by_one(outfit: Trajectory, trajectory: Trajectory) -> None:
    inner, outer = pieces(outfit.header)
    assert (inner.name, outer.name) == ("tank top", "cardigan")
    np.testing.assert_array_equal(outer.header.faces, trajectory.faces)
    np.testing.assert_array_equal(outfit.positions[0][outer.vertices][:, 1], trajectory.positions[0][:, 1])
    halved = 0.5 * uv_corners(trajectory.header)
    np.testing.assert_allclose(uv_corners(outer.header), halved)
    assert [garment["vertices"] for garment in outer.header.garments] == [[0, len(trajectory.positions[0])]]
    (look,) = outer.looks(cloth_parts(outfit.header))
    assert (look.name, look.faces.tolist()) == ("cardigan", list(range(len(trajectory.faces))))
    (alone,) = pieces(trajectory.header)
    assert alone.header is trajectory.header


def test_equal_names_are_numbered_past_those_that_are_taken() -> None:
    assert names_apart(["shirt", "shirt 2", "shirt", "shirt"], " ") == ["shirt", "shirt 2", "shirt 3", "shirt 4"]


def test_a_glb_has_a_node_for_each_garment(outfit: Trajectory, tmp_path: Path) -> None:
    glb = Glb(export(outfit, tmp_path / "outfit.glb"))
    assert [node["name"] for node in glb.json["nodes"]] == ["tank top", "cardigan", "body"]
    assert [material["name"] for material in glb.json["materials"]] == ["tank top", "cardigan", "body"]


def test_usd_has_a_mesh_for_each_garment(outfit: Trajectory, tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom

    stage = usd.Stage.Open(str(export(outfit, tmp_path / "outfit.usdc")))
    inner, outer = (UsdGeom.Mesh.Get(stage, f"/Scene/Garment/{name}") for name in ("tank_top", "cardigan"))
    assert inner.GetPrim().GetDisplayName() == "tank top"
    count = len(outfit.header.rest_positions) // 2
    for t in (0, 5):
        np.testing.assert_array_equal(inner.GetPointsAttr().Get(t), outfit.positions[t][:count])
        np.testing.assert_array_equal(outer.GetPointsAttr().Get(t), outfit.positions[t][count:])
    colours = [set(map(tuple, mesh.GetDisplayColorAttr().Get())) for mesh in (inner, outer)]
    assert len(colours[0]) == len(colours[1]) == 1
    assert colours[0] != colours[1]


def test_alembic_has_a_mesh_for_each_garment(outfit: Trajectory, tmp_path: Path) -> None:
    pytest.importorskip("alembic3d")
    from alembic3d import Abc, AbcGeom

    archive = Abc.IArchive(str(export(outfit, tmp_path / "outfit.abc")))
    top = archive.getTop()
    assert [child.getName() for child in top.children] == ["tank top", "cardigan", "Body"]
    count = len(outfit.header.rest_positions) // 2
    outer = AbcGeom.IPolyMesh(top.getChild("cardigan"), "cardiganShape").getSchema().getValue()
    np.testing.assert_array_equal(np.array([tuple(p) for p in outer.getPositions()]), outfit.positions[0][count:])
