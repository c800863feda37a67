"""Draws trainings side by side: docs/results/training.png.

python tools/training_curves.py RUN [RUN ...] --out FILE

A run is a folder of `pb4u train`, called by its own name.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

SMOOTHED = 8
"""Lines of metrics.jsonl, a hundred steps each, that a point is the mean of."""


def lines(run: Path) -> list[dict[str, Any]]:
    """What a training wrote down of itself."""
    return [json.loads(line) for line in (run / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]


def draw(runs: list[Path]) -> plt.Figure:
    """Stretch of a training step; of validation the energy, and how much came before a garment was lost."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    titles = (
        f"stretch of a training step [J], mean of {100 * SMOOTHED}",
        "validation: energy without gravity [J]",
        "validation: frames before the garment is lost [%]",
    )
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel("optimiser steps", fontsize=9)
        axis.grid(True, color="#e6e6ea")
        axis.spines[["top", "right"]].set_visible(False)
    for run in runs:
        trained = [line for line in lines(run) if "stretch" in line]
        steps, stretch = (np.array([line[key] for line in trained]) for key in ("step", "stretch"))
        means = np.convolve(stretch, np.full(SMOOTHED, 1 / SMOOTHED), "valid")
        axes[0].semilogy(steps[SMOOTHED - 1 :], means, label=run.name)
        scored = [line for line in lines(run) if "validation" in line]
        for axis, key, factor in ((axes[1], "excess_height", 1e3), (axes[2], "survived", 100.0)):
            # Earlier versions wrote energies alone.
            known = [line for line in scored if line["validation"].get(key) is not None]
            values = [factor * line["validation"][key] for line in known]
            axis.plot([line["step"] for line in known], values, marker="o", markersize=4)
    axes[1].set_ylim(bottom=0.0)
    axes[2].set_ylim(0.0, 102.0)
    figure.legend(loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    return figure


def main() -> None:
    """Draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    draw(options.runs).savefig(options.out, dpi=100)
    print(options.out)


if __name__ == "__main__":
    main()
