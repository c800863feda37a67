"""Simulate a garment from your own OBJ, and get your own mesh back: vertex order, quads and UVs as you made them.

    python examples/01_your_own_garment.py my_shirt.obj --body man

The file is in metres, Y up, placed on the body at rest. No garment at hand? Write one, and the body to fit it to:

    pb4u assets write tshirt my_shirt.obj --body man
    pb4u assets write man man.obj

A file has no pins. A waistband or straps that are found hold it; where none is found, give --pins waist.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pb4u
from pb4u.export.selection import on_source
from pb4u.garment.diagnosis import diagnose
from pb4u.garment.garment_file import read_source
from pb4u.garment.repair import repair
from pb4u.geometry.obj_file import write_obj


def main() -> None:
    """Diagnose, mend, simulate, and carry the motion back to the author's mesh."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("garment", type=Path)
    parser.add_argument("--body", default="woman")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, help="remesh to about so many triangles; default as it is")
    parser.add_argument("--pins", help="vertices that follow the body, such as waist; default none")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--model", default="auto")
    parser.add_argument("--out", type=Path, default=Path("moved.obj"), help="one OBJ a frame is written")
    options = parser.parse_args()

    # What would go wrong: units, axes, open seams, faces that meet where cloth cannot, cloth inside the body ...
    body = pb4u.load_body(options.body)
    mesh = read_source(options.garment)
    for finding in diagnose(mesh, body, options.garment).findings:
        print(f"{finding.severity.value}: {finding.sentence} Fix: {finding.fix}.")

    # ... and the mend of all that is safe to mend. The file itself is left alone.
    mended = repair(mesh, body)
    garment = options.garment
    if mended.changes:
        garment = options.out.with_name(f"{garment.stem}_mended.obj")
        write_obj(garment, mended.mesh)
        print("mended:", *mended.changes)

    scene = pb4u.make_scene(
        garment, body, options.motion, triangles=options.triangles, frames=options.frames, pins=options.pins
    )
    trajectory = pb4u.load_simulator(options.model).simulate(scene)

    # The simulated mesh has triangles only, and with --triangles other ones than yours; yours rides on it.
    moved = on_source(trajectory)
    print(f"simulated {trajectory.positions.shape[1]} vertices, carried to {moved.positions.shape[1]} of the file")
    pb4u.export_trajectory(moved, options.out)
    print(f"written: {options.out.stem}_0000.obj and {moved.frame_count - 1} more")


if __name__ == "__main__":
    main()
