"""Pictures as asked for by flags, and videos by an ffmpeg that the user has."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_erosion

from pb4u.errors import InputError, MissingExtraError, Pb4uError
from pb4u.export.camera import FIELD_OF_VIEW, Camera
from pb4u.export.picture import save_gif, write_mp4
from pb4u.export.registry import check_target, export
from pb4u.export.shading import LOOKS
from pb4u.export.still_renderer import render
from pb4u.export.video_writer import open_video
from pb4u.export.view import SIDES, View
from pb4u.scene.trajectory import Trajectory

Convert = Callable[..., tuple[int, str]]

FAKE = """#!{python}
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
if "-encoders" in sys.argv:
    for encoder in {encoders}:
        print(f" V....D {{encoder}}              an encoder")
else:
    pictures = sys.stdin.buffer.read()
    if "null" in sys.argv:
        sys.exit(not any(encoder in sys.argv for encoder in {working}))
    if {fails}:
        sys.exit("no space left on device")
    Path(sys.argv[-1]).write_bytes(pictures)
"""


def give_ffmpeg(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    listed: Sequence[str] = ("libx264",),
    working: Sequence[str] = ("libx264",),
    fails: bool = False,
) -> None:
    """An ffmpeg on the path that keeps the pictures it is given as they are."""
    program = folder / "ffmpeg"
    program.write_text(FAKE.format(python=sys.executable, encoders=[*listed], working=[*working], fails=fails))
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
        (("--elevation", "95"), "0 to 90 degrees"),
        (("--elevation", "nan"), "0 to 90 degrees"),
        (("--turntable", "inf"), "must be finite"),
        (("--size", "0x10"), "16 to 8192"),
        (("--size", "big"), "WIDTHxHEIGHT"),
        (("--colour", "bluish"), "not a colour"),
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
    assert "is not a picture" in error


@pytest.mark.parametrize(
    ("side", "elevation", "width", "height"),
    [
        ("front", 0.0, 90, 160), ("front", 90.0, 200, 60), ("back", 8.0, 200, 60), ("back", 50.0, 60, 200),
        ("left", 8.0, 60, 200), ("left", 90.0, 90, 160), ("right", 0.0, 200, 60), ("right", 50.0, 90, 160),
    ],
)  # fmt: skip
def test_the_whole_figure_is_in_the_picture_from_every_side(
    long_figure: Trajectory, side: str, elevation: float, width: int, height: int
) -> None:
    view = View(width, height, SIDES[side], elevation, background=(0.0, 0.0, 0.0))
    for picture in render(long_figure, [0, long_figure.frame_count - 1], view):
        bright = picture.max(axis=2) > 40
        assert bright.any()
        assert not bright[:, [0, -1]].any()
        assert not bright[[0, -1]].any()
        # It fills the picture as well, one way or the other.
        assert (
            max(np.ptp(np.flatnonzero(bright.any(axis=1))) / height, np.ptp(np.flatnonzero(bright.any(axis=0))) / width)
            > 0.4
        )


def test_cloth_that_is_drawn_without_its_body_fills_the_picture(trajectory: Trajectory) -> None:
    view = View(120, 120, show_body=False, background=(0.0, 0.0, 0.0))
    (picture,) = render(trajectory, [0], view)
    rows, columns = (np.flatnonzero((picture.max(axis=2) > 40).any(axis=axis)) for axis in (1, 0))
    assert max(np.ptp(rows), np.ptp(columns)) > 0.75 * 120
    assert rows.min() > 0
    assert rows.max() < 119


@pytest.fixture
def long_figure(trajectory: Trajectory) -> Trajectory:
    """The same with cloth and body drawn out to 2.4 m along z, as of one who lies or lunges."""
    stretch = np.array([1.0, 1.0, 6.0], dtype=np.float32)
    return replace(
        trajectory, positions=trajectory.positions * stretch, body_positions=trajectory.body_positions * stretch
    )


@pytest.mark.parametrize("fabric", ["cotton", "denim", "wool", "jersey", "leather"])
def test_folds_are_seen_in_any_colour(trajectory: Trajectory, fabric: str) -> None:
    """The spread of luminance on folded cloth is a good part of its mean, whichever way the folds run to the camera."""
    view = View(140, 200, 0.0, show_body=False, cloths=(LOOKS[fabric].colour,), background=(1.0, 0.0, 1.0), weave=False)
    for shown in render(trajectory, [0, 4, 8], view):
        cloth = binary_erosion(np.abs(shown.astype(int) - [255, 0, 255]).max(axis=2) > 60, iterations=2)
        luminance = shown[cloth] @ [0.2126, 0.7152, 0.0722]
        assert len(luminance) > 2000
        assert luminance.std() > 0.18 * luminance.mean()


@pytest.mark.parametrize("frame", [0, 1])
def test_one_who_reaches_aside_fills_the_picture_still_and_the_cloth_is_whole(frame: int) -> None:
    """Two frames of a figure 1.8 m high: one arm out, then both."""
    rng = np.random.default_rng(2)
    trunk = rng.uniform([-0.2, 0.0, -0.15], [0.2, 1.8, 0.15], (400, 3))
    arm = rng.uniform([0.2, 1.35, -0.05], [0.9, 1.45, 0.05], (60, 3))
    bodies = np.stack([np.concatenate([trunk, each, arm]) for each in (0.5 * arm, arm * [-1.0, 1.0, 1.0])])
    cloth = np.repeat(rng.uniform([-0.4, 0.8, -0.2], [0.45, 1.5, 0.2], (1, 90, 3)), 2, axis=0)
    header = SimpleNamespace(metadata={})
    figure: Any = SimpleNamespace(
        positions=cloth, body_positions=bodies, metadata=header.metadata, frame_count=2, header=header
    )
    view = View(azimuth=0.0, elevation=0.0)
    camera = Camera(figure, view, [frame])

    def seen(points: np.ndarray) -> np.ndarray:
        """Places (points, 2) in the picture, from -1 to 1."""
        at = points - camera.target(frame)
        right, up, towards = (at @ axis for axis in camera.axes(frame))
        half = np.tan(np.deg2rad(FIELD_OF_VIEW / 2)) * (camera.distance - towards)
        return np.stack([right / half * view.height / view.width, up / half], axis=1)

    assert np.abs(seen(cloth[frame])).max() < 1.0
    body = seen(bodies[frame])
    assert 0.75 < np.ptp(body[:, 1]) / 2.0 <= 1.0
    assert np.abs(body[:, 1]).max() < 1.0
    # One arm has room when the camera looks past the trunk.
    assert (np.abs(body[:, 0]).max() < 1.0) == (frame == 0)


def test_cloth_without_a_body_is_drawn(trajectory: Trajectory, tmp_path: Path) -> None:
    header = replace(
        trajectory.header, body_faces=np.zeros((0, 3), dtype=np.int64), body_contact=np.zeros(0, dtype=bool)
    )
    bare = replace(trajectory, header=header, body_positions=np.zeros((trajectory.frame_count, 0, 3), np.float32))
    out = export(bare, tmp_path / "t.png", view=View(60, 90))
    strip = np.asarray(Image.open(out).convert("RGB")).astype(int)
    drawn = np.abs(strip - strip[0, 0]).max(axis=2) > 40
    assert all(panel.sum() > 100 for panel in np.split(drawn, 5, axis=1))


def test_each_garment_takes_the_colour_given_for_it(trajectory: Trajectory) -> None:
    lower = trajectory.positions[0][:, 1] < 0.9
    two = replace(trajectory, header=replace(trajectory.header, vertex_garment=lower.astype(np.int32)))
    view = View(80, 120, cloths=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), show_body=False)
    picture = next(iter(render(two, [0], view))).astype(int)
    red, green = (picture[..., k] > 2 * picture[..., 1 - k] for k in (0, 1))
    assert min(red.sum(), green.sum()) > 100
    assert np.flatnonzero(red.any(axis=1)).mean() < np.flatnonzero(green.any(axis=1)).mean()


def drawn(trajectory: Trajectory, view: View) -> np.ndarray:
    return np.stack(list(render(trajectory, range(trajectory.frame_count), view)))


def test_a_video_is_h264_where_an_encoder_for_it_works(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view, out, told = View(width=64, height=96), tmp_path / "t.mp4", list[str]()
    give_ffmpeg(tmp_path, monkeypatch, listed=("libx264", "libopenh264"), working=("libopenh264",))
    export(trajectory, out, view=view, say=told.append)
    pictures = drawn(trajectory, view)
    assert np.array_equal(np.frombuffer(out.read_bytes(), np.uint8).reshape(pictures.shape), pictures)
    assert told == ["t.mp4 is in H.264, by ffmpeg's libopenh264."]


@pytest.mark.parametrize(("listed", "working"), [(("mpeg4",), ("mpeg4",)), (("libx264",), ())])
def test_a_video_is_vp9_and_says_so_where_none_works(
    trajectory: Trajectory,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    listed: Sequence[str],
    working: Sequence[str],
) -> None:
    pytest.importorskip("cv2", reason='the "render" extra is not installed')
    out, told = tmp_path / "t.mp4", list[str]()
    give_ffmpeg(tmp_path, monkeypatch, listed, working)
    export(trajectory, out, view=View(width=64, height=96), say=told.append)
    content = out.read_bytes()
    # Where OpenCV reaches an encoder of the system, that makes it.
    codec, code = ("H.264", b"avc1") if b"avc1" in content else ("VP9", b"vp09")
    assert code in content
    assert codec in told[0]
    if codec == "VP9":
        assert "not H.264: " in told[0]
        assert "has no encoder for it that works" in told[0]
    assert capfd.readouterr().err == ""


def test_sides_that_a_video_cannot_have_are_refused_before_anything_is_drawn(
    convert: Convert, trajectory: Trajectory, tmp_path: Path
) -> None:
    code, error = convert(trajectory.save(tmp_path / "t.npz"), tmp_path / "t.mp4", "--size", "65x97")
    assert code == 1
    assert "multiples of 2 pixels" in error
    assert "66x98" in error


@pytest.mark.parametrize("name", ["slow.gif", "slow.mp4"])
def test_a_film_slower_than_encoders_hold_is_refused_before_it_is_drawn(
    trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr("pb4u.export.still_renderer.StillRenderer", None)
    slow = replace(trajectory, header=replace(trajectory.header, fps=0.001))
    with pytest.raises(InputError, match=r"0\.002 .*0\.001"):
        export(slow, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_an_ffmpeg_that_fails_is_told(trajectory: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    give_ffmpeg(tmp_path, monkeypatch, fails=True)
    with pytest.raises(Pb4uError, match="no space left"):
        write_mp4(trajectory, tmp_path / "t.mp4", view=View(width=64, height=96))


def test_the_ffmpeg_extra_writes_h264(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("imageio_ffmpeg", reason='the "ffmpeg" extra is not installed')
    monkeypatch.setattr("pb4u.export.video_writer.shutil.which", lambda name: None)
    with open_video(tmp_path / "a.mp4", 25.0, (64, 64)) as video:
        video.write(np.zeros((64, 64, 3), dtype=np.uint8))
    assert video.codec.startswith("H.264")
    assert b"avc1" in (tmp_path / "a.mp4").read_bytes()


@pytest.mark.parametrize("fps", [12.0, 24.0, 30.0, 60.0, 120.0])
def test_a_gif_lasts_as_long_as_what_it_shows(tmp_path: Path, fps: float) -> None:
    pictures = [np.full((4, 4, 3), 8 * k % 256, dtype=np.uint8) for k in range(int(fps))]
    save_gif(pictures, tmp_path / "a.gif", fps)
    with Image.open(tmp_path / "a.gif") as film:
        shown = [film.seek(k) or film.info["duration"] for k in range(film.n_frames)]
    assert sum(shown) == pytest.approx(1000, abs=70)
    assert max(shown) - min(shown) <= 10


def test_an_mp4_needs_an_encoder_of_either_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pb4u.export.video_writer.find_spec", lambda name: None)
    monkeypatch.setattr("pb4u.export.video_writer._ffmpeg", lambda: "ffmpeg")
    check_target(tmp_path / "a.mp4")
    monkeypatch.setattr("pb4u.export.video_writer._ffmpeg", lambda: None)
    with pytest.raises(MissingExtraError, match="render"):
        check_target(tmp_path / "a.mp4")
