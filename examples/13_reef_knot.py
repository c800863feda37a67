"""Two ribbons tied to a loose reef knot and pulled at their ends: nothing but contact between them holds it.

python examples/13_reef_knot.py
python examples/13_reef_knot.py --width 0.02 --material silk
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh
from cloth_scenes import placed, sheet, simulate, solid

import pb4u

REACH, HALF, INNER, OUTER, HEIGHT = 0.34, 0.09, 0.022, 0.05, 0.5


def strand(depth: float) -> np.ndarray:
    """Middle (points, 3) [m] of a ribbon that comes from the left, turns in a bight on the right and goes back.

    It lies `depth` low in its own bight and where it passes the other one's, and as much high in between.
    """
    x = np.linspace(-REACH, HALF, 400)
    share = np.clip((x + HALF) / (2.0 * HALF), 0.0, 1.0)
    beyond = np.clip((-HALF - OUTER - 0.02 - x) / 0.08, 0.0, 1.0)
    z = depth * np.cos(np.pi * np.clip(x / HALF, -1.0, 1.0)) * 0.5 * (1.0 + np.cos(np.pi * beyond))
    leg = np.column_stack([x, INNER + (OUTER - INNER) * share**2 * (3.0 - 2.0 * share), z])
    turn = np.linspace(0.5 * np.pi, -0.5 * np.pi, 200)[1:-1]
    bight = np.column_stack([HALF + OUTER * np.cos(turn), OUTER * np.sin(turn), np.full(len(turn), -depth)])
    return np.concatenate([leg, bight, (leg * [1.0, -1.0, 1.0])[::-1]])


def on_edge(flat: np.ndarray, middle: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """A ribbon (vertices, 2) [m] laid on edge along its `middle`, whose points are so many `steps` [m] on."""
    tangents = np.gradient(middle, steps, axis=0)
    at, tangent = (
        np.column_stack([np.interp(flat[:, 0], steps, values[:, axis]) for axis in range(3)])
        for values in (middle, tangents / np.linalg.norm(tangents, axis=1)[:, None])
    )
    up = np.array([0.0, 0.0, 1.0]) - tangent[:, 2:] * tangent
    return at + flat[:, 1:] * up / np.linalg.norm(up, axis=1)[:, None]


def main() -> None:
    """Tie two ribbons, pull them apart, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=600, help="of each ribbon")
    parser.add_argument("--width", type=float, default=0.012, help="of the ribbons [m]")
    parser.add_argument("--material", default="cotton")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--pull", type=float, default=0.13, help="way of each end [m]")
    parser.add_argument("--self-contact", choices=("on", "off"), default="on")
    parser.add_argument("--out", default="knot")
    options = parser.parse_args()

    middle = strand(0.65 * options.width)
    steps = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    ribbon = sheet(steps[-1], options.width, options.triangles, options.material)
    ends = (ribbon.vertices[:, 0] == 0.0) | (ribbon.vertices[:, 0] == steps[-1])
    tied = on_edge(ribbon.vertices[:, :2] - [0.0, 0.5 * options.width], middle, steps)[:, [0, 2, 1]]
    # Slowly at the beginning and at the end, so that nothing is jerked.
    share = np.linspace(0.0, 1.0, options.frames)[:, None, None]
    way = options.pull * share**2 * (3.0 - 2.0 * share) * [1.0, 0.0, 0.0]
    # The second ribbon is the first turned by half about an axis across both: high where that is low.
    paths = [tied * turned + [0.0, HEIGHT, 0.0] - way * turned[0] for turned in ([1.0, 1.0, 1.0], [-1.0, -1.0, 1.0])]
    # The balls are only seen: what pulls the ribbons are their pinned ends.
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.6 * options.width)
    balls = [ball.vertices + path[:, ends].mean(axis=1)[:, None] for path in paths]
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    seen = solid("balls", np.concatenate(balls, axis=1), faces, felt=False)
    worn = tuple(placed(ribbon, path, ends) for path in paths)
    simulate(pb4u.Scene(worn, (seen,), options.frames), options.out, options.self_contact == "on")


if __name__ == "__main__":
    main()
