"""Pictures as asked for by flags, and videos by an ffmpeg that the user has."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pb4u.errors import InputError, Pb4uError
from pb4u.export.picture import SIDES, View, render, write_mp4
from pb4u.export.registry import export
from pb4u.scene.trajectory import Trajectory

Convert = Callable[..., tuple[int, str]]

FAKE = """#!{python}
import sys
from collections.abc import Callable
from pathlib import Path
if "-encoders" in sys.argv:
    print(" V....D {encoder}              an encoder")
else:
    pictures = sys.stdin.buffer.read()
    if {fails}:
        sys.exit("no space left on device")
    Path(sys.argv[-1]).write_bytes(pictures)
"""


def give_ffmpeg(folder: Path, monkeypatch: pytest.MonkeyPatch, encoder: str = "libx264", fails: bool = False) -> None:
    """An ffmpeg on the path that keeps the pictures it is given as they are."""
    program = folder / "ffmpeg"
    program.write_text(FAKE.format(python=sys.executable, encoder=encoder, fails=fails))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


def test_size_background_and_colour_are_those_of_the_flags(
    convert: Convert, trajectory: Trajectory, tmp_path: Path
) -> None:
    file, out = trajectory.save(tmp_path / "t.npz"), tmp_path / "t.png"
    flags = ("--size", "90x120", "--background", "#204060", "--colour", "crimson", "--view", "back")
    assert convert(file, out, *flags) == (0, "")
    strip = np.asarray(Image.open(out).convert("RGB")).astype(int)
    assert strip.shape == (120, 5 * 90, 3)
    assert np.abs(strip[118, 2] - [0x20, 0x40, 0x60]).max() <= 2
    red = (strip[..., 0] > 100) & (strip[..., 1] < 60)
    assert red.sum() > 50


@pytest.mark.parametrize(
    ("flags", "told"),
    [
        (("--view", "above"), "one of front, left, back, right or an angle"),
        (("--view", "inf"), "an angle in degrees"),
        (("--size", "0x10"), "16 to 8192"),
        (("--size", "big"), "16 to 8192"),
        (("--colour", "bluish"), "no colour"),
    ],
)
def test_a_view_that_is_none_is_refused(
    convert: Convert, trajectory: Trajectory, tmp_path: Path, flags: tuple[str, ...], told: str
) -> None:
    code, error = convert(trajectory.save(tmp_path / "t.npz"), tmp_path / "t.png", *flags)
    assert code == 1
    assert told in " ".join(error.split())
    assert not (tmp_path / "t.png").exists()


def test_a_view_of_a_file_without_pictures_is_refused(convert: Convert, trajectory: Trajectory, tmp_path: Path) -> None:
    code, error = convert(trajectory.save(tmp_path / "t.npz"), tmp_path / "t.pc2", "--view", "back")
    assert code == 1
    assert "holds no picture" in error


@pytest.mark.parametrize("side", SIDES)
def test_the_whole_figure_is_in_the_picture_from_every_side(trajectory: Trajectory, side: str) -> None:
    view = View(width=90, height=160, azimuth=SIDES[side], background=(0.0, 0.0, 0.0))
    for picture in render(trajectory, [0, trajectory.frame_count - 1], view):
        bright = picture.max(axis=2) > 40
        assert bright.any()
        assert not bright[:, [0, -1]].any()


def test_a_video_is_h264_where_there_is_an_encoder(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view, out = View(width=64, height=96), tmp_path / "t.mp4"
    give_ffmpeg(tmp_path, monkeypatch)
    write_mp4(trajectory, out, view=view)
    drawn = np.stack(list(render(trajectory, range(trajectory.frame_count), view)))
    assert np.array_equal(np.frombuffer(out.read_bytes(), np.uint8).reshape(drawn.shape), drawn)
    pytest.importorskip("cv2", reason='the "render" extra is not installed')
    give_ffmpeg(tmp_path, monkeypatch, encoder="mpeg4")
    write_mp4(trajectory, out, view=view)
    assert out.read_bytes()[4:8] == b"ftyp"


@pytest.mark.parametrize("name", ["slow.gif", "slow.mp4"])
def test_a_film_slower_than_encoders_hold_is_refused_before_it_is_drawn(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr("pb4u.export.picture.StillRenderer", None)
    slow = replace(trajectory, header=replace(trajectory.header, fps=0.001))
    with pytest.raises(InputError, match=r"0\.002 frames per second or more, not 0\.001"):
        export(slow, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_an_ffmpeg_that_fails_is_told(trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    give_ffmpeg(tmp_path, monkeypatch, fails=True)
    with pytest.raises(Pb4uError, match="no space left"):
        write_mp4(trajectory, tmp_path / "t.mp4", view=View(width=64, height=96))
