"""A cloth folded to and fro, dropped on a sphere and the floor: folds come to lie on one another and never cross.

    python examples/08_cloth_in_folds.py
    python examples/08_cloth_in_folds.py --triangles 10000 --layers 8

The .npz opens in `pb4u view`, and `pb4u convert` makes any other format of it.
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh
from cloth_scenes import placed, sheet, simulate, solid

import pb4u


def main() -> None:
    """Fold a strip, let it fall, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--layers", type=int, default=5, help="times that the cloth lies over itself at the start")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--self-contact", choices=("on", "off"), default="on")
    parser.add_argument("--out", default="folds")
    options = parser.parse_args()

    # A strip of 0.28 m a layer; the fold lines are columns of the mesh, and layers rise by a centimetre.
    width = 0.28
    cloth = sheet(width * options.layers, 0.5, options.triangles)
    along = cloth.vertices[:, 0] / width
    layer = np.minimum(along.astype(int), options.layers - 1)
    share = np.where(layer % 2 == 0, along - layer, layer + 1 - along)
    start = np.column_stack([width * (share - 0.5), 0.45 + 0.01 * along, 0.25 - cloth.vertices[:, 1]])

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.18)
    sphere = solid("sphere", ball.vertices + [0.0, 0.2, 0.0], ball.faces)
    scene = pb4u.Scene((placed(cloth, start),), (sphere,), options.frames)
    simulate(scene, options.out, options.self_contact == "on")


if __name__ == "__main__":
    main()
