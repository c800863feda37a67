"""Draws the gallery: every garment, one late frame by each model and triangle count: docs/images/gallery.png.

python tools/gallery.py [--models skinning,quick-solver] [--triangles 2500,11000] [--garments dress,skirt]

A model is a name or a checkpoint's path. Pictures are kept in --cells as they are drawn, so that a run that was
stopped goes on where it was; a picture is drawn again when its scene, its size or its model's weights changed.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from pb4u import Pb4uError, load_simulator, make_scene
from pb4u.export.selection import select_frames
from pb4u.export.still_renderer import render
from pb4u.export.view import View
from pb4u.garment.library import garment_names
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.checkpoint import weights_file

SHOWN = {
    "tshirt": ("man", "walk", 14, 30.0),
    "tanktop": ("woman", "run", 12, -30.0),
    "longsleeve": ("man", "arms", 14, 20.0),
    "dress": ("woman", "turn", 18, 25.0),
    "fitted_dress": ("woman", "walk", 16, -35.0),
    "cardigan": ("woman", "arms", 14, 30.0),
    "trousers": ("man", "squat", 14, 40.0),
    "skirt": ("woman", "twist", 14, 25.0),
    "shirt": ("man", "walk", 14, 25.0),
    "jeans": ("woman", "walk", 14, -25.0),
    "circle_dress": ("woman", "turn", 18, 25.0),
}
"""Garment -> body, motion, the frame of it that is drawn, azimuth of the view [degrees]."""

LEAD_IN = 12
COLOURS = (
    (0.62, 0.70, 0.80), (0.80, 0.56, 0.52), (0.60, 0.70, 0.62), (0.74, 0.64, 0.78),
    (0.84, 0.74, 0.56), (0.60, 0.68, 0.72), (0.46, 0.54, 0.68), (0.80, 0.66, 0.68),
    (0.88, 0.88, 0.86), (0.36, 0.44, 0.58), (0.72, 0.40, 0.44),
)  # fmt: skip
INK = (60, 60, 60)
FAILED_INK = (190, 30, 30)


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


def cell(garment: str, triangles: int, model: str, size: int, folder: Path) -> np.ndarray:
    """The picture of one garment by one model, from the folder where it is there."""
    body, motion, moment, azimuth = SHOWN[garment]
    recipe = f"{body} {motion} {moment} {azimuth} {LEAD_IN} {size} {model}".encode() + weights_of(model)
    kept = folder / f"{garment}_{triangles}_{Path(model).stem}_{hashlib.sha256(recipe).hexdigest()[:8]}.png"
    if kept.is_file():
        return np.asarray(Image.open(kept).convert("RGB"))
    began = time.perf_counter()
    picture = draw(garment, triangles, model, View(size * 3 // 4, size, azimuth, cloths=(colour_of(garment),)))
    Image.fromarray(picture).save(kept)
    print(f"{kept.name}: {time.perf_counter() - began:.0f} s", flush=True)
    return picture


def weights_of(model: str) -> bytes:
    """The weights of a network, built in or a file; nothing for what has none."""
    try:
        with weights_file(model) as path:
            return path.read_bytes()
    except Pb4uError:
        return b""


def draw(garment: str, triangles: int, model: str, view: View) -> np.ndarray:
    """Simulate up to the frame that is shown, and draw it; a simulation that came apart says so in red."""
    body, motion, moment, _ = SHOWN[garment]
    simulator = load_simulator(model)
    scene = make_scene(
        garment, body, motion, triangles=triangles, frames=moment + 1, lead_in=LEAD_IN, fps=simulator.fps or 30.0
    )
    caption = f"{garment}\n{scene.garments[0].garment.triangle_count:,}\n{Path(model).stem}"
    try:
        trajectory = simulator.simulate(scene)
    except Pb4uError:
        return captioned(np.full((view.height, view.width, 3), 245, np.uint8), f"{caption}\ncame apart", FAILED_INK)
    picture = last_frame(trajectory, view)
    if trajectory.frame_count < scene.frames:
        return captioned(picture, f"{caption}\ncame apart", FAILED_INK)
    return captioned(picture, caption)


def main() -> None:
    """Draw what is missing and put the gallery together."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default="quick-solver")
    parser.add_argument("--triangles", default="11000")
    parser.add_argument("--garments", default=",".join(garment_names()))
    parser.add_argument("--across", type=int, default=6, help="garments in a row")
    parser.add_argument("--size", type=int, default=420, help="height of a picture in pixels")
    parser.add_argument("--cells", type=Path, default=Path("build/gallery"), help="folder of the finished pictures")
    parser.add_argument("--out", type=Path, default=Path("docs/images/gallery.png"))
    options = parser.parse_args()
    options.cells.mkdir(parents=True, exist_ok=True)
    strips = [
        [
            cell(garment, int(count), model, options.size, options.cells)
            for count in options.triangles.split(",")
            for model in options.models.split(",")
        ]
        for garment in options.garments.split(",")
    ]
    blank = [np.full_like(strips[0][0], 255)] * len(strips[0])
    strips += [blank] * (-len(strips) % options.across)
    rows = [list(chain(*strips[k : k + options.across])) for k in range(0, len(strips), options.across)]
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    Image.fromarray(sheet).save(options.out, optimize=True)
    print(options.out)


if __name__ == "__main__":
    main()
