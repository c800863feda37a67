"""The tables of a run's report, with the paper's own figures beside them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import Any

from pb4u.paper.page import Block, Table
from pb4u.paper.paper_figures import paper_figures
from pb4u.paper.summary import Row, Spread, Summary, quantity_named, share_text

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


def caveats(quantity: str, rows: list[Row]) -> str:
    """Note, in brackets, on rollouts for which a quantity is infinite or missing; "" without any.

    Args:
        quantity: its name.
        rows: the rollouts.
    """
    remarks = []
    if quantity == "excess_height":
        heights = [height for row in rows for height in row.heights]
        if bad := sum(map(math.isinf, heights)):
            remarks.append(f"{bad} of {len(heights)} steps not finite")
        if lost := sum(row.broke_off and not (row.result or {})["frames"] for row in rows):
            remarks.append(f"{lost} of {len(rows)} rollouts lost in the lead-in")
    elif quantity == "distance_to_reference" and (broke_off := sum(row.broke_off for row in rows)):
        remarks.append(f"{broke_off} of {len(rows)} broke off")
    return f" ({', '.join(remarks)})" if remarks else ""


_BESIDE = ("ratio", "survived_percent", "strain_p95", "penetration_percent", "visible_skin_percent")
_COUNTS = ("diverged", "scenes")


def _columns(summary: Summary, level: str, quantities: Sequence[str]) -> dict[str, list[str]]:
    """Texts of the quantities and counts of each model at a level, the paper's models after the run's own."""
    columns = {}
    for name, (model, steps) in summary.columns.items():
        cell, rows = summary.cell(level, model, steps), summary.select(level=level, model=model, steps=steps)
        values = [with_spread(name, cell.quantities[name]) + caveats(name, rows) for name in quantities]
        missing = f", {cell.scenes - cell.done} missing" if cell.done < cell.scenes else ""
        columns[name] = [*values, share_text(cell.diverged, cell.done), f"{cell.done}{missing}"]
    for model, theirs in paper_figures(summary.plan.protocol.name, level).items():
        values = [number(name, theirs[name]) if name in theirs else "" for name in quantities]
        columns[f"{model} ({PAPER_MARK})"] = [*values, *[""] * len(_COUNTS)]
    return columns


def terms_tables(summary: Summary) -> list[Block]:
    """Tables, one for each level: the energies and further measures, a column for each model, beside the paper's
    columns.

    Args:
        summary: the run.
    """
    protocol = summary.plan.protocol
    ranked = ("excess_height", "distance_to_reference") if protocol.excess else ()
    shown = (*summary.energies, *ranked, *_BESIDE)
    tables: list[Block] = []
    for level in protocol.levels:
        columns = _columns(summary, level, shown)
        deepest = [summary.cell(level, *column).deepest for column in summary.columns.values()]
        depths = ["-" if depth is None else f"{1e3 * depth:.1f}" for depth in deepest]
        rows = [list(row) for row in zip([*map(label, shown), *_COUNTS], *columns.values(), strict=True)]
        blank = [""] * (len(columns) - len(depths))
        rows.insert(len(shown), ["deepest penetration [mm]", *depths, *blank])
        tables.append(Table(f"Level {level}", "" if tables else _NOTE, ["", *columns], rows))
    return tables


def level_table(summary: Summary, quantities: tuple[str, ...]) -> list[Block]:
    """Table with a row for each level and model, the paper's rows below its level's.

    Args:
        summary: the run.
        quantities: columns that the paper has too.
    """
    shown = (*quantities, "ratio", "survived_percent", "penetration_percent")
    rows = [
        [level, name, *texts]
        for level in summary.plan.protocol.levels
        for name, texts in _columns(summary, level, shown).items()
    ]
    return [Table("By level", _NOTE, ["level", "model", *map(label, shown), *_COUNTS], rows, words=2)]


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
        cases = [row for row in summary.select(model=model, steps=steps) if row.result]
        states = [1e3 * height for row in cases for height in row.heights]
        below = sum(_excess(row).get("below_reference", 0) for row in cases)
        rows.append(
            [
                name, f"{len(cases)}", _median(states) + caveats("excess_height", cases),
                _mean_of(cases, "distance_to_reference") + caveats("distance_to_reference", cases),
                *(_mean_of(cases, quantity) for quantity in ("visible_skin_percent", "self_intersections")),
                _mean_of(cases, "ratio"),
                share_text(sum(row.diverged for row in cases), len(cases)), _mean_of(cases, "ms"),
                f"{below} of {len(states)}",
            ]
        )  # fmt: skip
        groups = [[row for row in cases if row.case.garment == garment] for garment in garments]
        parts.append([name, *(_median([1e3 * height for row in group for height in row.heights]) for group in groups)])
    return [
        Table("All scenes", _CONTROLS_NOTE, head, rows),
        Table("By garment", "Excess height [mm], median over states.", ["model", *garments], parts),
    ]


def _excess(row: Row) -> dict[str, Any]:
    return (row.result or {}).get("metrics", {}).get("excess_height", {})


def _median(values: list[float]) -> str:
    if not values:
        return "-"
    middle = statistics.median(values)
    return "infinite" if math.isinf(middle) else f"{middle:.3g}"


def _mean_of(rows: list[Row], quantity: str) -> str:
    present = [value for row in rows if (value := row.value(quantity)) is not None and math.isfinite(value)]
    return number(quantity, statistics.fmean(present)) if present else "-"
