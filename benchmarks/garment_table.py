"""Prints every built-in garment at every level as CSV: counts, evenness, angles, borders, clearance.

Run: python benchmarks/garment_table.py [woman|man] [--levels 2500,11000]
"""

from __future__ import annotations

import argparse
import csv
import sys
import time

import numpy as np
from trimesh.triangles import angles

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.garment.clearance import rest_distances
from pb4u.garment.library import LEVELS, build_garment, garment_names

HEADER = (
    "garment", "requested", "triangles", "vertices", "mean edge [mm]", "edge variation", "smallest angle [deg]",
    "boundary loops", "vertices inside", "least clearance [mm]", "build [s]",
)  # fmt: skip


def row(name: str, body: ShapedBody, triangles: int) -> tuple[str, ...]:
    begin = time.process_time()
    garment = build_garment(name, body, triangles)
    seconds = time.process_time() - begin
    distance = rest_distances(garment.vertices, body)
    centres = rest_distances(garment.vertices[garment.faces].mean(axis=1), body)
    lengths = garment.edge_lengths
    angle = np.degrees(angles(garment.vertices[garment.faces]).min())
    return (
        name, str(triangles), str(garment.triangle_count), str(len(garment.vertices)),
        f"{1e3 * lengths.mean():.1f}", f"{lengths.std() / lengths.mean():.3f}", f"{angle:.1f}",
        str(len(garment.topology.boundary_loops)), str(int((distance < 0).sum())),
        f"{1e3 * min(distance.min(), centres.min()):.1f}", f"{seconds:.1f}",
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("body", nargs="?", default="woman")
    parser.add_argument("--levels", default=",".join(str(count) for count in LEVELS.values()))
    arguments = parser.parse_args()
    body = load_body(arguments.body)
    lines = csv.writer(sys.stdout, lineterminator="\n")
    lines.writerow(HEADER)
    for name in garment_names():
        for count in arguments.levels.split(","):
            lines.writerow(row(name, body, int(count)))
            sys.stdout.flush()


if __name__ == "__main__":
    main()
