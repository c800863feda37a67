"""Plots networks that differ in propagation control and scaling across triangles, from tables.csv of `pb4u evaluate`.

python tools/arms_plot.py docs/results/literal/to_9600_triangles.csv --out docs/results/literal/across_triangles.png

A column's name without its ending -seedN is the network; a dot is a seed, a line their geometric mean. Models without
an ending, such as the start and the solver, are dotted.
"""

from __future__ import annotations

import argparse
import csv
import re
from collections import defaultdict
from pathlib import Path

import numpy as np

MEASURES = {
    "excess height [mm]": (10.0, 500.0),
    "total loss [J]": (1.0, 100.0),
    "distance from the solver's [mm]": (20.0, 500.0),
    "strain, 95th percentile": (0.05, 2.0),
}
"""What is drawn, and the least and most of its axis: garments that fly apart leave it by many powers of ten."""
SEED = re.compile(r"-seed\d+$")


def cells(file: Path) -> dict[tuple[int, str, str], float]:
    """Means by triangles, measure and column."""
    with file.open(newline="", encoding="utf-8") as stream:
        return {
            (int(line["table"].removeprefix("Level ")), line["row"], line["column"]): float(line["value"].split()[0])
            for line in csv.DictReader(stream)
            if line["table"].startswith("Level ") and line["row"] in MEASURES and line["value"] != "-"
        }


def main() -> None:
    """Draw a panel a measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    import matplotlib.pyplot as plt

    points: dict[tuple[str, str], dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    trained = set()
    for table in options.tables:
        for (triangles, measure, column), value in cells(table).items():
            name = SEED.sub("", column)
            points[measure, name][triangles].append(value)
            if name != column:
                trained.add(name)
    figure, panels = plt.subplots(2, 2, figsize=(11, 8), constrained_layout=True)
    levels = sorted({level for each in points.values() for level in each})
    for axes, (measure, limits) in zip(panels.flat, MEASURES.items(), strict=True):
        for name in sorted({name for _, name in points}, key=lambda name: (name not in trained, name)):
            at = sorted(points[measure, name])
            means = [np.exp(np.mean(np.log(np.maximum(points[measure, name][level], 1e-6)))) for level in at]
            (line,) = axes.plot(at, means, "-" if name in trained else ":", label=name)
            for level in at:
                values = points[measure, name][level]
                axes.plot([level] * len(values), values, "o", color=line.get_color(), markersize=4)
        axes.set(xscale="log", yscale="log", xlabel="triangles (trained on 1,200)", ylabel=measure)
        axes.set_xticks(levels, [f"{level:,}" for level in levels])
        axes.minorticks_off()
        axes.set_ylim(*limits)
    panels[0, 0].legend(fontsize="small")
    figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
