"""Pictures of garments side by side, with captions: what the tools share that draw for the documentation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from pb4u.export.picture import render
from pb4u.export.selection import select_frames
from pb4u.export.view import View
from pb4u.garment.library import garment_names
from pb4u.scene.trajectory import Trajectory

COLOURS = (
    (0.16, 0.36, 0.62), (0.62, 0.22, 0.20), (0.20, 0.45, 0.33), (0.45, 0.27, 0.50),
    (0.70, 0.50, 0.16), (0.25, 0.42, 0.50), (0.24, 0.27, 0.36), (0.60, 0.36, 0.42),
)  # fmt: skip
INK = (60, 60, 60)


def colour_of(garment: str) -> tuple[float, float, float]:
    """The colour in which a built-in garment is drawn everywhere."""
    return COLOURS[garment_names().index(garment) % len(COLOURS)]


def last_frame(trajectory: Trajectory, view: View) -> np.ndarray:
    """(height, width, 3) uint8 picture of the last frame, framed by that frame alone."""
    last = select_frames(trajectory, (trajectory.frame_count - 1, trajectory.frame_count), 1)
    return next(iter(render(last, [0], view)))


def captioned(picture: np.ndarray, caption: str, ink: tuple[int, int, int] = INK, size: int = 14) -> np.ndarray:
    """The picture with a caption over its upper left corner."""
    image = Image.fromarray(picture)
    ImageDraw.Draw(image).text((6, 4), caption, fill=ink, font_size=size)
    return np.asarray(image)


def table(rows: Sequence[Sequence[np.ndarray]]) -> Image.Image:
    """Pictures of one size in rows of one length."""
    return Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for row in rows]))
