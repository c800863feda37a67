"""Pictures of the current view in the browser: one frame as a still, all frames as a video."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pb4u.errors import InputError, Pb4uError, refuse_unknown
from pb4u.export.picture import save_gif, save_mp4
from pb4u.export.video_writer import check_mp4
from pb4u.viewer.clip import Clip

if TYPE_CHECKING:
    from viser import ClientHandle

SUFFIXES = (".png", ".gif", ".mp4")

_MOST_FRAMES = 1200
"""Frames of a film: 40 s at 30 frames per second, 3 GB of pictures of 1000 x 800."""

_PATIENCE = 60.0
"""Seconds that a browser is given for a picture: without a graphics card it takes seconds of a dense mesh."""

_GROUND = 250
"""Grey behind what is drawn: a video has no transparency."""


class Film:
    """Pictures that are being taken.

    Args:
        suffix: one of `SUFFIXES`.
        frames: numbers of the frames, on the timeline.
        clip: the first clip that is shown, which gives the frame rate and the name.

    Attributes:
        pictures: (height, width, 3 or 4) uint8 each, the pictures so far.
        stopped: whether recording was stopped.

    Raises:
        InputError: there are too many frames, or no such format.
        MissingExtraError: the format needs an extra.
    """

    def __init__(self, suffix: str, frames: list[int], clip: Clip) -> None:
        refuse_unknown("format", [suffix], SUFFIXES)
        if suffix == ".mp4":
            check_mp4(Path(suffix))
        if len(frames) > _MOST_FRAMES:
            raise InputError(f"A video of the view can have at most {_MOST_FRAMES:,} frames, not {len(frames):,}.")
        self.suffix, self.frames, self.clip = suffix, frames, clip
        self.pictures: list[np.ndarray] = []
        self.stopped = False

    def developed(self) -> tuple[str, bytes, str]:
        """Name and content of the file, and a note on it as a predicate, or ""."""
        from PIL import Image

        stem = self.clip.file_stem
        if self.suffix == ".png":
            written = io.BytesIO()
            Image.fromarray(self.pictures[0]).save(written, "PNG")
            return f"{stem}_{self.frames[0]:04d}.png", written.getvalue(), ""
        # A window that was resized meanwhile gives pictures of several sizes; a codec wants even ones.
        height, width = (min(picture.shape[k] for picture in self.pictures) // 2 * 2 for k in (0, 1))
        opaque = [_on_ground(picture[:height, :width]) for picture in self.pictures]
        with tempfile.TemporaryDirectory(prefix="pb4u-") as scratch:
            path, remark = Path(scratch) / f"{stem}{self.suffix}", ""
            if self.suffix == ".gif":
                save_gif(opaque, path, self.clip.header.fps)
            else:
                remark = save_mp4(opaque, path, self.clip.header.fps, (width, height))
            return path.name, path.read_bytes(), remark


def _on_ground(picture: np.ndarray) -> np.ndarray:
    """A picture (height, width, 3 or 4) uint8 without transparency, (height, width, 3) uint8."""
    if picture.shape[2] == 3:
        return picture
    share = picture[..., 3:].astype(np.float32) / 255.0
    return np.round(share * picture[..., :3] + (1.0 - share) * _GROUND).astype(np.uint8)


def take_picture(client: ClientHandle) -> np.ndarray:
    """What the browser shows now, (height, width, 4) uint8 sRGB with transparency.

    Args:
        client: the window.

    Raises:
        Pb4uError: it does not answer.
    """
    camera = client.camera
    try:
        return client.get_render(camera.image_height, camera.image_width, transport_format="png", timeout=_PATIENCE)
    except (TimeoutError, RuntimeError) as error:
        raise Pb4uError("The browser returned no picture; keep its window visible while pictures are taken.") from error
