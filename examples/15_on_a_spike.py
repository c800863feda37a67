"""A sheet dropped on a spike, which is then pulled out from under it, sideways and down.

python examples/15_on_a_spike.py
python examples/15_on_a_spike.py --tip 0.002 --speed 2
"""

from __future__ import annotations

import argparse

import numpy as np
from cloth_scenes import placed, sheet, simulate, solid

import pb4u

HEIGHT, BASE, AROUND = 0.4, 0.08, 24


def spike(tip: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [m] and faces of a closed cone with a rounded tip of a radius [m], standing on the ground."""
    # Radii and heights of its rings, from its foot up; the last ones round the tip.
    arc = np.linspace(0.0, 0.45 * np.pi, 5)
    radii = np.concatenate([np.linspace(BASE, tip, 16)[:-1], tip * np.cos(arc)])
    heights = np.concatenate([np.linspace(0.0, HEIGHT - tip, 16)[:-1], HEIGHT - tip + tip * np.sin(arc)])
    angles = 2.0 * np.pi * np.arange(AROUND) / AROUND
    x, z = (np.outer(radii, turn).ravel() for turn in (np.sin(angles), np.cos(angles)))
    ends = [[0.0, 0.0, 0.0], [0.0, HEIGHT, 0.0]]
    vertices = np.concatenate([np.column_stack([x, np.repeat(heights, AROUND), z]), ends])
    j, k = np.arange(AROUND), np.arange(len(radii) - 1)[:, None] * AROUND
    a, b = (k + j).ravel(), (k + (j + 1) % AROUND).ravel()
    foot, top, last = len(vertices) - 2, len(vertices) - 1, (len(radii) - 1) * AROUND
    caps = [
        np.column_stack([(j + 1) % AROUND, j, np.full(AROUND, foot)]),
        np.column_stack([last + j, last + (j + 1) % AROUND, np.full(AROUND, top)]),
    ]
    sides = np.concatenate([np.column_stack([a, b, b + AROUND]), np.column_stack([a, b + AROUND, a + AROUND])])
    return vertices, np.concatenate([sides, *caps])


def main() -> None:
    """Drop a sheet on a spike, pull the spike away, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=1500)
    parser.add_argument("--tip", type=float, default=0.01, help="radius of the tip [m]")
    parser.add_argument("--material", default="cotton")
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--speed", type=float, default=1.0, help="at which the spike is pulled away [m/s]")
    parser.add_argument("--out", default="spike")
    options = parser.parse_args()

    side = 0.6
    cloth = sheet(side, side, options.triangles, options.material)
    x, z = (cloth.vertices[:, :2] - side / 2).T
    start = np.column_stack([x, np.full(len(x), HEIGHT + 0.05), -z])
    vertices, faces = spike(options.tip)
    # It stands while the sheet falls and drapes; then it goes, a little faster each frame up to its speed.
    seconds = np.maximum(np.arange(options.frames) / 30.0 - 0.5, 0.0)
    way = options.speed * np.maximum(seconds - 0.1, 0.5 * seconds**2 / 0.2 * (seconds < 0.2))
    path = vertices + way[:, None, None] * np.array([0.8, -0.6, 0.0])
    scene = pb4u.Scene((placed(cloth, start),), (solid("spike", path, faces),), options.frames)
    simulate(scene, options.out)


if __name__ == "__main__":
    main()
