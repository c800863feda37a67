"""What the rollouts of a run come to: means and spreads over scenes, ratios to the floor, how many diverged."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

from pb4u.evaluation.floors import ratio
from pb4u.evaluation.paper_figures import TERMS
from pb4u.evaluation.planning import Case, Plan
from pb4u.evaluation.result_folder import Failure, ResultFolder
from pb4u.evaluation.rollout_job import RolloutJob


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation over so many scenes."""

    mean: float
    deviation: float
    scenes: int


def spread(values: Iterable[float | None]) -> Spread | None:
    """The spread of the values there are; None where there are none."""
    present = [value for value in values if value is not None]
    if not present:
        return None
    return Spread(statistics.fmean(present), statistics.pstdev(present), len(present))


@dataclass(frozen=True)
class Row:
    """A case and what came of it.

    Args:
        case: the rollout in its place.
        result: of the rollout; None where it is not done.
        failure: why there is none, where it was tried.
        ratio: mean energy without gravity over the floor's; None where either is absent or the run broke off.
        floor_source: "solver run", "stored" or "absent".
    """

    case: Case
    result: dict[str, Any] | None
    failure: Failure | None
    ratio: float | None
    floor_source: str

    @property
    def model(self) -> str:
        return self.case.job.model.label

    @property
    def diverged(self) -> bool:
        return bool(self.result and self.result["diverged"])

    @property
    def survived_percent(self) -> float | None:
        """Share of the frames asked for that came before the run diverged."""
        if self.result is None:
            return None
        diverged_at = self.result["diverged_at"]
        good = self.result["frames"] if diverged_at is None else diverged_at
        return 100.0 * float(good) / self.case.job.scene.frames

    def mean(self, metric: str) -> float | None:
        """Mean over the frames of a metric in SI units."""
        return self._mean("metrics", metric)

    def mean_paper(self, term: str) -> float | None:
        """Mean over the frames of an energy [J] by the released convention."""
        return self._mean("metrics_paper", term)

    def value(self, quantity: str) -> float | None:
        """A quantity by the name that tables use."""
        if quantity in TERMS:
            return self.mean_paper(quantity)
        if quantity == "ratio":
            return self.ratio
        if quantity == "survived_percent":
            return self.survived_percent
        if quantity == "ms":
            return float(self.result["ms_per_step"]) if self.result else None
        return self.mean(quantity)

    def series(self, term: str) -> list[float]:
        """Energy [J] of a term over the frames, by the released convention; not a number where it is none."""
        per_frame = (self.result or {}).get("metrics_paper", {}).get(term, {}).get("per_frame", [])
        return [math.nan if value is None else value for value in per_frame]

    def _mean(self, table: str, name: str) -> float | None:
        value = (self.result or {}).get(table, {}).get(name, {}).get("mean")
        return None if value is None else float(value)


@dataclass(frozen=True)
class Cell:
    """A cell of a table: the scenes of one model, level and number of steps.

    Args:
        level, model: names. steps: number of propagation steps asked for; None for the model's own.
        triangles: mean number of triangles of the garments there are.
        quantities: name -> spread over the scenes that are done.
        deepest: deepest penetration of all [m].
        scenes: scenes in all. done: with a result. failed: without, and why is known. diverged: of those done.
    """

    level: str
    model: str
    steps: int | None
    triangles: float | None
    quantities: dict[str, Spread | None]
    deepest: float | None
    scenes: int
    done: int
    failed: int
    diverged: int


QUANTITIES = (*TERMS, "ratio", "survived_percent", "strain_p95", "penetration_percent", "ms")


def cell_of(level: str, model: str, steps: int | None, rows: list[Row]) -> Cell:
    """Sum rows up."""
    done = [row for row in rows if row.result is not None]
    depths = [
        row.result["metrics"]["penetration_depth_max"]["max"]
        for row in done
        if row.result and "penetration_depth_max" in row.result["metrics"]
    ]
    triangles = spread(float(row.result["triangles"]) for row in done if row.result)
    return Cell(
        level,
        model,
        steps,
        triangles.mean if triangles else None,
        {quantity: spread(row.value(quantity) for row in rows) for quantity in QUANTITIES},
        max((depth for depth in depths if depth is not None), default=None),
        len(rows),
        len(done),
        sum(row.failure is not None for row in rows),
        sum(row.diverged for row in rows),
    )


@dataclass(frozen=True)
class Summary:
    """A run in figures.

    Args:
        plan: what the run consists of.
        rows: every case with what came of it.
        failures: rollouts that could not be made, those of floors among them.
        still: where the kept frame of a job is.
    """

    plan: Plan
    rows: tuple[Row, ...]
    failures: tuple[Failure, ...]
    still: Callable[[RolloutJob], Any] = field(repr=False)

    def select(self, **wanted: object) -> list[Row]:
        """Rows by level, model, garment, body, motion or steps."""
        return [row for row in self.rows if all(_coordinate(row, name) == value for name, value in wanted.items())]

    def cell(self, level: str, model: str, steps: int | None = None) -> Cell:
        """The cell of a model at a level."""
        return cell_of(level, model, steps, self.select(level=level, model=model, steps=steps))

    def cells(self) -> list[Cell]:
        """Every cell of the run."""
        at = dict.fromkeys((row.case.level, row.model, row.case.job.settings.propagation_steps) for row in self.rows)
        return [self.cell(*each) for each in at]

    def as_json(self) -> dict[str, Any]:
        """Rows and cells as JSON."""
        return {"cells": [asdict(cell) for cell in self.cells()], "rollouts": [_row_json(row) for row in self.rows]}


def summarise(plan: Plan, folder: ResultFolder) -> Summary:
    """Read the results of a run."""
    results = {job.key: folder.result(job) for job in plan.jobs}
    failures = {job.key: folder.failure(job) for job in plan.jobs if results[job.key] is None}
    rows = []
    for case in plan.cases:
        result = results[case.job.key]
        reached, source = _floor_energies(case, results)
        complete = result is not None and result["frames"] == case.job.scene.frames and result["failed_at"] is None
        above = ratio(_energies(result), reached) if result and complete and reached else None
        rows.append(Row(case, result, failures.get(case.job.key), _or_none(above), source))
    return Summary(plan, tuple(rows), tuple(each for each in failures.values() if each), folder.still)


def _floor_energies(case: Case, results: dict[str, dict[str, Any] | None]) -> tuple[dict[str, float] | None, str]:
    if isinstance(case.floor, dict):
        return case.floor, "stored"
    result = results.get(case.floor.key) if case.floor else None
    if result is None or result["diverged"]:
        return None, "absent"
    return _energies(result), "solver run"


def _energies(result: dict[str, Any]) -> dict[str, float]:
    means = {term: result["metrics"][term]["mean"] for term in TERMS}
    return {term: math.nan if mean is None else mean for term, mean in means.items()}


def _or_none(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _coordinate(row: Row, name: str) -> object:
    if name in ("level", "motion"):
        return getattr(row.case, name)
    if name == "model":
        return row.model
    if name == "steps":
        return row.case.job.settings.propagation_steps
    return row.case.job.scene.label(name)


def _row_json(row: Row) -> dict[str, Any]:
    scene = row.case.job.scene
    return {
        "key": row.case.job.key,
        "model": row.model,
        "level": row.case.level,
        "garment": scene.label("garment"),
        "body": scene.label("body"),
        "motion": row.case.motion,
        "seed": scene.seed,
        "steps": row.case.job.settings.propagation_steps,
        "failure": row.failure.sentence if row.failure else None,
        "ratio_to_floor": row.ratio,
        "floor": row.floor_source,
        "result": row.result,
    }
