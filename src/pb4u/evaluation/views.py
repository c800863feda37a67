"""How a run's tables and figures are drawn. A view is a record; what it draws depends on nothing but the summary."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pb4u.evaluation.page import Block, Plot, Table
from pb4u.evaluation.paper_figures import TERMS, paper_figures

if TYPE_CHECKING:
    from pb4u.evaluation.summary import Cell, Spread, Summary

PAPER_MARK = "paper, other data"

UNITS = {
    **dict.fromkeys(TERMS, "J"),
    "ratio": "",
    "survived_percent": "%",
    "strain_p95": "",
    "penetration_percent": "%",
    "ms": "ms",
}

NAMES = {
    "ratio": "energy / floor",
    "survived_percent": "frames before divergence",
    "strain_p95": "strain, 95th percentile",
    "penetration_percent": "penetration",
    "ms": "time a step",
    "total": "total loss",
}

_NOTE = (
    "Mean ± standard deviation over scenes. The six terms and their total are by the released convention; the total "
    "holds an arbitrary height and rewards sagging, so rank by energy / floor: the mean energy without gravity over "
    "what the solver reaches on the same scene (1 is the floor, - where it is absent or the run broke off)."
)


class View(ABC):
    """A part of the page."""

    @abstractmethod
    def draw(self, summary: Summary) -> list[Block]:
        """Its tables or plots; empty where the run has nothing for it."""


def number(quantity: str, value: float) -> str:
    """A value as tables print it."""
    if quantity in TERMS:
        return f"{value:.2e}"
    if quantity == "ms":
        return f"{value:.1f}"
    if quantity == "survived_percent":
        return f"{value:.0f}"
    return f"{value:.3g}"


def with_spread(quantity: str, cell: Spread | None) -> str:
    """Mean and spread as tables print them."""
    if cell is None:
        return "-"
    mean = number(quantity, cell.mean)
    return f"{mean} ± {number(quantity, cell.deviation)}" if cell.scenes > 1 else mean


def label(quantity: str) -> str:
    """A quantity with its unit."""
    unit = f" [{UNITS[quantity]}]" if UNITS.get(quantity) else ""
    return NAMES.get(quantity, quantity) + unit


def _counts(cell: Cell) -> tuple[str, str]:
    missing = f", {cell.scenes - cell.done} missing" if cell.done < cell.scenes else ""
    return f"{cell.diverged} of {cell.done}", f"{cell.done}{missing}"


@dataclass(frozen=True)
class TermsTable(View):
    """One table a level: the six terms and what they leave out, a column a model, the paper's columns beside them."""

    def draw(self, summary: Summary) -> list[Block]:
        levels = summary.plan.protocol.levels
        return [self._level(summary, level, _NOTE if level == levels[0] else "") for level in levels]

    def _level(self, summary: Summary, level: str, note: str) -> Table:
        cells = [summary.cell(level, model) for model in summary.plan.protocol.models]
        paper = paper_figures(summary.plan.protocol.name, level)
        quantities = (*TERMS, "ratio", "survived_percent", "strain_p95", "penetration_percent")
        rows = [
            [
                label(quantity),
                *(with_spread(quantity, cell.quantities[quantity]) for cell in cells),
                *(number(quantity, theirs[quantity]) if quantity in theirs else "" for theirs in paper.values()),
            ]
            for quantity in quantities
        ]
        blank = [""] * len(paper)
        deepest = ["-" if cell.deepest is None else f"{1e3 * cell.deepest:.1f}" for cell in cells]
        rows.append(["deepest penetration [mm]", *deepest, *blank])
        rows.append(["diverged", *(_counts(cell)[0] for cell in cells), *blank])
        rows.append(["scenes", *(_counts(cell)[1] for cell in cells), *blank])
        head = ["", *(cell.model for cell in cells), *(f"{name} ({PAPER_MARK})" for name in paper)]
        theirs = frozenset(range(1 + len(cells), len(head)))
        return Table(f"Level {level}", note, head, rows, their_columns=theirs)


@dataclass(frozen=True)
class LevelTable(View):
    """One table: a row a level and model, the paper's rows below its level's.

    Args:
        quantities: columns that the paper has too.
    """

    quantities: tuple[str, ...]

    def draw(self, summary: Summary) -> list[Block]:
        steps = any(cell.steps is not None for cell in summary.cells())
        rows: list[list[str]] = []
        theirs: list[int] = []
        shown = (*self.quantities, "ratio", "survived_percent", "penetration_percent")
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


@dataclass(frozen=True)
class AcrossLevels(View):
    """Quantities against the number of triangles, a line a model.

    Args:
        quantities: a panel each.
    """

    quantities: tuple[str, ...] = ("stretch", "bending", "collision", "inertia", "ratio", "survived_percent")

    def draw(self, summary: Summary) -> list[Block]:
        from pb4u.evaluation.plots import across_levels

        png = across_levels(summary, self.quantities)
        caption = "Mean over scenes against the garments' number of triangles; both axes are logarithmic."
        return [Plot("across_levels", "Across resolutions", caption, png)] if png else []


@dataclass(frozen=True)
class OverTime(View):
    """A term over the frames at the top level, a panel a garment and a line a model.

    Args:
        term: the energy.
        preferred: the motion to show where the run has it; its first otherwise.
    """

    term: str
    preferred: str

    def draw(self, summary: Summary) -> list[Block]:
        from pb4u.evaluation.plots import over_time

        motions = [row.case.motion for row in summary.rows]
        motion = self.preferred if self.preferred in motions else motions[0]
        level = summary.plan.protocol.levels[-1]
        png = over_time(summary, self.term, motion, level)
        caption = f"{self.term.capitalize()} energy of each frame on {motion} at level {level}, logarithmic."
        return [Plot(f"{self.term}_over_time", f"{self.term.capitalize()} over time", caption, png)] if png else []


@dataclass(frozen=True)
class AgainstSteps(View):
    """The loss against the number of propagation steps, a panel a level."""

    def draw(self, summary: Summary) -> list[Block]:
        from pb4u.evaluation.plots import against_steps

        png = against_steps(summary)
        caption = (
            "Upper: total loss by the released convention. Lower: mean energy without gravity over the floor. Dashed: "
            "models without propagation steps to set. Tick: the number of steps that the model's own rule takes."
        )
        return [Plot("against_steps", "Loss against propagation steps", caption, png)] if png else []


@dataclass(frozen=True)
class PictureGrid(View):
    """One moment of every model beside the physics reference, a row a garment, at the top level."""

    def draw(self, summary: Summary) -> list[Block]:
        from pb4u.evaluation.pictures import picture_grid

        return picture_grid(summary)
