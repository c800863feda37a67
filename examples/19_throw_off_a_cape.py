"""A cape on a runner, whose clasps let go.

python examples/19_throw_off_a_cape.py
python examples/19_throw_off_a_cape.py --motion jump --until 20
"""

from __future__ import annotations

import argparse

import numpy as np
from cloth_scenes import sheet

import pb4u
from pb4u.body.library import load_boned_body

LENGTH, UPPER_WIDTH, HEM_WIDTH = 0.95, 0.34, 1.0


def cape(body: pb4u.Body, triangles: int, material: str) -> pb4u.Garment:
    """A cape of about so many triangles that hangs behind a body, its upper edge across the shoulder blades."""
    middle = 0.5 * (UPPER_WIDTH + HEM_WIDTH)
    cloth = sheet(middle, LENGTH, triangles, material)
    # From left to right, so that its outside is behind, and from the shoulders to the hem.
    across, down = 1.0 - 2.0 * cloth.vertices[:, 0] / middle, 1.0 - cloth.vertices[:, 1] / LENGTH
    top, back = 0.81 * body.height, body.vertices[np.abs(body.vertices[:, 0]) < 0.5 * UPPER_WIDTH]
    back = back[back[:, 1] < top]
    heights = top - LENGTH * down
    # Straight down from the rearmost skin at or above each height.
    rear = np.array([back[back[:, 1] > height - 0.02, 2].min() for height in heights])
    width = UPPER_WIDTH + (HEM_WIDTH - UPPER_WIDTH) * down
    vertices = np.column_stack([0.5 * width * across, heights, rear - 0.015])
    return pb4u.Garment("cape", vertices, cloth.faces, cloth.material, loose=True).with_pins(down == 0.0)


def main() -> None:
    """Run with a cape, let it go, and write a trajectory and a video."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--material", default="wool-flannel")
    parser.add_argument("--motion", default="run")
    parser.add_argument("--frames", type=int, default=75)
    parser.add_argument("--until", type=int, default=35, help="frame at which the clasps let go")
    parser.add_argument("--out", default="cape")
    options = parser.parse_args()

    made = cape(load_boned_body("woman"), options.triangles, options.material)
    worn = pb4u.WornGarment(made, pin_stiffness=20000.0, pins_until=options.until)
    scene = pb4u.make_scene(worn, "woman", options.motion, frames=options.frames)
    trajectory = pb4u.load_simulator("quick-solver").simulate(scene)
    hem = trajectory.positions[:, made.vertices[:, 1] == made.vertices[:, 1].min()].mean(axis=1)
    print(f"hem {hem[options.until, 1]:.2f} m high where the clasps let go, {hem[-1, 1]:.2f} m at the end")
    print("written:", trajectory.save(f"{options.out}.npz"), pb4u.export_trajectory(trajectory, f"{options.out}.mp4"))


if __name__ == "__main__":
    main()
