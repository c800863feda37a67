"""Draws every built-in garment on both bodies in three poses, front and side: docs/images/garments.png.

python tools/contact_sheet.py [--model solver] [--triangles 2500] [--garments dress,skirt] [--out FILE]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from pb4u import load_simulator, make_scene
from pb4u.export.picture import View, render
from pb4u.export.selection import select_frames
from pb4u.garment.library import garment_names

MOMENTS = (("walk", 4), ("arms", 12), ("squat", 14))
"""A motion and the frame of it that is drawn."""

COLOURS = (
    (0.16, 0.36, 0.62), (0.62, 0.22, 0.20), (0.20, 0.45, 0.33), (0.45, 0.27, 0.50),
    (0.70, 0.50, 0.16), (0.25, 0.42, 0.50), (0.24, 0.27, 0.36), (0.60, 0.36, 0.42),
)  # fmt: skip


def draw_row(garment: str, colour: tuple[float, float, float], model: str, triangles: int, size: int) -> np.ndarray:
    """Twelve pictures side by side: two bodies, three moments, front and side."""
    pictures = []
    for body in ("woman", "man"):
        for motion, moment in MOMENTS:
            scene = make_scene(garment, body, motion, triangles=triangles, frames=moment + 1, lead_in=12)
            trajectory = load_simulator(model).simulate(scene)
            last = select_frames(trajectory, (trajectory.frame_count - 1, trajectory.frame_count), 1)
            view = View(width=size * 3 // 4, height=size, cloth=colour, azimuth=0.0)
            for azimuth in (0.0, 90.0):
                pictures.append(next(iter(render(last, [0], replace(view, azimuth=azimuth)))))
    return np.concatenate(pictures, axis=1)


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="solver")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--garments", default=",".join(garment_names()))
    parser.add_argument("--size", type=int, default=320)
    parser.add_argument("--out", type=Path, default=Path("docs/images/garments.png"))
    options = parser.parse_args()
    rows = []
    for name, colour in zip(options.garments.split(","), COLOURS, strict=False):
        row = Image.fromarray(draw_row(name, colour, options.model, options.triangles, options.size))
        ImageDraw.Draw(row).text((6, 4), f"{name}, {options.model}, {options.triangles} triangles", fill=(60, 60, 60))
        rows.append(np.asarray(row))
        print(name, flush=True)
    Image.fromarray(np.concatenate(rows)).save(options.out)


if __name__ == "__main__":
    main()
