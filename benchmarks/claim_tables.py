"""The tables and the decisions of docs/science/claims.md, from the rows that `claims.py` writes.

python benchmarks/claim_tables.py ROWS.jsonl [MORE.jsonl ..] [--csv FILE] [--draw FILE.svg]
python benchmarks/claim_tables.py docs/results/claims/rollouts.csv
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import wilcoxon

from pb4u.paper.summary import wilson

DECIDING = (2730, 4140, 9600)
"""Levels of 2.27 times the triangles of the training and more that ran whole."""
FEW_SCENES = 19200
"""Level from which on the plan has fewer scenes."""
SIGNIFICANT = 0.05
DRAWS = 10_000
COLUMNS = (
    "triangles", "garment", "motion", "arm", "seed", "scaling", "steps", "lost", "millimetres", "strain", "paper_total",
    "strain_max", "edge_length", "faces", "propagation_steps",
)  # fmt: skip
"""Of the CSV file."""
DRAWN = (
    ("drawn", "per-vertex", "K by the rule, the paper's scaling", "tab:red", "-"),
    ("drawn", "none", "K by the rule, no scaling", "tab:gray", "-"),
    ("drawn", "band-split", "K by the rule, band-split", "tab:blue", "-"),
    ("trained at 5", "per-vertex", "K = 5, the paper's scaling", "tab:red", ":"),
    ("trained at 5", "band-split", "K = 5, band-split", "tab:blue", ":"),
    ("warm-start", "", "body-motion start", "black", "--"),
    ("gradient-descent", "", "gradient descent", "tab:green", "--"),
    ("quick-solver", "", "quick solver", "tab:olive", "--"),
)
"""Arm, scaling, name and line of the plot."""
LAWS = {"drawn": 0, "trained at 5": 5}
"""Propagation steps by which each arm is judged, 0 by the rule."""
Row = dict[str, Any]
Scene = tuple[str, str]


def read(path: Path) -> list[Row]:
    """Rollouts of a file of `claims.py`, or of a CSV file of the documentation.

    Args:
        path: of the file.
    """
    with path.open(newline="", encoding="utf-8") as stream:
        if path.suffix != ".csv":
            return [json.loads(line) for line in stream]
        words = "garment", "motion", "arm", "scaling"
        return [
            {key: text if key in words else _value(text) for key, text in row.items()} for row in csv.DictReader(stream)
        ]


def whole(rows: Sequence[Row]) -> list[Row]:
    """Rollouts of those methods that ran in every scene, by level, scene and method; the finest levels have few scenes.

    Args:
        rows: rollouts.
    """

    def method(row: Row) -> tuple[Any, ...]:
        return row["triangles"], row["arm"], row["scaling"], row["steps"], row["seed"]

    counts = Counter(map(method, rows))
    most = {row["triangles"]: 0 for row in rows}
    for (triangles, *_), count in counts.items():
        most[triangles] = max(most[triangles], count)
    fullest = max(most.values(), default=0)
    kept = [
        row
        for row in rows
        if counts[method(row)] == most[row["triangles"]]
        and (most[row["triangles"]] == fullest or row["triangles"] >= FEW_SCENES)
    ]
    return sorted(kept, key=lambda row: (row["triangles"], row["garment"], row["motion"]))


def write(rows: Sequence[Row], path: Path) -> None:
    """Write rollouts as the CSV file that `read` reads.

    Args:
        rows: rollouts.
        path: of the file.
    """

    def cell(value: Any) -> Any:
        if isinstance(value, str):
            return value
        return "" if value is None else f"{value:.6g}" if isinstance(value, float) else json.dumps(value)

    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([cell(row[name]) for name in COLUMNS] for row in rows)


def _value(text: str) -> Any:
    return json.loads(text) if text else None


def page(rows: Sequence[Row]) -> str:
    """All tables and decisions, as Markdown.

    Args:
        rows: rollouts.
    """
    levels = sorted({row["triangles"] for row in rows})
    parts = [
        f"## {level:,} triangles\n\n{table([row for row in rows if row['triangles'] == level])}" for level in levels
    ]
    return "\n\n".join([*parts, "## Decisions", "\n".join(decisions(whole(rows)))]) + "\n"


def table(rows: Sequence[Row]) -> str:
    """One line a method: lost with its interval, then the medians with their quartiles.

    Args:
        rows: rollouts of a level.
    """
    lines = [
        "| arm | scaling | K | lost | distance [mm] | strain p95 | paper's total |",
        "|---|---|---|---|---|---|---|",
    ]
    methods: dict[tuple[str, str, int], list[Row]] = defaultdict(list)
    for row in rows:
        methods[row["arm"], row["scaling"], row["steps"]].append(row)
    for (arm, scaling, steps), of_it in sorted(methods.items(), key=lambda each: (each[0][1] != "", each[0])):
        lost = sum(row["lost"] for row in of_it)
        low, high = (100.0 * end for end in wilson(lost, len(of_it)))
        ruled = "" if not scaling else str(steps) if steps else "rule"
        cells = [_median(row[name] for row in of_it) for name in ("millimetres", "strain", "paper_total")]
        shown = f"{lost}/{len(of_it)} ({low:.0f} to {high:.0f} %)"
        lines.append(f"| {' | '.join([arm, scaling or '-', ruled or '-', shown, *cells])} |")
    return "\n".join(lines)


def _median(values: Iterable[float | None]) -> str:
    """Median and quartiles; what is not finite ranks last."""
    low, middle, high = _quartiles(values)
    return "-" if math.isnan(middle) else f"{middle:.3g} ({low:.3g} to {high:.3g})"


def _quartiles(values: Iterable[float | None]) -> tuple[float, float, float]:
    """Lower quartile, median and upper one; not a number where none is finite."""
    ranked = sorted(math.inf if value is None or math.isnan(value) else value for value in values)
    if not ranked or math.isinf(ranked[0]):
        return math.nan, math.nan, math.nan
    low, middle, high = np.percentile(ranked, (25, 50, 75), method="nearest")
    return float(low), float(middle), float(high)


def decisions(rows: Sequence[Row]) -> list[str]:
    """One sentence a test.

    Args:
        rows: rollouts of all levels.
    """
    counted = [row for row in rows if row["triangles"] in DECIDING]
    by_law = list(LAWS.items())
    ruled = ("drawn", 0)
    found = [
        _sentence("Claim 1, lost without scaling less lost with it", _lost(counted, by_law, "none", "per-vertex"), 1),
        _sentence(
            "Cost of scaling, log distance with it over that without",
            _distances(counted, [(law, "per-vertex", law, "none") for law in by_law]), 1,
        ),
        _sentence("Claim 2, log distance of the rule over K = 5", _distances(counted, [_control("per-vertex")]), -1),
        _sentence("Claim 2 with band-split", _distances(counted, [_control("band-split")]), -1),
        _sentence(
            "Band-split, lost per-vertex less lost with it", _lost(counted, [ruled], "per-vertex", "band-split"), 1
        ),
        _sentence(
            "Band-split, log distance over per-vertex",
            _distances(counted, [(ruled, "band-split", ruled, "per-vertex")]), -1,
        ),
    ]  # fmt: skip
    for scaling in ("per-vertex", "band-split"):
        compared = [(ruled, scaling, ("warm-start", 0), "")]
        found.append(_sentence(f"Worth of {scaling}, log distance over the start", _distances(counted, compared), -1))
    return found


def _control(scaling: str) -> tuple[tuple[str, int], str, tuple[str, int], str]:
    return ("drawn", 0), scaling, ("trained at 5", 5), scaling


def _scenes(rows: Sequence[Row]) -> list[Scene]:
    return sorted({(row["garment"], row["motion"]) for row in rows})


def _lost(rows: Sequence[Row], arms: Sequence[tuple[str, int]], one: str, other: str) -> list[float]:
    """Of each scene, the share lost with the scaling `one` less that with the `other`."""
    found = []
    for scene in _scenes(rows):
        shares = [
            [row["lost"] for row in rows if _is(row, scene, scaling) and (row["arm"], row["steps"]) in arms]
            for scaling in (one, other)
        ]
        if all(shares):
            found.append(float(np.mean(shares[0]) - np.mean(shares[1])))
    return found


def _is(row: Row, scene: Scene, scaling: str) -> bool:
    return (row["garment"], row["motion"]) == scene and row["scaling"] == scaling


def _distances(rows: Sequence[Row], pairs: Sequence[tuple[tuple[str, int], str, tuple[str, int], str]]) -> list[float]:
    """Of each scene, the log ratio of two distances: medians over seeds and laws of K, then the mean over levels."""

    def by_seed(scene: Scene, level: int, arm: tuple[str, int], scaling: str) -> dict[int, float | None]:
        return {
            row["seed"]: row["millimetres"]
            for row in rows
            if _is(row, scene, scaling) and row["triangles"] == level and (row["arm"], row["steps"]) == arm
        }

    found = []
    for scene in _scenes(rows):
        of_levels = []
        for level in sorted({row["triangles"] for row in rows}):
            ratios = []
            for arm, scaling, other, beside in pairs:
                mine, theirs = by_seed(scene, level, arm, scaling), by_seed(scene, level, other, beside)
                for seed, one in mine.items():
                    # A control has one seed, beside which all of a network's stand.
                    if (paired := seed if beside else 0) in theirs:
                        ratios.append(_log_ratio(one, theirs[paired]))
            if kept := [ratio for ratio in ratios if not math.isnan(ratio)]:
                of_levels.append(float(np.median(kept)))
        if of_levels:
            found.append(_mean(of_levels))
    return found


def _log_ratio(one: float | None, other: float | None) -> float:
    """Infinite where one is not finite, no number where neither is."""
    if one is None or other is None:
        return math.nan if one is other else math.inf if one is None else -math.inf
    return math.log(one / other)


def _mean(values: Sequence[float]) -> float:
    """Mean, by the signs of infinite values where there are some."""
    infinite = [math.copysign(1.0, value) for value in values if math.isinf(value)]
    return float(np.mean(values)) if not infinite else math.copysign(math.inf, sum(infinite)) if sum(infinite) else 0.0


def decided(values: Sequence[float], sign: int, seed: int = 0) -> tuple[str, float, tuple[float, float], float]:
    """Answer, mean, its bootstrap interval and p of paired differences.

    Args:
        values: one a scene; infinite ones rank last.
        sign: 1 where differences above 0 speak for the claim, -1 where those below do.
        seed: of the bootstrap.
    """
    ranked = np.asarray(values, dtype=float)
    finite = np.abs(ranked[np.isfinite(ranked)])
    most = 2.0 * float(finite.max(initial=0.5))
    ranked = np.where(np.isinf(ranked), np.sign(ranked) * most, ranked)
    mean = float(ranked.mean())
    draws = np.random.default_rng(seed).integers(0, len(ranked), (DRAWS, len(ranked)))
    low, high = np.percentile(ranked[draws].mean(axis=1), (2.5, 97.5))
    p = float(wilcoxon(ranked).pvalue) if np.any(ranked) else 1.0
    outside = low > 0.0 or high < 0.0
    answer = "undecided"
    if p < SIGNIFICANT and outside:
        answer = "holds" if sign * mean > 0 else "the opposite holds"
    return answer, mean, (float(low), float(high)), p


def _sentence(what: str, values: Sequence[float], sign: int) -> str:
    if len(values) < 2:
        return f"- {what}: no pairs yet."
    answer, mean, (low, high), p = decided(values, sign)
    return f"- {what}: {answer}. Mean {mean:.3f} ({low:.3f} to {high:.3f}), p = {p:.2g}, {len(values)} scenes."


def draw(rows: Sequence[Row], out: Path) -> None:
    """Plot shares lost with their intervals, and median distances with their quartiles, against triangles.

    Args:
        rows: rollouts.
        out: SVG file.
    """
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    pyplot.rcParams.update({"svg.hashsalt": "claims", "svg.fonttype": "none"})
    figure, panels = pyplot.subplots(1, 2, figsize=(9.6, 3.2), layout="constrained")
    levels = sorted({row["triangles"] for row in rows})
    for number, (arm, scaling, name, colour, line) in enumerate(DRAWN):
        at = np.array(levels) * 1.025 ** (number - len(DRAWN) / 2)
        of_levels = [
            [
                row
                for row in rows
                if (row["triangles"], row["arm"], row["scaling"], row["steps"])
                == (level, arm, scaling, LAWS.get(arm, 0))
            ]
            for level in levels
        ]
        counts = [(sum(row["lost"] for row in part), len(part)) for part in of_levels]
        shares = np.array([(lost / of, *wilson(lost, of)) for lost, of in counts])
        far = np.array([_quartiles(row["millimetres"] for row in part) for part in of_levels])
        for panel, values in ((panels[0], 100.0 * shares), (panels[1], far[:, [1, 0, 2]])):
            spans = np.abs(values[:, 1:].T - values[:, 0])
            panel.errorbar(at, values[:, 0], spans, label=name, color=colour, linestyle=line, marker=".", capsize=2)
    panels[0].set(title="Lost [%], 95 % intervals")
    panels[1].set(title="From the solver [mm], quartiles", yscale="log", ylim=(5.0, 1000.0))
    for panel in panels:
        panel.set(xscale="log", xlabel="triangles; trained at 1,200")
        panel.set_xticks(levels, [f"{level:,}" for level in levels])
        panel.minorticks_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=8)
    figure.savefig(out, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", type=Path, nargs="+")
    parser.add_argument("--csv", type=Path, help="file for the rollouts of what ran in every scene")
    parser.add_argument("--draw", type=Path, help="file for the plot")
    options = parser.parse_args()
    rows = [row for path in options.rows for row in read(path)]
    if options.csv:
        write(whole(rows), options.csv)
    if options.draw:
        draw(whole(rows), options.draw)
    print(page(rows))


if __name__ == "__main__":
    main()
