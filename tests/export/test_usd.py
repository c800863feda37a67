"""USD read back by pxr, and judged by its own validators."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pb4u.export.registry import export
from pb4u.export.selection import on_source
from pb4u.export.shading import SKIN, garment_colours
from pb4u.scene.trajectory import Trajectory

pxr = pytest.importorskip("pxr", reason='the "usd" extra is not installed')
from pxr import Usd, UsdGeom, UsdValidation  # noqa: E402

SUFFIXES = [".usdc", ".usda", ".usdz"]


def assert_mesh(mesh: UsdGeom.Mesh, positions: np.ndarray, faces: np.ndarray) -> None:
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
    np.testing.assert_array_equal(np.reshape(mesh.GetFaceVertexIndicesAttr().Get(), (-1, 3)), faces)
    assert mesh.GetPointsAttr().GetTimeSamples() == list(range(len(positions)))
    for t in (0, 6, len(positions) - 1):
        np.testing.assert_array_equal(mesh.GetPointsAttr().Get(t), positions[t])
        np.testing.assert_array_equal(mesh.GetExtentAttr().Get(t), [positions[t].min(axis=0), positions[t].max(axis=0)])
        normals = np.array(mesh.GetNormalsAttr().Get(t))
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert not UsdGeom.Xformable(mesh).GetOrderedXformOps()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_stage_holds_garment_and_body_over_time(trajectory: Trajectory, tmp_path: Path, suffix: str) -> None:
    export(trajectory, tmp_path / f"walk{suffix}")
    assert [p.name for p in tmp_path.iterdir()] == [f"walk{suffix}"]
    stage = Usd.Stage.Open(str(tmp_path / f"walk{suffix}"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 25.0
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 11)
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    garment, body = (UsdGeom.Mesh(stage.GetPrimAtPath(f"/Scene/{name}")) for name in ("Garment", "Body"))
    assert_mesh(garment, trajectory.positions, trajectory.faces)
    assert_mesh(body, trajectory.body_positions, trajectory.header.body_faces)
    st = UsdGeom.PrimvarsAPI(garment).GetPrimvar("st")
    assert st.GetInterpolation() == "faceVarying"
    expected = trajectory.header.uvs[trajectory.header.uv_faces].reshape(-1, 2)
    np.testing.assert_allclose(st.ComputeFlattened(), expected, atol=1e-6)
    assert len(garment.GetDisplayColorAttr().Get()) == 1


def test_each_garment_has_a_colour_of_its_own(trajectory: Trajectory, tmp_path: Path) -> None:
    upper = trajectory.positions[0][:, 1] > 0.9
    outfit = replace(trajectory, header=replace(trajectory.header, vertex_garment=upper.astype(np.int32)))
    stage = Usd.Stage.Open(str(export(outfit, tmp_path / "outfit.usda")))
    shown = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Scene/Garment")).GetPrimvar("displayColor")
    assert shown.GetInterpolation() == "uniform"
    # Colours of USD are linear.
    wanted = np.array(garment_colours(["", ""]))[upper[trajectory.faces[:, 0]].astype(int)] ** 2.2
    np.testing.assert_allclose(shown.Get(), wanted, atol=1e-6)
    (skin,) = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Body")).GetDisplayColorAttr().Get()
    np.testing.assert_allclose(skin, np.array(SKIN) ** 2.2, atol=1e-6)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_validators_of_usd_find_nothing(trajectory: Trajectory, tmp_path: Path, suffix: str) -> None:
    stage = Usd.Stage.Open(str(export(trajectory, tmp_path / f"walk{suffix}")))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 5
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetMessage() for error in found] == []


def test_normals_point_out_of_the_surface(trajectory: Trajectory, tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(export(trajectory, tmp_path / "walk.usdc")))
    normals = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Garment")).GetNormalsAttr().Get(4))
    a, b, c = (trajectory.positions[4][trajectory.faces[:, k]] for k in range(3))
    facing = np.einsum("fd,fkd->fk", np.cross(b - a, c - a), normals[trajectory.faces])
    assert (facing > 0).all()


def test_saving_in_portions_loses_nothing(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pb4u.export.usd._FRAMES_BETWEEN_SAVES", 5)
    stage = Usd.Stage.Open(str(export(trajectory, tmp_path / "walk.usdc")))
    garment = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Garment"))
    for t in range(12):
        np.testing.assert_array_equal(garment.GetPointsAttr().Get(t), trajectory.positions[t])


@pytest.mark.parametrize("padding", range(4))
def test_frames_mapped_from_any_address_are_taken(trajectory: Trajectory, tmp_path: Path, padding: int) -> None:
    header = trajectory.header.with_metadata(note="x" * padding)
    mapped = Trajectory.open(replace(trajectory, header=header).save(tmp_path / "run.npz"))
    stage = Usd.Stage.Open(str(export(mapped, tmp_path / "walk.usdc")))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Garment")).GetPointsAttr().Get(3)
    np.testing.assert_array_equal(points, trajectory.positions[3])


def test_the_author_s_mesh_and_a_mesh_without_uvs(trajectory: Trajectory, tmp_path: Path) -> None:
    carried = on_source(trajectory)
    stage = Usd.Stage.Open(str(export(carried, tmp_path / "mine.usdc")))
    garment = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Garment"))
    np.testing.assert_allclose(garment.GetPointsAttr().Get(7), carried.positions[7], atol=1e-7)
    bare = replace(trajectory, header=replace(trajectory.header, uvs=None, uv_faces=None))
    stage = Usd.Stage.Open(str(export(bare, tmp_path / "bare.usda")))
    assert not UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Scene/Garment")).HasPrimvar("st")


def test_held_frames_are_listed(broken: Trajectory, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="3 of 12 frames are not finite"):
        stage = Usd.Stage.Open(str(export(broken, tmp_path / "walk.usda")))
    assert list(stage.GetRootLayer().customLayerData["pb4u"]["held_frames"]) == [0, 5, 6]
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Garment")).GetPointsAttr()
    np.testing.assert_array_equal(points.Get(6), broken.positions[4])
