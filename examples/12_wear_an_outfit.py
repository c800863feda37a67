"""Garments worn over each other: the same three in the order given, inner first, and with one tucked in.

    python examples/12_wear_an_outfit.py
    python examples/12_wear_an_outfit.py --garments trousers shirt.obj cardigan --tuck shirt

Order says who is over whom; tucked in, a garment goes beneath what is worn from the waist. Before anything moves they
are laid over each other so, and untangled. What cannot be parted is refused.
"""

from __future__ import annotations

import argparse

import numpy as np

import pb4u


def main() -> None:
    """Simulate the outfit in its order, and tucked in."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garments", nargs="+", default=["trousers", "tanktop", "cardigan"])
    parser.add_argument("--tuck", default="tanktop")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--model", default="auto")
    parser.add_argument("--out", default="outfit", help="beginning of the names of the files to write")
    options = parser.parse_args()

    simulator = pb4u.load_simulator(options.model)
    for way, tucked in (("as_it_comes", ""), ("tucked_in", options.tuck)):
        worn = [pb4u.WornGarment(name) for name in options.garments]
        worn = [pb4u.WornGarment(each.garment, tucked=each.name == tucked) for each in worn]
        scene = pb4u.make_scene(worn, motion=options.motion, triangles=options.triangles, frames=options.frames)
        print(f"{way}: {' under '.join(dressed.garment.name for dressed in scene.garments)}")

        trajectory = simulator.simulate(scene)
        crossing = pb4u.measure(trajectory)["metrics"]["self_intersections"]
        print(f"  pairs of triangles that cross, most of any frame: {crossing['max']:.0f}")
        for entry in trajectory.metadata["garments"]:
            first, stop = entry["vertices"]
            centre = np.asarray(trajectory.positions[-1, first:stop]).mean(axis=0)
            print(f"  {entry['name']:>12}: {stop - first} vertices, its middle {centre[1]:.2f} m high at the end")
        print(f"  written {trajectory.save(f'{options.out}_{way}.npz')}")


if __name__ == "__main__":
    try:
        main()
    except pb4u.Pb4uError as error:
        raise SystemExit(str(error)) from None
