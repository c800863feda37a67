"""Pictures and videos of a trajectory: PNG and JPEG strips, GIF and MP4."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from pb4u.errors import InputError
from pb4u.export.still_renderer import render
from pb4u.export.video_writer import open_video
from pb4u.export.view import View
from pb4u.progress import Progress, no_progress
from pb4u.scene.trajectory import Trajectory
from pb4u.threads import prefetch

_GIF_FPS = 15.0
"""Frames per second of a GIF at most; those beyond are left out, since more make files large."""

_SLOWEST = 0.002
"""Frames per second of a film at least: a GIF shows one for 655 s at most, and VP9 for 1000."""


def write_still(trajectory: Trajectory, path: Path, progress: Progress = no_progress, view: View | None = None) -> None:
    """Write a PNG or JPEG strip of five moments side by side, spread evenly over the clip.

    Args:
        trajectory: to draw.
        path: file to write; its suffix decides the format.
        progress: called with the moments drawn.
        view: camera, size and colours.
    """
    from PIL import Image

    moments = np.unique(np.linspace(0, trajectory.frame_count - 1, 5).round().astype(int)).tolist()
    strip = np.concatenate(list(_counted(render(trajectory, moments, view), len(moments), progress)), axis=1)
    # Through memory: Pillow writes a JPEG past a full disk without a word.
    encoded = io.BytesIO()
    Image.fromarray(strip).save(encoded, Image.registered_extensions()[path.suffix.lower()])
    path.write_bytes(encoded.getvalue())


def write_gif(
    trajectory: Trajectory,
    path: Path,
    progress: Progress = no_progress,
    view: View | None = None,
) -> None:
    """Write an endlessly looping GIF.

    Args:
        trajectory: to draw.
        path: file to write.
        progress: called with the frames drawn.
        view: camera, size and colours.
    """
    _require_playable(trajectory.fps)
    stride = max(1, round(trajectory.fps / _GIF_FPS))
    moments = range(0, trajectory.frame_count, stride)
    pictures = _counted(render(trajectory, moments, view), len(moments), progress)
    save_gif(pictures, path, trajectory.fps / stride)


def _require_playable(fps: float) -> None:
    """Refuse a film of a rate that encoders do not hold, before it is drawn."""
    if fps < _SLOWEST:
        raise InputError(f"A video must have {_SLOWEST:g} frames per second or more, not {fps:g}; write an .npz.")


def save_gif(pictures: Iterable[np.ndarray], path: Path, fps: float) -> None:
    """Write pictures as an endlessly looping GIF.

    Args:
        pictures: (height, width, 3) uint8 sRGB each, one or more.
        path: file to write.
        fps: of the pictures [1/s].
    """
    from PIL import Image

    stride = max(1, round(fps / _GIF_FPS))
    images = [
        Image.fromarray(picture).quantize(128, dither=Image.Dither.NONE)
        for picture in islice(pictures, 0, None, stride)
    ]
    # It counts in hundredths of a second: rounded one by one, they would add up to another length.
    ends = np.rint(100.0 * stride / fps * np.arange(len(images) + 1)).astype(int)
    shown = (10 * np.diff(ends)).tolist()
    images[0].save(path, save_all=True, append_images=images[1:], duration=shown, loop=0)


def write_mp4(trajectory: Trajectory, path: Path, progress: Progress = no_progress, view: View | None = None) -> str:
    """Write an MP4 at the trajectory's own frame rate: H.264 where an encoder of this machine makes it, or VP9.

    Args:
        trajectory: to draw.
        path: file to write.
        progress: called with the frames drawn.
        view: camera, size and colours.

    Returns:
        The codec, as a predicate without its subject.

    Raises:
        MissingExtraError: there is neither such an encoder nor the "render" extra.
        Pb4uError: the encoder cannot write the file.
    """
    _require_playable(trajectory.fps)
    view = view or View()
    frames = trajectory.frame_count
    pictures = _counted(render(trajectory, range(frames), view), frames, progress)
    return save_mp4(pictures, path, trajectory.fps, (view.width, view.height))


def save_mp4(pictures: Iterable[np.ndarray], path: Path, fps: float, size: tuple[int, int]) -> str:
    """Write pictures as an MP4: H.264 where an encoder of this machine makes it, or VP9.

    Args:
        pictures: (height, width, 3) uint8 sRGB each.
        path: file to write.
        fps: of the pictures [1/s].
        size: width and height of the pictures [pixels], both even.

    Returns:
        The codec, as a predicate without its subject.

    Raises:
        MissingExtraError: there is neither such an encoder nor the "render" extra.
        Pb4uError: the encoder cannot write the file.
    """
    with open_video(path, fps, size) as writer:
        # A picture is encoded while the next is drawn.
        for _ in prefetch(writer.write, pictures):
            pass
    return f"is in {writer.codec}."


def _counted(pictures: Iterator[np.ndarray], total: int, progress: Progress) -> Iterator[np.ndarray]:
    for number, picture in enumerate(pictures, start=1):
        yield picture
        progress(number, total)
