"""Plots the four networks with and without control and scaling across triangles, from the tables of `pb4u evaluate`.

python tools/arms_plot.py docs/results/arms/*.md --out docs/results/arms/across_triangles.png
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np

ARMS = {
    "control and scaling": ("both-parts", "by-rule"),
    "without propagation control": ("without-control",),
    "without update scaling": ("without-scaling",),
    "without both": ("without-both",),
}
"""What each network is called, and how its column begins."""

MEASURES = {"excess height [mm]": "excess height / the start's", "energy / reference": "energy / the solver's"}


def cells(page: str) -> dict[tuple[int, str, str], float]:
    """Means by triangles, measure and column."""
    found = {}
    for part in page.split("## Level ")[1:]:
        level, _, rest = part.partition("\n")
        rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in rest.split("\n") if line.startswith("|")]
        for name, *values in rows:
            if name in MEASURES:
                found |= {
                    (int(level), name, column): float(value.split()[0])
                    for column, value in zip(rows[0][1:], values, strict=True)
                    if value.split()[0] != "-"
                }
    return found


def main() -> None:
    """Draw a panel a measure, a line an arm through the mean over seeds, and a dot a seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    import matplotlib.pyplot as plt

    points: dict[tuple[str, str], dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for table in options.tables:
        found = cells(table.read_text())
        for (triangles, measure, column), value in found.items():
            for arm, beginnings in ARMS.items():
                if column.startswith(beginnings):
                    start = found[triangles, measure, "warm-start"] if measure.startswith("excess") else 1.0
                    points[measure, arm][triangles].append(value / start)
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.2), constrained_layout=True)
    for axes, (measure, label) in zip(panels, MEASURES.items(), strict=True):
        for arm in ARMS:
            levels = sorted(points[measure, arm])
            means = [np.exp(np.mean(np.log(points[measure, arm][level]))) for level in levels]
            (line,) = axes.plot(levels, means, label=arm)
            for level in levels:
                values = points[measure, arm][level]
                axes.plot([level] * len(values), values, "o", color=line.get_color(), markersize=4)
        axes.set(xscale="log", yscale="log", xlabel="triangles (trained on 1,200)", ylabel=label)
        axes.set_xticks(levels, [f"{level:,}" for level in levels])
        axes.minorticks_off()
    panels[0].set_yticks([0.7, 0.8, 0.9, 1.0, 1.1], ["0.7", "0.8", "0.9", "1", "1.1"])
    panels[1].set_yticks(marks := [1, 2, 5, 10, 20, 50, 100, 200], map(str, marks))
    panels[0].axhline(1.0, color="grey", linewidth=0.8, linestyle=":")
    panels[1].legend()
    figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
