"""A flag on its pole, in gusts that turn around it.

python examples/18_flag_in_the_wind.py
python examples/18_flag_in_the_wind.py --material silk-charmeuse --speed 10
"""

from __future__ import annotations

import argparse

import numpy as np
from cloth_scenes import placed, sheet, solid

import pb4u

WIDTH, HEIGHT, FOOT = 1.2, 0.8, 1.6


def pole(around: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [m] and faces of a pole as high as the flag's upper edge; the flag does not meet it."""
    angles = 2.0 * np.pi * np.arange(around) / around
    ring = 0.02 * np.column_stack([np.cos(angles), np.zeros(around), -np.sin(angles)])
    a = np.arange(around)
    b = (a + 1) % around
    sides = np.concatenate([np.column_stack([a, b, b + around]), np.column_stack([a, b + around, a + around])])
    return np.concatenate([ring, ring + [0.0, FOOT + HEIGHT + 0.05, 0.0]]), sides


def main() -> None:
    """Let a flag fly, and write its trajectory, a picture and a video."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--material", default="polyester-plain")
    parser.add_argument("--speed", type=float, default=6.0, help="of the wind [m/s]")
    parser.add_argument("--frames", type=int, default=90)
    parser.add_argument("--time-integration", default="bdf2")
    parser.add_argument("--out", default="flag")
    options = parser.parse_args()

    cloth = sheet(WIDTH, HEIGHT, options.triangles, options.material)
    start = cloth.vertices + [0.02, FOOT, 0.0]
    # It is as good as never exactly flat: a ripple of a centimetre tells the wind which way to begin.
    start[:, 2] += 0.01 * np.sin(2.0 * np.pi * cloth.vertices[:, 0] / WIDTH) * cloth.vertices[:, 0] / WIDTH
    flag = placed(cloth, np.broadcast_to(start, (options.frames, *start.shape)), cloth.vertices[:, 0] == 0.0)
    wind = (options.speed, 0.0, 0.15 * options.speed)
    scene = pb4u.Scene(
        (flag,),
        (solid("pole", *pole(), felt=False),),
        options.frames,
        environment=pb4u.Environment(wind=wind, gusts=0),
    )
    simulator = pb4u.load_simulator(
        "quick-solver", first_frame="placed", air="on", time_integration=options.time_integration
    )
    trajectory = simulator.simulate(scene)
    ends = trajectory.positions[:, cloth.vertices[:, 0] == WIDTH].mean(axis=1)
    print(
        f"the free end moves by {np.ptp(ends[30:, 2]):.2f} m across the wind, at {ends[30:, 1].mean():.2f} m of height"
    )
    print("written:", trajectory.save(f"{options.out}.npz"), pb4u.export_trajectory(trajectory, f"{options.out}.mp4"))


if __name__ == "__main__":
    main()
