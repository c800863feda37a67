"""The plots of a run's report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from pb4u.paper.page import Block, Plot, png
from pb4u.paper.paper_figures import paper_figures
from pb4u.paper.summary import Cell, Summary
from pb4u.paper.tables import PAPER_MARK, label

_COLOURS = ("#0b6cb8", "#d1495b", "#2a9d63", "#8a4fbf", "#d98c00", "#1aa6a6", "#a85632", "#6b7a00")
_REFERENCE = "#1c1c1e"
_EXPLODED = 50.0
"""Total loss [J] beyond which a panel turns logarithmic: cloth that holds together has a few at most."""
_ENTRY_WIDTH, _ENTRY_HEIGHT = 2.6, 0.18
"""Inches that an entry of the legend takes."""


def across_levels(
    summary: Summary,
    quantities: Sequence[str] = ("stretch", "bending", "collision", "inertia", "ratio", "survived_percent"),
) -> list[Block]:
    """Panels of quantities against the number of triangles, a line a model; the paper's lines dotted.

    Args:
        summary: the run.
        quantities: a panel each, where the run has values of it.
    """
    protocol = summary.plan.protocol
    drawn = {name for cell in summary.cells() for name, value in cell.quantities.items() if value is not None}
    quantities = [quantity for quantity in quantities if quantity in drawn]
    if len(protocol.levels) < 2 or not quantities:
        return []
    figure, axes = _figure(len(quantities), min(3, len(quantities)))
    for axis, quantity in zip(axes, quantities, strict=False):
        means: list[float] = []
        for name, column in summary.columns.items():
            cells = [summary.cell(level, *column) for level in protocol.levels]
            means += _line(axis, quantity, [(cell.triangles, cell) for cell in cells], name, tuple(summary.columns))
        _paper_lines(axis, summary, quantity)
        axis.set_xscale("log")
        axis.set_xticks([_triangles(summary, level) for level in protocol.levels], protocol.levels, minor=False)
        axis.set_xticks([], minor=True)
        _scale(axis, quantity, means)
        axis.set_title(label(quantity), fontsize=9, loc="left")
        axis.set_xlabel("triangles", fontsize=8)
    caption = "Mean over scenes against the garments' number of triangles; both axes are logarithmic."
    return _plot("across_levels", "Across resolutions", caption, figure, axes)


def over_time(summary: Summary, term: str, preferred: str) -> list[Block]:
    """A term over the frames at the top level, a panel a garment and a line a model.

    Args:
        summary: the run.
        term: the energy.
        preferred: the motion to show where the run has it; its first otherwise.
    """
    protocol = summary.plan.protocol
    motions = [row.case.motion for row in summary.rows]
    motion, level = preferred if preferred in motions else motions[0], protocol.levels[-1]
    rows = summary.select(level=level, motion=motion, body=summary.rows[0].coordinates["body"])
    garments = list(dict.fromkeys(row.coordinates["garment"] for row in rows))
    figure, axes = _figure(len(garments), min(4, len(garments)))
    for axis, garment in zip(axes, garments, strict=False):
        for row in (row for row in rows if row.coordinates["garment"] == garment):
            series, style = row.series(term), _style(row.model, protocol.models)
            if series:
                axis.plot(range(len(series)), series, label=row.model, **style)
                if row.result and row.result["failed_at"] is not None:
                    axis.plot(len(series) - 1, series[-1], "x", color=style["color"])
        axis.set_yscale("log", nonpositive="mask")
        axis.set_title(garment, fontsize=9, loc="left")
        axis.set_xlabel("frame", fontsize=8)
    axes[0].set_ylabel(f"{term} [J]", fontsize=8)
    caption = f"{term.capitalize()} energy of each frame on {motion} at level {level}, logarithmic."
    return _plot(f"{term}_over_time", f"{term.capitalize()} over time", caption, figure, axes)


def against_steps(summary: Summary) -> list[Block]:
    """Total and ratio to the reference against the number of propagation steps, a column a level and a line a model.

    Args:
        summary: results of the run.
    """
    protocol = summary.plan.protocol
    panels = [(quantity, level) for quantity in ("total", "ratio") for level in protocol.levels]
    figure, axes = _figure(len(panels), len(protocol.levels))
    asked = [steps for steps in protocol.steps if steps is not None]
    for axis, (quantity, level) in zip(axes, panels, strict=True):
        means: list[float] = []
        for model in protocol.models:
            style = _style(model, protocol.models)
            cells = [summary.cell(level, model, steps) for steps in asked]
            line = _line(axis, quantity, [(cell.steps, cell) for cell in cells], model, protocol.models)
            for own in _own_steps(summary, level, model) if line else ():
                axis.axvline(own, ymax=0.06, **style)
            means += line
            fixed = summary.cell(level, model).quantities[quantity]
            if fixed is not None:
                means.append(fixed.mean)
                axis.axhline(fixed.mean, linestyle="--", label=model, **style)
        _scale(axis, quantity, means)
        axis.set_title(f"{level}: {label(quantity)}", fontsize=9, loc="left")
        axis.set_xlabel("propagation steps K", fontsize=8)
    caption = (
        "Upper: total loss by the released convention. Lower: mean energy without gravity over the reference. Dashed: "
        "models without propagation steps to set. Tick: the number of steps that the model's own rule takes."
    )
    return _plot("against_steps", "Loss against propagation steps", caption, figure, axes)


def _figure(panels: int, columns: int) -> tuple[Figure, list[Any]]:
    """A figure and its axes, row by row."""
    rows = -(-panels // columns)
    # Narrow figures would push the legend below them out of the picture.
    figure = Figure(figsize=(max(3.6 * columns, 8.0), 2.9 * rows + 0.3), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(True, color="#e6e6ea", linewidth=0.7)
        axis.tick_params(which="both", labelsize=7)
    for axis in axes[panels:]:
        axis.set_visible(False)
    return figure, axes


def _style(model: str, models: Sequence[str]) -> dict[str, Any]:
    if model == "solver":
        return {"color": _REFERENCE, "linewidth": 1.8}
    others = [name for name in models if name != "solver"]
    return {"color": _COLOURS[others.index(model) % len(_COLOURS)], "linewidth": 1.4}


def _line(
    axis: Any, quantity: str, points: Sequence[tuple[float | None, Cell]], model: str, models: Sequence[str]
) -> list[float]:
    """Draws mean and deviation of cells at x, where both are there; returns the means."""
    found = [(x, y.mean, y.deviation) for x, cell in points if x is not None and (y := cell.quantities[quantity])]
    if not found:
        return []
    x, means, deviations = zip(*found, strict=True)
    bars = {"marker": "o", "markersize": 3.5, "capsize": 2, "elinewidth": 0.8}
    axis.errorbar(x, means, deviations, label=model, **bars, **_style(model, models))
    return list(means)


def _paper_lines(axis: Any, summary: Summary, quantity: str) -> None:
    protocol = summary.plan.protocol
    theirs: dict[str, list[tuple[float, float]]] = {}
    for level in protocol.levels:
        for model, figures in paper_figures(protocol.name, level).items():
            if quantity in figures:
                theirs.setdefault(model, []).append((_triangles(summary, level), figures[quantity]))
    for index, (model, points) in enumerate(theirs.items()):
        x, y = zip(*points, strict=True)
        grey = str(0.35 + 0.5 * index / max(len(theirs), 1))
        style = ":" if len(points) > 1 else ""
        axis.plot(x, y, style, marker="x", markersize=4, color=grey, linewidth=1, label=f"{model} ({PAPER_MARK})")


def _scale(axis: Any, quantity: str, means: Sequence[float]) -> None:
    """Logarithmic; the total has no zero and any sign, and is so only where it explodes. Shares are linear."""
    if quantity == "survived_percent":
        axis.set_ylim(0.0, 105.0)
    elif quantity != "total":
        if any(mean > 0 for mean in means):
            axis.set_yscale("log", nonpositive="mask")
    elif max(map(abs, means), default=0.0) > _EXPLODED:
        axis.set_yscale("symlog", linthresh=1.0)


def _triangles(summary: Summary, level: str) -> float:
    return float(summary.select(level=level)[0].case.job.run.garments[0].triangles or 0)


def _own_steps(summary: Summary, level: str, model: str) -> list[int]:
    """K that a model's own rule takes on the garments of a level."""
    own = {row.result["own_steps"] for row in summary.select(level=level, model=model) if row.result}
    return sorted(steps for steps in own if steps)


def _plot(name: str, title: str, caption: str, figure: Figure, axes: Sequence[Any]) -> list[Block]:
    """The figure with a legend below all panels; nothing where nothing was drawn."""
    entries: dict[str, Any] = {}
    for axis in axes:
        for line, model in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(model, line)
    if not entries:
        return []
    # The run's own first.
    names = sorted(entries, key=lambda model: PAPER_MARK in model)
    columns = max(1, min(len(entries), int(figure.get_figwidth() / _ENTRY_WIDTH)))
    figure.set_figheight(figure.get_figheight() + _ENTRY_HEIGHT * -(-len(entries) // columns))
    lines = [entries[model] for model in names]
    figure.legend(lines, names, loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
    return [Plot(name, title, caption, png(figure, 130))]
