"""The plots of a run's report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from matplotlib import colormaps
from matplotlib.figure import Figure

from pb4u.paper.page import Block, Plot
from pb4u.paper.summary import Cell, Summary
from pb4u.paper.tables import label

_COLOURS = [colormaps[name](number) for name, count in (("tab10", 10), ("Dark2", 8)) for number in range(count)]
"""Of the models but the solver, which is black."""


def across_levels(
    summary: Summary,
    quantities: Sequence[str] = ("stretch", "bending", "collision", "inertia", "ratio", "survived_percent"),
) -> list[Block]:
    """Panels of quantities at each level, a line a model.

    Args:
        summary: the run.
        quantities: one panel each, if the run has values.
    """
    levels = summary.plan.protocol.levels
    lines = {name: [summary.cell(level, *column) for level in levels] for name, column in summary.columns.items()}
    cells = [cell for line in lines.values() for cell in line]
    quantities = [quantity for quantity in quantities if any(cell.quantities[quantity] for cell in cells)]
    if len(levels) < 2 or not quantities:
        return []
    figure, axes = _panels([label(quantity) for quantity in quantities], min(3, len(quantities)), "level")
    for axis, quantity in zip(axes, quantities, strict=False):
        for index, (name, line) in enumerate(lines.items()):
            _line(axis, range(len(levels)), line, quantity, name, _colour(index, name))
        axis.set_xticks(range(len(levels)), levels)
    return _plot("across_levels", "Across resolutions", "Mean and deviation over scenes at each level.", figure, axes)


def over_time(summary: Summary, term: str, preferred: str) -> list[Block]:
    """A term over the frames at the top level, a panel a garment and a line a model.

    Args:
        summary: the run.
        term: the energy.
        preferred: the motion to show if the run has it; otherwise its first.
    """
    models, level = summary.plan.protocol.models, summary.plan.protocol.levels[-1]
    motions = [row.case.motion for row in summary.rows]
    motion = preferred if preferred in motions else motions[0]
    rows = summary.select(level=level, motion=motion, body=summary.rows[0].coordinates["body"])
    garments = list(dict.fromkeys(row.case.garment for row in rows))
    figure, axes = _panels(garments, min(4, len(garments)), "frame")
    for row in rows:
        axis = axes[garments.index(row.case.garment)]
        axis.set_yscale("log", nonpositive="mask")
        if series := row.series(term):
            axis.plot(series, label=row.model, color=_colour(models.index(row.model), row.model))
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
    counts = [steps for steps in protocol.steps if steps is not None]
    titles = [f"{level}: {label(quantity)}" for quantity, level in panels]
    figure, axes = _panels(titles, len(protocol.levels), "propagation steps K")
    for axis, (quantity, level) in zip(axes, panels, strict=True):
        for index, model in enumerate(protocol.models):
            cells, colour = [summary.cell(level, model, steps) for steps in counts], _colour(index, model)
            _line(axis, counts, cells, quantity, model, colour)
            if fixed := summary.cell(level, model).quantities[quantity]:
                axis.axhline(fixed.mean, linestyle="--", label=model, color=colour)
    caption = (
        "Upper: total loss by the released convention. Lower: mean energy without gravity over the reference. Dashed: "
        "models without propagation steps to set."
    )
    return _plot("against_steps", "Loss against propagation steps", caption, figure, axes)


def _panels(titles: Sequence[str], columns: int, x: str) -> tuple[Figure, list[Any]]:
    """A figure and its axes, row by row."""
    rows = math.ceil(len(titles) / columns)
    # Narrow figures would push the legend below them out of the picture.
    figure = Figure(figsize=(max(3.6 * columns, 8.0), 2.9 * rows + 1.0), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axis in axes[len(titles) :]:
        axis.set_visible(False)
    for axis, title in zip(axes, titles, strict=False):
        axis.set_title(title, fontsize=9, loc="left")
        axis.set_xlabel(x, fontsize=8)
        axis.grid(True, linewidth=0.5)
        axis.tick_params(which="both", labelsize=7)
    return figure, axes


def _colour(index: int, model: str) -> Any:
    return "black" if model == "solver" else _COLOURS[index % len(_COLOURS)]


def _line(axis: Any, x: Sequence[Any], cells: Sequence[Cell], quantity: str, model: str, colour: Any) -> None:
    """Mean and deviation of cells; the total, which has any sign, is logarithmic beyond 1 J, and shares are linear."""
    points = [(at, spread) for at, cell in zip(x, cells, strict=True) if (spread := cell.quantities[quantity])]
    if not points:
        return
    means = [spread.mean for _, spread in points]
    deviations = [spread.deviation for _, spread in points]
    axis.errorbar([at for at, _ in points], means, deviations, label=model, color=colour, marker="o", capsize=2)
    if quantity == "total":
        axis.set_yscale("symlog", linthresh=1.0)
    elif quantity == "survived_percent":
        axis.set_ylim(0.0, 105.0)
    elif max(means) > 0.0:
        axis.set_yscale("log", nonpositive="mask")


def _plot(name: str, title: str, caption: str, figure: Figure, axes: Sequence[Any]) -> list[Block]:
    """The figure with a legend below all panels; nothing where nothing was drawn."""
    entries = {model: line for axis in axes for line, model in zip(*axis.get_legend_handles_labels(), strict=True)}
    if not entries:
        return []
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return [Plot(name, title, caption, figure)]
