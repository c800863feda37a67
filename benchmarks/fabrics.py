"""How named fabrics drape: coefficient and folds of a disc on a disc, beside what is published.

python benchmarks/fabrics.py [FABRIC ..] [--edges 6,14] [--seconds 3] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pb4u.garment.material import FABRICS, load_material
from pb4u.measures.drape_test import drape_test, published


def main() -> None:
    """Print a row a fabric and edge length."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fabrics", nargs="*", default=list(FABRICS), help="names or material files; all by default")
    parser.add_argument("--edges", default="6,14", help="edge lengths [mm]")
    parser.add_argument("--seconds", type=float, default=3.0, help="simulated for each")
    parser.add_argument("--json", type=Path, help="file for the rows")
    options = parser.parse_args()
    rows = []
    print("fabric | edge mm | drape coefficient % | folds | published % | fastest mm/s | iterations | unsolved | s")
    for name in options.fabrics:
        band = published().get(name)
        for edge in map(float, options.edges.split(",")):
            found = drape_test(load_material(name), 1e-3 * edge, options.seconds)
            measured = {key: value for key, value in vars(found).items() if key != "draped"}
            rows.append({"fabric": name, "edge_mm": edge, "published": band and band._asdict(), **measured})
            print(
                f"{name} | {edge:g} | {found.coefficient:.1f} | {found.folds} | "
                f"{f'{band.lowest:g}-{band.highest:g}' if band else '-'} | {1e3 * found.speed:.0f} | "
                f"{found.iterations:.1f} | {found.unsolved} | {found.seconds:.0f}",
                flush=True,
            )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
