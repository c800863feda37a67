"""Point caches that grow as frames are computed: whole at every moment, and in the end what a conversion writes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.export.readers import pc2_frames

from pb4u.errors import InputError
from pb4u.export.live_caches import LiveCaches, check_live_folder
from pb4u.export.selection import on_source, resampled
from pb4u.scene.trajectory import Trajectory


@pytest.mark.parametrize("fps", [25.0, 24.0, 30.0, 60.0, 12.5])
def test_frames_come_as_soon_as_they_can_and_are_those_of_the_conversion(
    trajectory: Trajectory, tmp_path: Path, fps: float
) -> None:
    expected = on_source(resampled(trajectory, fps)).positions
    with LiveCaches(tmp_path, trajectory.header, fps) as caches:
        for t, frame in enumerate(trajectory.frames):
            caches.append(frame)
            there = pc2_frames(tmp_path / "garment.pc2")
            assert len(there) == int(t * fps / 25.0 + 1e-6) + 1
            np.testing.assert_allclose(there, expected[: len(there)], atol=1e-6)
    assert caches.frame_count == len(expected)


def test_every_garment_has_a_file_of_its_own(trajectory: Trajectory, tmp_path: Path) -> None:
    cut = np.repeat([0, 1], [30, trajectory.positions.shape[1] - 30]).astype(np.int32)
    names = [{"name": "coat/of mail"}, {"name": "coat of mail"}]
    header = replace(trajectory.header, vertex_garment=cut, source=None, metadata={"garments": names})
    with LiveCaches(tmp_path, header, 25.0, frames=4) as caches:
        for frame in trajectory.frames:
            caches.append(frame)
    inner, outer = (pc2_frames(tmp_path / name) for name in ("coat_of_mail.pc2", "coat_of_mail-2.pc2"))
    np.testing.assert_array_equal(np.concatenate([inner, outer], axis=1), trajectory.positions[:4])


def test_folders_that_hold_something_else_are_refused(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "shirt.pc2").write_bytes(b"kept")
    for folder, says in (
        (tmp_path / "mine", "holds other files"),
        (tmp_path / "mine" / "shirt.pc2", "is a file"),
        (tmp_path / "absent" / "live", "does not exist"),
    ):
        with pytest.raises(InputError, match=says):
            check_live_folder(folder)
    check_live_folder(tmp_path / "new")


def test_two_runs_do_not_write_in_one_folder(trajectory: Trajectory, tmp_path: Path) -> None:
    with LiveCaches(tmp_path, trajectory.header, 25.0) as caches:
        caches.append(next(iter(trajectory.frames)))
        with pytest.raises(InputError, match="Another process writes in"):
            LiveCaches(tmp_path, trajectory.header, 25.0)
        assert len(pc2_frames(tmp_path / "garment.pc2")) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["garment.pc2", "progress.jsonl"]
    with LiveCaches(tmp_path, trajectory.header, 25.0):
        assert len(pc2_frames(tmp_path / "garment.pc2")) == 0
