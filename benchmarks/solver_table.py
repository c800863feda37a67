"""The rollouts of the solver as a Markdown table, from the reports of `pb4u simulate --model solver --json FILE`.

    python benchmarks/solver_table.py RUN.json [RUN.json ...]

A run of a recording is named after its file; what the name leaves out (arms held away) goes into `--note FILE=TEXT`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from statistics import mean
from typing import Any

COLUMNS = (
    "garment",
    "motion",
    "triangles",
    "frames",
    "iterations mean / most",
    "left above tolerance",
    "ms a frame",
    "energy without gravity [J]",
    "strain_p95 mean / max",
    "inside, most [%]",
    "deepest [mm]",
    "diverged",
)


def row(report: dict[str, Any], note: str = "") -> list[str]:
    """The cells of one run."""
    metrics, iterations = report["metrics"], report["solver_iterations"]
    strain = metrics["strain_p95"]
    return [
        report["garment"],
        ", ".join(filter(None, [Path(str(report["motion"])).stem, note])),
        f"{report['triangles']:,}",
        str(report["frames"]),
        f"{mean(iterations):.1f} / {max(iterations)}",
        f"{report['unsolved_steps']} of {len(iterations)}",
        f"{report['ms_per_step']:.0f}",
        f"{metrics['total']['mean'] - metrics['gravity']['mean']:.4f}",
        f"{strain['mean']:.3f} / {strain['max']:.3f}",
        f"{metrics['penetration_percent']['max']:.2f}",
        f"{1e3 * metrics['penetration_depth_max']['max']:.1f}",
        "yes" if report["diverged"] else "no",
    ]


def table(rows: list[list[str]]) -> str:
    """Markdown."""
    lines = [COLUMNS, ["---"] * len(COLUMNS), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reports", nargs="+", type=Path)
    parser.add_argument("--note", action="append", default=[], metavar="FILE=TEXT")
    options = parser.parse_args()
    notes = dict(note.split("=", 1) for note in options.note)
    reports = [(json.loads(path.read_text()), notes.get(path.name, "")) for path in options.reports]
    reports.sort(key=lambda r: (r[0]["garment"], r[0]["triangles"], str(r[0]["motion"]), r[1]))
    print(table([row(report, note) for report, note in reports]))


if __name__ == "__main__":
    main()
