"""A sheet of swatches: small pictures side by side, each with what it is written below."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pb4u.export.still_renderer import render
from pb4u.export.view import View
from pb4u.io.atomic_file import replace_file
from pb4u.scene.trajectory import Trajectory

_SIDE, _CAPTION, _ACROSS = 340, 50, 6
"""Of a picture and of what is written below it [pixels], and how many stand side by side at most."""

_VIEW = View(width=_SIDE, height=_SIDE, azimuth=20.0, elevation=38.0)


class Swatch(NamedTuple):
    """One picture of a sheet.

    Args:
        draped: one frame of cloth without a body.
        lines: text below it, two lines at most.
    """

    draped: Trajectory
    lines: tuple[str, ...]


def write_swatches(swatches: Iterable[Swatch], path: Path) -> None:
    """Write a sheet of swatches as PNG or JPEG.

    Args:
        swatches: in the order of the sheet, by rows; one or more.
        path: file to write; its suffix decides the format.

    Raises:
        Pb4uError: this machine has no off-screen OpenGL.
    """
    from PIL import Image

    tiles = [_tile(swatch) for swatch in swatches]
    across = min(len(tiles), _ACROSS)
    empty = np.full_like(tiles[0], _background())
    tiles += [empty] * (-len(tiles) % across)
    rows = [np.concatenate(tiles[k : k + across], axis=1) for k in range(0, len(tiles), across)]
    encoded = io.BytesIO()
    Image.fromarray(np.concatenate(rows)).save(encoded, Image.registered_extensions()[path.suffix.lower()])
    replace_file(path, encoded.getvalue())


def _background() -> np.ndarray:
    return np.rint(255.0 * np.array(_VIEW.background)).astype(np.uint8)


def _tile(swatch: Swatch) -> np.ndarray:
    """Picture and caption (height, width, 3) uint8 of a swatch."""
    from PIL import Image, ImageDraw, ImageFont

    picture = next(iter(render(swatch.draped, [0], _VIEW)))
    caption = Image.fromarray(np.full((_CAPTION, _SIDE, 3), _background(), dtype=np.uint8))
    drawing = ImageDraw.Draw(caption)
    for k, line in enumerate(swatch.lines):
        drawing.text((_SIDE / 2, 4 + 21 * k), line, (60, 62, 66), ImageFont.load_default(17 - 2 * k), anchor="ma")
    return np.concatenate([picture, np.asarray(caption)])
