"""Draws every built-in garment on both bodies in three poses, front and side: docs/images/garments.png.

python tools/contact_sheet.py [--model solver] [--triangles 2500] [--garments dress,skirt] [--out FILE]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from picture_table import captioned, colour_of, last_frame, table

from pb4u import load_simulator, make_scene
from pb4u.export.view import View
from pb4u.garment.library import garment_names

MOMENTS = (("walk", 4), ("arms", 12), ("squat", 14))
"""A motion and the frame of it that is drawn."""


def draw_row(garment: str, model: str, triangles: int, size: int) -> list[np.ndarray]:
    """Twelve pictures: two bodies, three moments, front and side."""
    pictures = []
    for body in ("woman", "man"):
        for motion, moment in MOMENTS:
            scene = make_scene(garment, body, motion, triangles=triangles, frames=moment + 1, lead_in=12)
            trajectory = load_simulator(model).simulate(scene)
            view = View(width=size * 3 // 4, height=size, cloths=(colour_of(garment),), azimuth=0.0)
            pictures += [last_frame(trajectory, replace(view, azimuth=azimuth)) for azimuth in (0.0, 90.0)]
    return pictures


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
    for name in options.garments.split(","):
        row = draw_row(name, options.model, options.triangles, options.size)
        rows.append([captioned(row[0], f"{name}, {options.model}, {options.triangles} triangles"), *row[1:]])
        print(name, flush=True)
    table(rows).save(options.out)


if __name__ == "__main__":
    main()
