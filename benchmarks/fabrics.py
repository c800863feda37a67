"""How named fabrics drape: coefficient and folds of a disc on a disc, beside what is published.

python benchmarks/fabrics.py [FABRIC ..] [--edges 6,14] [--seconds 3] > FILE.csv
"""

from __future__ import annotations

import argparse
import csv
import sys

from pb4u.garment.material import FABRICS, load_material
from pb4u.measures.drape_test import drape_test, published

HEAD = (
    "name", "edge [mm]", "drape coefficient [%]", "folds", "published [%]", "fastest [mm/s]", "iterations a step",
    "unsolved", "time [s]",
)  # fmt: skip


def main() -> None:
    """Print a row a fabric and edge length, as CSV."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fabrics", nargs="*", default=list(FABRICS), help="names or material files; all by default")
    parser.add_argument("--edges", default="6,14", help="edge lengths [mm]")
    parser.add_argument("--seconds", type=float, default=3.0, help="simulated for each")
    options = parser.parse_args()
    rows = csv.writer(sys.stdout, lineterminator="\n")
    rows.writerow(HEAD)
    for name in options.fabrics:
        band = published().get(name)
        for edge in map(float, options.edges.split(",")):
            found = drape_test(load_material(name), 1e-3 * edge, options.seconds)
            rows.writerow(
                (
                    name,
                    f"{edge:g}",
                    f"{found.coefficient:.1f}",
                    found.folds,
                    f"{band.lowest:g}-{band.highest:g}" if band else "",
                    f"{1e3 * found.speed:.0f}",
                    f"{found.iterations:.1f}",
                    found.unsolved,
                    f"{found.seconds:.0f}",
                )
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
