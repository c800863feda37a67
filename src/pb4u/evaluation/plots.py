"""The plots, as PNG bytes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pb4u.evaluation.paper_figures import paper_figures
from pb4u.evaluation.views import PAPER_MARK, label

if TYPE_CHECKING:
    from pb4u.evaluation.summary import Summary

_COLOURS = ("#0b6cb8", "#d1495b", "#2a9d63", "#8a4fbf", "#d98c00", "#1aa6a6", "#a85632", "#6b7a00")
_REFERENCE = "#1c1c1e"
_EXPLODED = 50.0
"""Total loss [J] beyond which a panel turns logarithmic."""
_ENTRY_WIDTH, _ENTRY_HEIGHT = 2.6, 0.18
"""Inches that an entry of the legend takes."""


def _figure(columns: int, rows: int, width: float = 3.6, height: float = 2.9) -> tuple[Any, list[list[Any]]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # Narrow figures would push the legend below them out of the picture.
    figure = Figure(figsize=(max(width * columns, 8.0), height * rows + 0.3), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False)
    for axis in panels.ravel():
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(True, color="#e6e6ea", linewidth=0.7)
        axis.tick_params(which="both", labelsize=7)
    return figure, panels.tolist()


def _finish(figure: Any, panels: Sequence[Sequence[Any]]) -> bytes | None:
    """Legend below all panels; None where nothing was drawn."""
    entries: dict[str, Any] = {}
    for axis in (axis for row in panels for axis in row):
        for line, name in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, line)
    if not entries:
        return None
    # The run's own first.
    names = sorted(entries, key=lambda name: PAPER_MARK in name)
    columns = max(1, min(len(entries), int(figure.get_figwidth() / _ENTRY_WIDTH)))
    figure.set_figheight(figure.get_figheight() + _ENTRY_HEIGHT * -(-len(entries) // columns))
    figure.legend(
        [entries[name] for name in names],
        names,
        loc="outside lower center",
        ncols=columns,
        fontsize=8,
        frameon=False,
    )
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=130)
    return stream.getvalue()


def _style(model: str, models: Sequence[str]) -> dict[str, Any]:
    if model == "solver":
        return {"color": _REFERENCE, "linewidth": 1.8}
    others = [name for name in models if name != "solver"]
    return {"color": _COLOURS[others.index(model) % len(_COLOURS)], "linewidth": 1.4}


def across_levels(summary: Summary, quantities: Sequence[str]) -> bytes | None:
    """Panels of quantities against the number of triangles; the paper's lines dotted."""
    protocol = summary.plan.protocol
    drawn = {name for cell in summary.cells() for name, value in cell.quantities.items() if value is not None}
    quantities = [quantity for quantity in quantities if quantity in drawn]
    if len(protocol.levels) < 2 or not quantities:
        return None
    columns = min(3, len(quantities))
    figure, panels = _figure(columns, -(-len(quantities) // columns))
    axes = [axis for row in panels for axis in row]
    for axis in axes[len(quantities) :]:
        axis.set_visible(False)
    for axis, quantity in zip(axes, quantities, strict=False):
        means: list[float] = []
        for model in protocol.models:
            cells = [summary.cell(level, model) for level in protocol.levels]
            at = [(cell.triangles, cell.quantities[quantity]) for cell in cells]
            points = [(x, y.mean, y.deviation) for x, y in at if x is not None and y is not None]
            if points:
                x, mean, deviation = zip(*points, strict=True)
                means += mean
                axis.errorbar(
                    x, mean, deviation, marker="o", markersize=3.5, capsize=2, elinewidth=0.8, label=model,
                    **_style(model, protocol.models),
                )  # fmt: skip
        _paper_lines(axis, summary, quantity)
        axis.set_xscale("log")
        axis.set_xticks([_triangles(summary, level) for level in protocol.levels], protocol.levels, minor=False)
        axis.set_xticks([], minor=True)
        _scale(axis, quantity, means)
        axis.set_title(label(quantity), fontsize=9, loc="left")
        axis.set_xlabel("triangles", fontsize=8)
    return _finish(figure, panels)


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
    return float(summary.select(level=level)[0].case.job.scene.triangles)


def over_time(summary: Summary, term: str, motion: str, level: str) -> bytes | None:
    """A term over the frames, a panel a garment."""
    protocol = summary.plan.protocol
    rows = summary.select(level=level, motion=motion, body=summary.rows[0].case.job.scene.label("body"))
    garments = list(dict.fromkeys(row.case.job.scene.label("garment") for row in rows))
    columns = min(4, len(garments))
    figure, panels = _figure(columns, -(-len(garments) // columns))
    axes = [axis for row in panels for axis in row]
    for axis in axes[len(garments) :]:
        axis.set_visible(False)
    for axis, garment in zip(axes, garments, strict=False):
        for row in (row for row in rows if row.case.job.scene.label("garment") == garment):
            series = row.series(term)
            if series:
                axis.plot(range(len(series)), series, label=row.model, **_style(row.model, protocol.models))
                if row.result and row.result["failed_at"] is not None:
                    axis.plot(len(series) - 1, series[-1], "x", color=_style(row.model, protocol.models)["color"])
        axis.set_yscale("log", nonpositive="mask")
        axis.set_title(garment, fontsize=9, loc="left")
        axis.set_xlabel("frame", fontsize=8)
    axes[0].set_ylabel(f"{term} [J]", fontsize=8)
    return _finish(figure, panels)


def against_steps(summary: Summary) -> bytes | None:
    """Total and ratio to the floor against K, a column a level."""
    protocol = summary.plan.protocol
    figure, panels = _figure(len(protocol.levels), 2)
    asked = [steps for steps in protocol.steps if steps is not None]
    for column, level in enumerate(protocol.levels):
        for panel, quantity in ((panels[0][column], "total"), (panels[1][column], "ratio")):
            means: list[float] = []
            for model in protocol.models:
                style = _style(model, protocol.models)
                cells = [summary.cell(level, model, steps) for steps in asked]
                points = [
                    (cell.steps, found.mean, found.deviation)
                    for cell in cells
                    if (found := cell.quantities[quantity]) is not None
                ]
                if points:
                    x, mean, deviation = zip(*points, strict=True)
                    means += mean
                    panel.errorbar(
                        x, mean, deviation, marker="o", markersize=3.5, capsize=2, elinewidth=0.8, label=model, **style
                    )
                    for own in _own_steps(summary, level, model):
                        panel.axvline(own, ymax=0.06, **style)
                fixed = summary.cell(level, model).quantities[quantity]
                if fixed is not None:
                    means.append(fixed.mean)
                    panel.axhline(fixed.mean, linestyle="--", label=model, **style)
            _scale(panel, quantity, means)
            panel.set_title(f"{level}: {label(quantity)}", fontsize=9, loc="left")
            panel.set_xlabel("propagation steps K", fontsize=8)
    return _finish(figure, panels)


def _own_steps(summary: Summary, level: str, model: str) -> list[int]:
    """K that a model's own rule takes on the garments of a level."""
    own = {row.result["own_steps"] for row in summary.select(level=level, model=model) if row.result}
    return sorted(steps for steps in own if steps)
