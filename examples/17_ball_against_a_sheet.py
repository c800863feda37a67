"""A ball pushed against a sheet that is held by its borders: the sheet stretches over it, and the ball stays behind it.

python examples/17_ball_against_a_sheet.py
python examples/17_ball_against_a_sheet.py --speed 2 --radius 0.05
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh
from cloth_scenes import placed, sheet, simulate, solid

import pb4u
from pb4u.measures.metrics import measure


def main() -> None:
    """Push a ball against a held sheet, and say whether it came through."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=1500)
    parser.add_argument("--radius", type=float, default=0.1, help="of the ball [m]")
    parser.add_argument("--material", default="cotton")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--speed", type=float, default=0.3, help="of the ball, up [m/s]")
    parser.add_argument("--out", default="ball")
    options = parser.parse_args()

    side, height = 0.6, 0.5
    cloth = sheet(side, side, options.triangles, options.material)
    x, z = (cloth.vertices[:, :2] - side / 2).T
    start = np.column_stack([x, np.full(len(x), height), -z])
    held = np.maximum(np.abs(x), np.abs(z)) > side / 2 - 1e-6
    ball = trimesh.creation.icosphere(subdivisions=3, radius=options.radius)
    centre = height - options.radius - 0.02 + options.speed * np.arange(options.frames) / 30.0
    path = ball.vertices + centre[:, None, None] * np.array([0.0, 1.0, 0.0])
    scene = pb4u.Scene((placed(cloth, start, held),), (solid("ball", path, ball.faces),), options.frames)
    trajectory = simulate(scene, options.out)

    tops = trajectory.body_positions[:, :, 1].max(axis=1)
    free = ~trajectory.header.pinned
    behind = np.array([x[free, 1].max() for x in trajectory.positions]) > tops
    strain = measure(trajectory)["metrics"]["strain_max"]["per_frame"][-1]
    if behind.all():
        print(f"the ball stays behind the sheet, which it has stretched by at most {100 * strain:.0f} % at the end")
    else:
        print(f"the ball is through the sheet from frame {int(np.argmin(behind))} on")


if __name__ == "__main__":
    main()
