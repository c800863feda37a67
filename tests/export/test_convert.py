"""Every format from a file that the command line wrote, with a range, a stride and the author's own mesh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.export.readers import Glb, assert_obj, mdd_frames, pc2_frames

from pb4u.export.registry import WRITERS
from pb4u.export.selection import on_source, select_frames
from pb4u.io.restricted_pickle import load_pickle
from pb4u.scene.trajectory import Trajectory

OPTIONS = ("--range", "1:12", "--every", "2", "--on", "source")


def usd_points(path: Path) -> np.ndarray:
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Garment")).GetPointsAttr()
    assert stage.GetTimeCodesPerSecond() == 12.5
    return np.array([points.Get(t) for t in range(6)])


def alembic_points(out: Path, fps: float) -> np.ndarray:
    from alembic3d import Abc, AbcGeom

    archive = Abc.IArchive(str(out))
    schema = AbcGeom.IPolyMesh(archive.getTop().getChild("Garment"), "GarmentShape").getSchema()
    samples = (schema.getValue(Abc.ISampleSelector(t / fps)) for t in range(schema.getNumSamples()))
    return np.array([[tuple(point) for point in sample.getPositions()] for sample in samples])


@pytest.mark.parametrize("suffix", [s for s in WRITERS if s not in (".png", ".jpg", ".gif", ".mp4")])
def test_convert_writes_the_author_s_mesh(convert: Callable, saved: Path, tmp_path: Path, suffix: str) -> None:
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr", reason='the "usd" extra is not installed')
    if suffix == ".abc":
        pytest.importorskip("alembic3d", reason='the "abc" extra is not installed')
    out = tmp_path / f"mine{suffix}"
    code, said = convert(saved, out, *OPTIONS)
    assert code == 0, said
    chosen = on_source(select_frames(Trajectory.open(saved), (1, 12), 2))
    expected = np.asarray(chosen.positions)
    assert expected.shape == (6, 5, 3)
    if suffix == ".obj":
        for t in (0, 3, 5):
            assert_obj(tmp_path / f"mine_{t:04d}.obj", chosen, t)
        return
    found = {
        ".npz": lambda: Trajectory.open(out).positions,
        ".pkl": lambda: load_pickle(out)["pred"],
        ".pc2": lambda: pc2_frames(out),
        ".mdd": lambda: mdd_frames(out)[1],
        ".glb": lambda: Glb(out).blended(0, "POSITION", 6)[:, :5],
        ".abc": lambda: alembic_points(out, chosen.fps),
    }.get(suffix, lambda: usd_points(out))()
    np.testing.assert_allclose(found, expected, atol=1e-3 if suffix == ".glb" else 1e-7)


def test_one_sentence_on_standard_error(convert: Callable, saved: Path, tmp_path: Path) -> None:
    for name, says in (("mine.xyz", ".usdc"), ("absent/mine.glb", "does not exist")):
        code, said = convert(saved, tmp_path / name)
        assert code == 1
        assert says in said
        assert len(said.strip().splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]
