"""A sheet wrung by its ends: four turns, until it is a rope that coils up on itself.

python examples/09_twisted_sheet.py
python examples/09_twisted_sheet.py --turns 6 --triangles 10000
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh
from cloth_scenes import placed, sheet, simulate, solid

import pb4u

LENGTH, WIDTH, HEIGHT = 1.0, 0.25, 0.5


def about_x(points: np.ndarray, angle: float) -> np.ndarray:
    """`points` (points, 3) turned about the x axis."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def main() -> None:
    """Turn both ends against each other while they come a little nearer, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--turns", type=float, default=4.0)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--self-contact", choices=("on", "off"), default="on")
    parser.add_argument("--out", default="twisted")
    options = parser.parse_args()

    cloth = sheet(LENGTH, WIDTH, options.triangles)
    flat = cloth.vertices - [LENGTH / 2, WIDTH / 2, 0.0]
    side = np.where(flat[:, 0] > LENGTH / 2 - 1e-9, 1.0, np.where(flat[:, 0] < 1e-9 - LENGTH / 2, -1.0, 0.0))
    rod = trimesh.creation.box((0.02, WIDTH + 0.02, 0.02))

    # Each end makes half of the turns. Other rows of the frames are read in the first one alone.
    sheets, rods = [], []
    for share in np.linspace(0.0, 1.0, options.frames):
        angle, nearer = share * options.turns * np.pi, share * 0.1
        x = flat.copy()
        bars = []
        for end in (1.0, -1.0):
            x[side == end] = about_x(flat[side == end], end * angle) - [end * nearer, 0.0, 0.0]
            bars.append(about_x(rod.vertices, end * angle) + [end * (LENGTH / 2 - nearer), 0.0, 0.0])
        sheets.append(x + [0.0, HEIGHT, 0.0])
        rods.append(np.concatenate(bars) + [0.0, HEIGHT, 0.0])
    # The rods are only seen: what holds the sheet are its pinned ends.
    held = solid("rods", np.array(rods), np.concatenate([rod.faces, rod.faces + len(rod.vertices)]), felt=False)
    scene = pb4u.Scene((placed(cloth, np.array(sheets), side != 0.0),), (held,), options.frames)
    simulate(scene, options.out, options.self_contact == "on")


if __name__ == "__main__":
    main()
