"""The tables of a run's report, with the paper's own figures beside them."""

from __future__ import annotations

import math
import statistics
from typing import Any

from pb4u.paper.page import Block, Table
from pb4u.paper.paper_figures import paper_figures
from pb4u.paper.summary import Cell, Row, Spread, Summary, quantity_named, share_text

PAPER_MARK = "paper, other data"

_NOTE = (
    "Mean ± standard deviation over scenes. The six terms and their total are by the released convention; the total "
    "holds an arbitrary height and rewards sagging. Energy / reference is the mean energy without gravity over what "
    "the solver reaches on the same scene (- where it is absent or the run broke off); cloth that floats wins it: rank "
    "by excess height (--measure excess)."
)


def number(quantity: str, value: float) -> str:
    """A value as tables print it.

    Args:
        quantity: its name.
        value: in the unit of the quantity.
    """
    return f"{value:{quantity_named(quantity).digits}}"


def with_spread(quantity: str, cell: Spread | None) -> str:
    """Mean and spread as tables print them; a dash where there are none.

    Args:
        quantity: its name.
        cell: mean and spread, in the unit of the quantity, or None.
    """
    if cell is None:
        return "-"
    if math.isinf(cell.mean):
        return "infinite"
    mean = number(quantity, cell.mean)
    return f"{mean} ± {number(quantity, cell.deviation)}" if cell.scenes > 1 else mean


def label(quantity: str) -> str:
    """The title of a quantity with its unit.

    Args:
        quantity: name of the quantity.
    """
    title, unit, _ = quantity_named(quantity)
    return f"{title} [{unit}]" if unit else title


def _counts(cell: Cell) -> tuple[str, str]:
    missing = f", {cell.scenes - cell.done} missing" if cell.done < cell.scenes else ""
    return share_text(cell.diverged, cell.done), f"{cell.done}{missing}"


def caveats(quantity: str, rows: list[Row]) -> str:
    """What of some rollouts a quantity is infinite for, or leaves out, in brackets; "" where it is nothing.

    Args:
        quantity: its name.
        rows: the rollouts.
    """
    told = []
    if quantity == "excess_height":
        heights = [height for row in rows for height in row.heights]
        if bad := sum(map(math.isinf, heights)):
            told.append(f"{bad} of {len(heights)} steps not finite")
        if lost := sum(row.broke_off and not (row.result or {})["frames"] for row in rows):
            told.append(f"{lost} of {len(rows)} rollouts lost in the lead-in")
    elif quantity == "distance_to_reference" and (broke_off := sum(row.broke_off for row in rows)):
        told.append(f"{broke_off} of {len(rows)} broke off")
    return f" ({', '.join(told)})" if told else ""


def terms_tables(summary: Summary) -> list[Block]:
    """Tables, one a level: the energies and what they leave out, a column a model, the paper's columns beside them.

    Args:
        summary: the run.
    """
    protocol = summary.plan.protocol
    tables: list[Block] = []
    for level in protocol.levels:
        cells = [summary.cell(level, *column) for column in summary.columns.values()]
        paper = paper_figures(protocol.name, level)
        rows = [
            [
                label(quantity),
                *(
                    with_spread(quantity, cell.quantities[quantity])
                    + caveats(quantity, summary.select(level=level, model=cell.model, steps=cell.steps))
                    for cell in cells
                ),
                *(number(quantity, theirs[quantity]) if quantity in theirs else "" for theirs in paper.values()),
            ]
            for quantity in (
                *summary.energies,
                *(("excess_height", "distance_to_reference") if protocol.excess else ()),
                "ratio",
                "survived_percent",
                "strain_p95",
                "penetration_percent",
                "visible_skin_percent",
            )
        ]
        blank = [""] * len(paper)
        deepest = ["-" if cell.deepest is None else f"{1e3 * cell.deepest:.1f}" for cell in cells]
        rows.append(["deepest penetration [mm]", *deepest, *blank])
        rows.append(["diverged", *(_counts(cell)[0] for cell in cells), *blank])
        rows.append(["scenes", *(_counts(cell)[1] for cell in cells), *blank])
        head = ["", *summary.columns, *(f"{name} ({PAPER_MARK})" for name in paper)]
        theirs = frozenset(range(1 + len(cells), len(head)))
        tables.append(Table(f"Level {level}", "" if tables else _NOTE, head, rows, their_columns=theirs))
    return tables


