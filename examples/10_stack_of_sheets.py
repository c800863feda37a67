"""Five sheets stacked and dropped on the corner of a cube: they drape over it, layer on layer, and come to rest.

python examples/10_stack_of_sheets.py
python examples/10_stack_of_sheets.py --sheets 8 --materials silk leather
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh
from cloth_scenes import placed, sheet, simulate, solid

import pb4u


def main() -> None:
    """Stack sheets, each turned a little, let them fall, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=500, help="of each sheet")
    parser.add_argument("--sheets", type=int, default=5)
    parser.add_argument("--materials", nargs="+", default=["cotton"], help="of the sheets in turn")
    parser.add_argument("--frames", type=int, default=75)
    parser.add_argument("--self-contact", choices=("on", "off"), default="on")
    parser.add_argument("--out", default="stack")
    options = parser.parse_args()

    # A cube standing on one of its corners, sunk half into the ground; the opposite corner is 0.3 m above it. Its
    # corners are rounded: cloth feels a solid at the vertices of the cloth, and a sharp point would slip between them.
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    corners = trimesh.creation.box((0.28, 0.28, 0.28)).vertices
    cube = trimesh.convex.convex_hull((corners[:, None] + ball.vertices).reshape(-1, 3))
    cube.apply_transform(trimesh.geometry.align_vectors([1.0, 1.0, 1.0], [0.0, 1.0, 0.0]))
    top = 0.3
    block = solid("cube", cube.vertices + [0.0, top - cube.vertices[:, 1].max(), 0.0], cube.faces)

    side, layers = 0.45, []
    for k in range(options.sheets):
        material = options.materials[k % len(options.materials)]
        cloth = sheet(side, side, options.triangles, material)
        # Each is turned by 17 degrees against the one below, and a centimetre higher.
        turn = np.radians(17.0 * k)
        x, z = (cloth.vertices[:, :2] - side / 2).T
        flat = np.column_stack([x * np.cos(turn) - z * np.sin(turn), 0.0 * x, -x * np.sin(turn) - z * np.cos(turn)])
        layers.append(placed(cloth, flat + [0.0, top + 0.02 + 0.01 * k, 0.0]))

    simulate(pb4u.Scene(tuple(layers), (block,), options.frames), options.out, options.self_contact == "on")


if __name__ == "__main__":
    main()
