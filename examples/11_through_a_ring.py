"""A cloth pulled by its middle through a ring: it gathers into folds that press on one another all around.

python examples/11_through_a_ring.py
python examples/11_through_a_ring.py --hole 0.04 --material silk
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh
from cloth_scenes import placed, sheet, simulate, solid

import pb4u

TUBE, HEIGHT = 0.03, 0.7


def main() -> None:
    """Lay a cloth on a ring, pull it down by its middle, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--hole", type=float, default=0.06, help="radius of the opening [m]")
    parser.add_argument("--material", default="cotton")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--speed", type=float, default=0.3, help="at which the middle is pulled down [m/s]")
    parser.add_argument("--self-contact", choices=("on", "off"), default="on")
    parser.add_argument("--out", default="ring")
    options = parser.parse_args()

    side = 0.6
    cloth = sheet(side, side, options.triangles, options.material)
    x, z = (cloth.vertices[:, :2] - side / 2).T
    flat = np.column_stack([x, 0.0 * x, -z])
    middle = np.hypot(x, z) < max(0.02, 1.2 * cloth.mean_edge_length)
    # Pulled from its first frame on, a little faster each frame until it goes at the speed asked for.
    seconds = np.arange(options.frames) / 30.0
    depth = options.speed * np.maximum(seconds - 0.2, 0.5 * seconds**2 / 0.4 * (seconds < 0.4))
    path = flat + np.array([0.0, HEIGHT + TUBE + 0.004, 0.0]) - depth[:, None, None] * np.array([0.0, 1.0, 0.0])

    torus = trimesh.creation.torus(options.hole + TUBE, TUBE, major_sections=48, minor_sections=24)
    ring = solid("ring", torus.vertices[:, [0, 2, 1]] + [0.0, HEIGHT, 0.0], torus.faces[:, ::-1])
    scene = pb4u.Scene((placed(cloth, path, middle),), (ring,), options.frames)
    simulate(scene, options.out, options.self_contact == "on")


if __name__ == "__main__":
    main()