def level_table(summary: Summary, quantities: tuple[str, ...]) -> list[Block]:
    """Table with a row for each level and model, the paper's rows below its level's.

    Args:
        summary: the run.
        quantities: columns that the paper has too.
    """
    steps = any(cell.steps is not None for cell in summary.cells())
    rows: list[list[str]] = []
    theirs: list[int] = []
    shown = (*quantities, "ratio", "survived_percent", "penetration_percent")
    for level in summary.plan.protocol.levels:
        for cell in (cell for cell in summary.cells() if cell.level == level):
            values = [with_spread(quantity, cell.quantities[quantity]) for quantity in shown]
            own = ["-" if cell.steps is None else str(cell.steps)] if steps else []
            rows.append([level, cell.model, *own, *values, *_counts(cell)])
        for model, figures in paper_figures(summary.plan.protocol.name, level).items():
            theirs.append(len(rows))
            values = [number(quantity, figures[quantity]) if quantity in figures else "" for quantity in shown]
            rows.append([level, f"{model} ({PAPER_MARK})", *([""] if steps else []), *values, "", ""])
    head = ["level", "model", *(["K"] if steps else []), *map(label, shown), "diverged", "scenes"]
    return [Table("By level", _NOTE, head, rows, their_rows=frozenset(theirs), words=2)]


_CONTROLS_NOTE = (
    "Excess height: energy that a step leaves above its minimum, as the height to which it would lift the garment, on "
    "states of the solver that all rows share; the median over states and scenes. The minimum is the lowest that the "
    "solver reaches from several starts; where a step lies below it, the count says so. Distance: of the whole rollout "
    "from the solver's, mean over vertices and frames; none of those that broke off. "
    "Diverged with a Wilson interval of 95 %."
)


def controls_tables(summary: Summary) -> list[Block]:
    """A row for each model over all scenes, and its excess heights by garment.

    Args:
        summary: the run.
    """
    garments = list(dict.fromkeys(row.case.garment for row in summary.rows))
    head = [
        "model", "scenes", "excess height [mm]", "distance from the solver's [mm]", "skin through cloth [%]",
        "crossings a frame", "energy / reference", "diverged", "time a step [ms]", "states below the reference",
    ]  # fmt: skip
    rows, parts = [], []
    for name, (model, steps) in summary.columns.items():
        done = [row for row in summary.select(model=model, steps=steps) if row.result]
        states = [1e3 * height for row in done for height in row.heights]
        below = sum(_excess(row).get("below_reference", 0) for row in done)
        rows.append(
            [
                name, f"{len(done)}", _median(states) + caveats("excess_height", done),
                _mean_of(done, "distance_to_reference") + caveats("distance_to_reference", done),
                *(_mean_of(done, quantity) for quantity in ("visible_skin_percent", "self_intersections")),
                _mean_of(done, "ratio"),
                share_text(sum(row.diverged for row in done), len(done)), _mean_of(done, "ms"),
                f"{below} of {len(states)}",
            ]
        )  # fmt: skip
        named = [[row for row in done if row.case.garment == garment] for garment in garments]
        parts.append([name, *(_median([1e3 * height for row in own for height in row.heights]) for own in named)])
    return [
        Table("All scenes", _CONTROLS_NOTE, head, rows),
        Table("By garment", "Excess height [mm], median over states.", ["model", *garments], parts),
    ]


def _excess(row: Row) -> dict[str, Any]:
    found: dict[str, Any] = (row.result or {}).get("metrics", {}).get("excess_height", {})
    return found


def _median(values: list[float]) -> str:
    if not values:
        return "-"
    middle = statistics.median(values)
    return "infinite" if math.isinf(middle) else f"{middle:.3g}"


def _mean_of(rows: list[Row], quantity: str) -> str:
    present = [value for row in rows if (value := row.value(quantity)) is not None and math.isfinite(value)]
    return number(quantity, statistics.fmean(present)) if present else "-"
