"""Keep what is simulated in a scene file, which a text editor changes and `pb4u simulate scene.toml` runs as well.

    python examples/07_scene_file.py
    python examples/07_scene_file.py --garments dress --materials silk --motion turn

Paths in the file are relative to it, so that a folder with the scene, its meshes and its recordings can be moved.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import pb4u


def main() -> None:
    """Describe a run, write it, read it back with another cloth, and simulate it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garments", nargs="+", default=["tshirt"], help="names or mesh files, inner first")
    parser.add_argument("--materials", nargs="+", default=["silk", "wool"], help="one scene file for each")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--model", default="auto")
    parser.add_argument("--out", type=Path, default=Path("scene"), help="beginning of the names of the files to write")
    options = parser.parse_args()

    # A run names things and loads nothing. What is left out has its default; what cannot be is refused here.
    worn = [pb4u.WornGarment(name, triangles=options.triangles) for name in options.garments]
    run = pb4u.Run(tuple(worn), motion=options.motion, frames=options.frames, model=options.model)

    # Runs are never changed in place: replace() makes another one, and checks it again.
    for material in options.materials:
        garments = tuple(replace(each, material=material) for each in worn)
        variant = replace(run, garments=garments)
        stem = f"{options.out}_{Path(material).stem}"
        file = variant.save(f"{stem}.toml")

        # The file holds the whole run: whoever opens it gets the same numbers.
        again = pb4u.Run.open(file)
        trajectory = again.simulate(f"{stem}.npz")
        hem = trajectory.positions[-1, :, 1].min()
        print(f"{file}: {trajectory.frame_count} frames in {material}, hem at {hem:.3f} m in the last one")
    print(f"edit {file} and run it with: pb4u simulate {file}")


if __name__ == "__main__":
    try:
        main()
    except pb4u.Pb4uError as error:
        raise SystemExit(str(error)) from None
