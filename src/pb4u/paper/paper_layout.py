"""The tables of a run laid out as the paper's, the paper's own figures beside them; best and second are marked."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pb4u.paper.page import Block, Table
from pb4u.paper.paper_figures import TERMS, paper_figures
from pb4u.paper.summary import Summary
from pb4u.paper.tables import PAPER_MARK

_NOTE = (
    "As the paper has it: mean energies [J] by the released convention, without spreads. **Bold** is the lowest of the "
    "run's methods, and of the paper's, underlined the second. The total holds an arbitrary height and rewards cloth "
    "that sags; the tables of --layout project say what it hides."
)


def terms_by_level(summary: Summary) -> list[Block]:
    """The tables on unseen resolutions and garments: a section a level, seven rows each, a column a method.

    Args:
        summary: the run.
    """
    theirs = _their_models(summary)
    head = ["metric", *summary.columns, *(f"{model} ({PAPER_MARK})" for model in theirs)]
    rows = []
    for level in summary.plan.protocol.levels:
        rows.append([f"**{level}**", *[""] * (len(head) - 1)])
        for term in TERMS:
            ours, paper = _ours(summary, level, term), _theirs(summary, level, term, theirs)
            texts = [*_marked(ours), *_marked(paper)] if term == "total" else [*map(_text, (*ours, *paper))]
            rows.append([term.capitalize(), *texts])
        rows.append(["lost", *_lost(summary, level), *[""] * len(theirs)])
    return [Table("Physics losses", _NOTE, head, rows)]


def loss_and_latency(summary: Summary) -> list[Block]:
    """The table on efficiency: a row a level and method, its total and the time of a step.

    Args:
        summary: the run.
    """
    rows, theirs = [], _their_models(summary)
    for level in summary.plan.protocol.levels:
        names = [*summary.columns, *(f"{model} ({PAPER_MARK})" for model in theirs)]
        columns = [
            [*_marked(_ours(summary, level, quantity), form), *_marked(_theirs(summary, level, quantity, theirs), form)]
            for quantity, form in (("total", ".2E"), ("ms", ".1f"))
        ]
        lost = [*_lost(summary, level), *[""] * len(theirs)]
        rows += [[level, *row] for row in zip(names, *columns, lost, strict=True) if any(row[1:])]
    head = ["resolution", "model", "physics loss", "latency [ms]", "lost"]
    return [Table("Efficiency", _NOTE, head, rows, words=2)]


def total_by_arm(summary: Summary) -> list[Block]:
    """The ablation table: a row a network, its total at each level.

    Args:
        summary: the run.
    """
    levels, theirs = summary.plan.protocol.levels, _their_models(summary)
    ours = [_marked(_ours(summary, level, "total")) for level in levels]
    paper = [_marked(_theirs(summary, level, "total", theirs)) for level in levels]
    names = [*summary.columns, *(f"{model} ({PAPER_MARK})" for model in theirs)]
    cells = [[*one, *other] for one, other in zip(ours, paper, strict=True)]
    rows = [list(row) for row in zip(names, *cells, strict=True)]
    return [Table("Ablation", _NOTE, ["model", *levels], rows)]


def _their_models(summary: Summary) -> list[str]:
    protocol = summary.plan.protocol
    return list(dict.fromkeys(model for level in protocol.levels for model in paper_figures(protocol.name, level)))


def _ours(summary: Summary, level: str, quantity: str) -> list[float | None]:
    """Means of the run's columns at a level, of what is done."""
    cells = (summary.cell(level, *column).quantities[quantity] for column in summary.columns.values())
    return [None if cell is None else cell.mean for cell in cells]


def _theirs(summary: Summary, level: str, quantity: str, models: Sequence[str]) -> list[float | None]:
    figures = paper_figures(summary.plan.protocol.name, level)
    return [figures.get(model, {}).get(quantity) for model in models]


def _lost(summary: Summary, level: str) -> list[str]:
    """How many rollouts of each column diverged, of those that are done."""
    cells = [summary.cell(level, *column) for column in summary.columns.values()]
    return [f"{cell.diverged} of {cell.done}" for cell in cells]


def _text(value: float | None, form: str = ".2E") -> str:
    return "" if value is None else f"{value:{form}}" if math.isfinite(value) else "infinite"


def _marked(values: Sequence[float | None], form: str = ".2E") -> list[str]:
    """Texts of the values, the lowest in bold and the second underlined."""
    ranked = sorted({value for value in values if value is not None and math.isfinite(value)})
    marks = dict(zip(ranked, ("**{}**", "<u>{}</u>"), strict=False))
    return ["" if value is None else marks.get(value, "{}").format(_text(value, form)) for value in values]
