"""What holds for every format: names, failures that leave nothing, frames that are not finite."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest
from tests.export.readers import pc2_frames

from pb4u.errors import InputError, InputWarning, MissingExtraError
from pb4u.export.finite_frames import hold_finite
from pb4u.export.registry import WRITERS, check_target, export, written_files
from pb4u.export.still_renderer import render
from pb4u.export.view import View
from pb4u.scene.trajectory import Trajectory
from pb4u.scene.trajectory_file import TrajectoryWriter

PICTURES = {".png", ".jpg", ".gif", ".mp4"}
DATA_SUFFIXES = [suffix for suffix in WRITERS if suffix not in PICTURES]


@contextmanager
def small_disk() -> Iterator[None]:
    """No file can grow beyond 4 KB, as on a disk that runs full; not even a log that the tests print to."""
    resource = pytest.importorskip("resource", reason="file size limits are a POSIX notion")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # What is imported meanwhile would be kept as bytecode that is cut off, for every later test.
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = kept


def skip_without_usd(suffix: str) -> None:
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr", reason='the "usd" extra is not installed')


def test_a_format_is_known_without_importing_its_writer_and_names_functions_that_there_are() -> None:
    heavy = "{'numpy', 'torch', 'PIL', 'pxr'} & set(sys.modules)"
    told = subprocess.run(
        [sys.executable, "-c", f"import sys, pb4u.export.registry as r; print(r.formats_help()); assert not {heavy}"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert all(suffix in told for suffix in WRITERS)
    for form in WRITERS.values():
        assert all(callable(resolve_name(name)) for name in (form.writer, form.check, form.files) if name)


def test_an_unknown_suffix_lists_the_known(trajectory: Trajectory, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        export(trajectory, tmp_path / "walk.xyz")
    assert all(suffix in str(refused.value) for suffix in WRITERS)


@pytest.mark.parametrize("suffix", [*DATA_SUFFIXES, ".PC2"])
def test_the_files_told_are_those_written(trajectory: Trajectory, tmp_path: Path, suffix: str) -> None:
    skip_without_usd(suffix)
    export(trajectory, tmp_path / f"walk{suffix}")
    told = written_files(tmp_path / f"walk{suffix}", trajectory.frame_count)
    assert sorted(told) == sorted(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".npz", ".obj", ".pc2", ".glb", ".usda"])
def test_a_name_that_begins_with_a_dot_is_written(trajectory: Trajectory, tmp_path: Path, suffix: str) -> None:
    skip_without_usd(suffix)
    told = written_files(export(trajectory, tmp_path / f".walk{suffix}"), trajectory.frame_count)
    assert sorted(told) == sorted(tmp_path.iterdir())


def test_a_writer_that_wrote_nothing_is_told(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pb4u.export.gltf.write_glb", lambda *_: None)
    with pytest.raises(InputError, match="nothing was written"):
        export(trajectory, tmp_path / "walk.glb")


def test_suffixes_may_be_in_capitals(trajectory: Trajectory, tmp_path: Path) -> None:
    export(trajectory, tmp_path / "WALK.PC2")
    assert (tmp_path / "WALK.PC2").stat().st_size > 32


@pytest.mark.parametrize("suffix", [".npz", ".obj", ".glb"])
def test_an_absent_folder_and_a_folder_in_the_way_are_refused(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(InputError, match="does not exist"):
        check_target(tmp_path / "absent" / f"walk{suffix}")
    (tmp_path / f"walk{suffix}").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        check_target(tmp_path / f"walk{suffix}")


@pytest.mark.parametrize(
    "suffix",
    [
        ".npz", ".obj", ".glb", ".png",
        *(pytest.param(each, marks=pytest.mark.slow) for each in sorted({*WRITERS} - {".npz", ".obj", ".glb", ".png"})),
    ],
)  # fmt: skip
def test_a_full_disk_leaves_nothing_and_is_told(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    skip_without_usd(suffix)
    # No ffmpeg: how that tells of a disk is its own.
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with small_disk(), pytest.raises(InputError, match="Cannot write") as refused:
        export(trajectory, tmp_path / f"walk{suffix}")
    assert list(tmp_path.iterdir()) == []
    assert "File too large" in str(refused.value) or "a disk that is full" in str(refused.value)


def test_a_disk_that_fills_while_frames_are_simulated_leaves_nothing(trajectory: Trajectory, tmp_path: Path) -> None:
    writing = TrajectoryWriter(tmp_path / "walk.npz", trajectory.header)
    with small_disk(), pytest.raises(InputError, match="Cannot write"), writing as writer:
        for frame in trajectory.frames:
            writer.append(frame)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", DATA_SUFFIXES)
def test_a_failure_keeps_the_file_that_was_there(trajectory: Trajectory, tmp_path: Path, suffix: str) -> None:
    skip_without_usd(suffix)
    target = tmp_path / f"walk{suffix}"
    target.write_text("before")

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    if suffix == ".npz":
        trajectory = replace(trajectory, velocities=trajectory.velocities[:3])
    with pytest.raises((KeyboardInterrupt, ValueError)):
        export(trajectory, target, stop)
    assert target.read_text() == "before"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("suffix", [".usdc", ".usda", ".usdz"])
def test_usd_without_its_extra_is_refused_in_one_sentence(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    monkeypatch.delitem(sys.modules, "pxr.Usd", raising=False)
    with pytest.raises(MissingExtraError, match=r"pb4u\[usd\]"):
        export(trajectory, tmp_path / f"walk{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_frames_that_are_not_finite_stand_still_and_are_told(broken: Trajectory, tmp_path: Path) -> None:
    with pytest.warns(InputWarning, match=r"3 of 12 frames are not finite \(0, 5-6\)"):
        export(broken, tmp_path / "walk.pc2")
    shown = [1, 1, 2, 3, 4, 4, 4, 7, 8, 9, 10, 11]
    np.testing.assert_array_equal(pc2_frames(tmp_path / "walk.pc2"), broken.positions[shown])


def test_the_obj_of_such_a_frame_says_so(broken: Trajectory, tmp_path: Path) -> None:
    with pytest.warns(InputWarning):
        export(broken, tmp_path / "walk.obj")
    marked = [t for t in range(12) if "not finite" in (tmp_path / f"walk_{t:04d}.obj").read_text()]
    assert marked == [0, 5, 6]


def test_npz_keeps_what_was_simulated(broken: Trajectory, tmp_path: Path) -> None:
    export(broken, tmp_path / "copy.npz")
    np.testing.assert_array_equal(Trajectory.open(tmp_path / "copy.npz").positions, broken.positions)


def test_no_finite_frame_at_all_is_refused(trajectory: Trajectory, tmp_path: Path) -> None:
    empty = replace(trajectory, positions=np.full_like(trajectory.positions, np.nan))
    with pytest.raises(InputError, match="No frame"):
        export(empty, tmp_path / "walk.glb")
    assert list(tmp_path.iterdir()) == []


def test_a_trajectory_cut_short_is_refused(saved: Path) -> None:
    saved.write_bytes(saved.read_bytes()[:-3000])
    with pytest.raises(InputError, match="cut short"):
        Trajectory.open(saved)


def test_a_picture_of_such_a_frame_says_so(broken: Trajectory, tmp_path: Path) -> None:
    with pytest.warns(InputWarning):
        held = hold_finite(broken)
    silent = replace(held, header=held.header.with_metadata(held_frames=[]))
    marked, plain = (list(render(each, [4, 6], View(width=160, height=200))) for each in (held, silent))
    red = [int(((p[..., 0] > 200) & (p[..., 1] < 60)).sum()) for p in (*marked, *plain)]
    assert red[1] > 0
    assert red[0] == red[2] == red[3] == 0
