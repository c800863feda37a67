"""Every format that is written, read by a library that is not ours; a format without such a reader fails here.

What validators say of USD and GLB is in their own tests; PC2 and MDD have no library on PyPI but Blender.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.export.readers import mdd_frames, pc2_frames

from pb4u.export.registry import WRITERS, export
from pb4u.export.view import View
from pb4u.scene.trajectory import Trajectory

T = 3


def npz(path: Path) -> np.ndarray:
    with np.load(path, allow_pickle=False) as file:
        return file["positions"][T]


def obj(path: Path) -> np.ndarray:
    mesh = trimesh.load(path.with_name(f"{path.stem}_{T:04d}.obj"), process=False)
    return np.asarray(mesh.vertices)[mesh.faces]


def pc2(path: Path) -> np.ndarray:
    faces = trimesh.load(path.with_suffix(".obj"), process=False, maintain_order=True)
    assert len(faces.faces)
    return pc2_frames(path)[T]


def mdd(path: Path) -> np.ndarray:
    return mdd_frames(path)[1][T]


def abc(path: Path) -> np.ndarray:
    pytest.importorskip("alembic3d", reason='the "abc" extra is not installed')
    from alembic3d import Abc, AbcGeom

    archive = Abc.IArchive(str(path))
    schema = AbcGeom.IPolyMesh(archive.getTop().getChild("Garment"), "GarmentShape").getSchema()
    sample = schema.getValue(Abc.ISampleSelector(T / 25.0))
    return np.array([tuple(place) for place in sample.getPositions()])


def usd(path: Path) -> np.ndarray:
    pytest.importorskip("pxr", reason='the "usd" extra is not installed')
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    return np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Garment")).GetPointsAttr().Get(T))


def glb(path: Path) -> np.ndarray:
    """Of the first frame: trimesh blends no targets; the Khronos validator judges these in another test."""
    mesh = trimesh.load(path, process=False).geometry["garment"]
    return np.asarray(mesh.vertices)[mesh.faces]


def pkl(path: Path) -> np.ndarray:
    return np.asarray(pickle.loads(path.read_bytes())["pred"])[T]


def picture(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        image.load()
        return np.asarray(image.convert("RGB"))


def video(path: Path) -> np.ndarray:
    cv2 = pytest.importorskip("cv2", reason='the "render" extra is not installed')
    film = cv2.VideoCapture(str(path))
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(25.0)
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1])
    assert len(frames) == 12
    return frames[T]


READERS: dict[str, Callable[[Path], np.ndarray]] = {
    ".npz": npz, ".obj": obj, ".pc2": pc2, ".mdd": mdd, ".abc": abc, ".usdc": usd, ".usda": usd, ".usdz": usd,
    ".glb": glb, ".pkl": pkl, ".png": picture, ".jpg": picture, ".gif": picture, ".mp4": video,
}  # fmt: skip


@pytest.mark.parametrize("suffix", sorted(WRITERS))
def test_a_second_program_reads_what_was_written(trajectory: Trajectory, tmp_path: Path, suffix: str) -> None:
    drawn = WRITERS[suffix].drawn
    options = {"view": View(width=64, height=96)} if drawn else {}
    found = READERS[suffix](export(trajectory, tmp_path / f"walk{suffix}", **options))
    if drawn:
        assert found.shape[0] == 96
        assert np.ptp(found) > 50
        return
    frame = trajectory.positions[0 if suffix == ".glb" else T]
    wanted = frame[trajectory.faces] if found.ndim == 3 else frame
    np.testing.assert_allclose(found, wanted, atol=2e-6)
