"""How far the frame rate changes cloth, beside how far a change of gravity by one part in ten thousand does.

    python benchmarks/frame_rates.py
    python benchmarks/frame_rates.py --clips skirt:walk --rates 24,30,60 --frames 61

Prints a Markdown table: the mean distance of vertices [mm] at common times, over two seconds, from the run at 120
frames a second, and between runs at 30 that differ in gravity alone. Clips whose folds are chaotic differ as much by
the second as by the first.
"""

from __future__ import annotations

import argparse
import warnings
from itertools import combinations

import numpy as np

import pb4u
from pb4u.physics.integrator import INTEGRATORS

REFERENCE, EVERY = 120, 5
NUDGES = (1.0, 1.0001, 1.0002)


def positions(clip: str, rule: str, fps: int, options: argparse.Namespace, nudge: float = 1.0) -> np.ndarray:
    """Positions (times, vertices, 3) [m] every fifth frame of 30 in a second."""
    garment, motion = clip.split(":")
    scene = pb4u.make_scene(
        garment,
        options.body,
        motion,
        triangles=options.triangles,
        fps=fps,
        frames=round((options.frames - 1) * fps / 30) + 1,
        environment=pb4u.Environment(gravity=(0.0, -9.81 * nudge, 0.0)),
    )
    made = pb4u.load_simulator("quick-solver", time_integration=rule).simulate(scene)
    return np.asarray(made.positions[:: EVERY * fps // 30], dtype=np.float64)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Mean distance [mm] of the vertices of two runs."""
    count = min(len(a), len(b))
    return 1e3 * float(np.linalg.norm(a[:count] - b[:count], axis=-1).mean())


def main() -> None:
    """Simulate every clip by every rule at every rate, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", default="tshirt:walk,skirt:walk,dress:dance")
    parser.add_argument("--rates", default="24,30,60", help="each divides 120 or is a multiple of 6")
    parser.add_argument("--frames", type=int, default=61, help="at 30 a second")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--body", default="woman")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    rates = [int(rate) for rate in options.rates.split(",")]
    print(f"| clip | rule | {' | '.join(f'{rate} fps' for rate in rates)} | other gravity |")
    print("|---|---|" + "---|" * (len(rates) + 1))
    for clip in options.clips.split(","):
        for rule in INTEGRATORS:
            reference = positions(clip, rule, REFERENCE, options)
            off = [apart(positions(clip, rule, rate, options), reference) for rate in rates]
            nudged = [positions(clip, rule, 30, options, nudge) for nudge in NUDGES]
            floor = np.mean([apart(a, b) for a, b in combinations(nudged, 2)])
            print(f"| {clip} | {rule} | {' | '.join(f'{mm:.0f}' for mm in off)} | {floor:.0f} |", flush=True)


if __name__ == "__main__":
    main()
