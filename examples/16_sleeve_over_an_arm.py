"""A narrow sleeve pulled by its border over a hand, round a bent elbow and up the arm.

python examples/16_sleeve_over_an_arm.py
python examples/16_sleeve_over_an_arm.py --room 0.008 --bend 110
"""

from __future__ import annotations

import argparse

import numpy as np
from cloth_scenes import placed, sheet, simulate, solid

import pb4u

ARM, HEIGHT, FOREARM, UPPER, AROUND = 0.04, 0.8, 0.3, 0.3, 24


def along(lengths: np.ndarray, bend: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (n, 3) [m] of the arm's axis, from the finger tips on, and the two directions (n, 3) across it there."""
    radius = 1.5 * ARM
    turn = np.clip((lengths - FOREARM) / radius, 0.0, bend)
    before, after = np.minimum(lengths, FOREARM), np.maximum(lengths - FOREARM - bend * radius, 0.0)
    x = before + radius * np.sin(turn) + after * np.cos(turn)
    y = radius * (1.0 - np.cos(turn)) + after * np.sin(turn)
    up = np.column_stack([-np.sin(turn), np.cos(turn), 0.0 * turn])
    return np.column_stack([x, HEIGHT + y, 0.0 * x]), up, np.tile([0.0, 0.0, 1.0], (len(turn), 1))


def rings(lengths: np.ndarray, radii: np.ndarray, count: int, bend: float) -> np.ndarray:
    """Circles (n count, 3) [m] of some radii around the axis."""
    places, up, aside = along(lengths, bend)
    angles = 2.0 * np.pi * np.arange(count) / count
    across = np.cos(angles)[:, None] * up[:, None] + np.sin(angles)[:, None] * aside[:, None]
    return (places[:, None] + radii[:, None, None] * across).reshape(-1, 3)


def main() -> None:
    """Pull a sleeve over a bent arm, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=1500)
    parser.add_argument("--room", type=float, default=0.015, help="radius of the sleeve above that of the arm [m]")
    parser.add_argument("--bend", type=float, default=80.0, help="of the elbow [degrees]")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--out", default="sleeve")
    options = parser.parse_args()

    bend, radius, length = np.radians(options.bend), ARM + options.room, 0.3
    flat = sheet(length, 2.0 * np.pi * radius, options.triangles)
    columns = len(np.unique(flat.vertices[:, 0].round(9)))
    count = len(flat.vertices) // columns - 1
    # The sheet rolled up: its last row is its first.
    row, column = np.divmod(np.arange(len(flat.vertices)), count + 1)
    faces = (row * count + column % count)[flat.faces]
    begun = np.linspace(-length - 0.02, -0.02, columns)
    tube = rings(begun, np.full(columns, radius), count, bend)
    cloth = pb4u.Garment("sleeve", tube, faces, flat.material)
    ahead = np.arange(len(tube)) >= (columns - 1) * count
    # Its border goes up the arm; the rest of the path is not looked at.
    way = np.linspace(0.0, FOREARM + 0.5 * UPPER + bend * 1.5 * ARM, options.frames)
    path = np.stack([rings(begun + each, np.full(columns, radius), count, bend) for each in way])

    lengths = np.concatenate([np.linspace(0.0, ARM, 6), np.linspace(ARM, FOREARM + bend * 1.5 * ARM + UPPER, 60)[1:]])
    round_tip = ARM * np.sqrt(np.maximum(1.0 - np.maximum(1.0 - lengths / ARM, 0.0) ** 2, 0.0025))
    skin = rings(lengths, round_tip, AROUND, bend)
    j, k = np.arange(AROUND), np.arange(len(lengths) - 1)[:, None] * AROUND
    a, b = (k + j).ravel(), (k + (j + 1) % AROUND).ravel()
    sides = np.concatenate([np.column_stack([a, b, b + AROUND]), np.column_stack([a, b + AROUND, a + AROUND])])
    # Closed by a fan from the first vertex of each end.
    fan = np.column_stack([0 * j[2:], j[2:], j[1:-1]])
    arm = solid("arm", skin, np.concatenate([sides, fan, fan[:, ::-1] + (len(lengths) - 1) * AROUND]))
    simulate(pb4u.Scene((placed(cloth, path, ahead),), (arm,), options.frames), options.out)


if __name__ == "__main__":
    main()
