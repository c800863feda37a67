"""PC2 and MDD, taken apart byte by byte; their OBJ read by trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.export.readers import assert_obj, mdd_frames, pc2_frames

from pb4u.body.sequence_files import load_vertex_sequence
from pb4u.errors import InputError
from pb4u.export.registry import export
from pb4u.export.selection import on_source
from pb4u.scene.trajectory import Trajectory


def test_pc2_holds_every_vertex_of_every_frame(trajectory: Trajectory, tmp_path: Path) -> None:
    export(trajectory, tmp_path / "walk.pc2")
    np.testing.assert_array_equal(pc2_frames(tmp_path / "walk.pc2"), trajectory.positions)


def test_mdd_holds_every_vertex_of_every_frame_and_the_times(trajectory: Trajectory, tmp_path: Path) -> None:
    export(trajectory, tmp_path / "walk.mdd")
    times, frames = mdd_frames(tmp_path / "walk.mdd")
    np.testing.assert_array_equal(frames, trajectory.positions)
    np.testing.assert_allclose(times, np.arange(12) / 25, atol=1e-7)
    assert load_vertex_sequence(tmp_path / "walk.mdd").fps == pytest.approx(25.0, rel=1e-5)


@pytest.mark.parametrize("suffix", [".pc2", ".mdd"])
def test_the_obj_beside_is_the_first_frame_with_uvs(trajectory: Trajectory, tmp_path: Path, suffix: str) -> None:
    export(trajectory, tmp_path / f"walk{suffix}")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["walk.obj", f"walk{suffix}"])
    assert_obj(tmp_path / "walk.obj", trajectory, 0)


def test_the_author_s_mesh_keeps_its_order(trajectory: Trajectory, tmp_path: Path) -> None:
    carried = on_source(trajectory)
    export(carried, tmp_path / "mine.pc2")
    np.testing.assert_array_equal(pc2_frames(tmp_path / "mine.pc2"), np.asarray(carried.positions))
    assert_obj(tmp_path / "mine.obj", carried, 0)


def test_an_obj_that_is_not_ours_is_not_overwritten(trajectory: Trajectory, tmp_path: Path) -> None:
    own = tmp_path / "shirt.obj"
    own.write_text("v 0 0 0\n")
    with pytest.raises(InputError, match="not from pb4u"):
        export(trajectory, tmp_path / "shirt.pc2")
    assert own.read_text() == "v 0 0 0\n"
    assert list(tmp_path.iterdir()) == [own]


def test_an_obj_of_ours_is(trajectory: Trajectory, tmp_path: Path) -> None:
    export(trajectory, tmp_path / "walk.pc2")
    export(trajectory, tmp_path / "walk.pc2")
    assert_obj(tmp_path / "walk.obj", trajectory, 0)


def test_obj_sequence_holds_every_frame(trajectory: Trajectory, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    export(trajectory, tmp_path / "walk.obj", lambda done, total: told.append((done, total)))
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"walk_{t:04d}.obj" for t in range(12)]
    assert told == [(t + 1, 12) for t in range(12)]
    for t in (0, 6, 11):
        assert_obj(tmp_path / f"walk_{t:04d}.obj", trajectory, t)
