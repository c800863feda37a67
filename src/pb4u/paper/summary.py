"""Statistics of the rollouts of an evaluation: means and spreads over scenes, ratios to the reference, divergence."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from pb4u.jobs.job import Failure
from pb4u.jobs.job_folder import JobFolder
from pb4u.measures.run_job import RunJob
from pb4u.paper.paper_figures import TERMS
from pb4u.paper.protocol_plan import Case, Plan
from pb4u.paper.reference_energies import ratio

MOST_INSIDE = 1.0
"""Percent of the vertices inside the body, over all frames, beyond which a rollout counts as a failure."""

FAR_FROM_FLOOR = 3.0
"""Energy over the reference beyond which it does: cloth that is plainly stretched or crumpled."""


class Quantity(NamedTuple):
    """Notation of a quantity in tables.

    Args:
        title: its title.
        unit: its unit, or "".
        digits: format of its numbers, as after the colon of an f-string.
    """

    title: str
    unit: str
    digits: str


_BESIDE_ENERGIES = {
    "ratio": Quantity("energy / reference", "", ".3g"),
    "excess_height": Quantity("excess height", "mm", ".3g"),
    "distance_to_reference": Quantity("distance from the solver's", "mm", ".3g"),
    "survived_percent": Quantity("frames before divergence", "%", ".0f"),
    "strain_p95": Quantity("strain, 95th percentile", "", ".3g"),
    "penetration_percent": Quantity("penetration", "%", ".3g"),
    "visible_skin_percent": Quantity("skin through cloth", "%", ".3g"),
    "self_intersections": Quantity("crossings of cloth with cloth", "", ".3g"),
    "ms": Quantity("time a step", "ms", ".1f"),
}


def quantity_named(name: str) -> Quantity:
    """Notation of the quantity `name`; by default that of an energy of the potential.

    Args:
        name: of a quantity or an energy.
    """
    return _BESIDE_ENERGIES.get(name) or Quantity("total loss" if name == "total" else name, "J", ".2e")


def wilson(count: int, of: int) -> tuple[float, float]:
    """Interval of 95 % for a share, by Wilson (1927), of 0 to 1: it says something where nothing or everything failed.

    Args:
        count: how many.
        of: of how many, 1 or more.
    """
    z = 1.96
    middle, spread = count / of + z * z / (2 * of), z * math.sqrt(count * (of - count) / of + z * z / 4) / of
    return max(0.0, (middle - spread) / (1 + z * z / of)), min(1.0, (middle + spread) / (1 + z * z / of))


def share_text(count: int, of: int) -> str:
    """A count with the interval of its share, as tables print it.

    Args:
        count: how many.
        of: of how many.
    """
    if not of:
        return "0 of 0"
    low, high = (100.0 * end for end in wilson(count, of))
    return f"{count} of {of} ({low:.0f} to {high:.0f} %)"


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation over scenes, in the unit of the quantity.

    Args:
        mean: mean over the scenes.
        deviation: standard deviation of the population of scenes.
        scenes: number of scenes.
    """

    mean: float
    deviation: float
    scenes: int


def spread(values: Iterable[float | None]) -> Spread | None:
    """The spread of the values there are; None where there are none.

    Args:
        values: numbers, or None for a missing one.
    """
    present = [value for value in values if value is not None]
    if not present:
        return None
    deviation = statistics.pstdev(present) if all(map(math.isfinite, present)) else math.nan
    return Spread(statistics.fmean(present), deviation, len(present))


@dataclass(frozen=True)
class Row:
    """A case and its outcome.

    Args:
        case: the rollout and its position.
        result: of the rollout; None if it is not done.
        failure: why there is no result, if it was tried.
        ratio: mean energy without gravity over the reference's; None where either is absent or the run broke off.
        reference_source: "solver run", "stored" or "absent".
    """

    case: Case
    result: dict[str, Any] | None
    failure: Failure | None
    ratio: float | None
    reference_source: str

    @cached_property
    def coordinates(self) -> dict[str, Any]:
        """Coordinates of the case in the tables: model, level, garment, body, motion, seed and steps."""
        case, run = self.case, self.case.job.run
        return {
            "model": case.job.label,
            "level": case.level,
            "garment": case.garment,
            "body": case.job.labels["body"],
            "motion": case.motion,
            "seed": case.seed,
            "steps": run.propagation_steps,
            **({} if case.number is None else {"number": case.number, "material": run.garments[0].material}),
        }

    @property
    def model(self) -> str:
        return self.case.job.label

    @property
    def diverged(self) -> bool:
        return bool(self.result and self.result["diverged"])

    @property
    def broke_off(self) -> bool:
        """Whether the state stopped being finite, and the frames after it are missing."""
        return bool(self.result and self.result["failed_at"] is not None)

    @property
    def heights(self) -> list[float]:
        """Excess heights on the shared states [m]; infinite where a step was not finite, or none measured."""
        if self.result is None:
            return []
        heights = self.result["metrics"].get("excess_height", {}).get("per_frame", [])
        if not heights and self.case.job.excess and self.result["frames"] == 0:
            return [math.inf]
        return [math.inf if height is None else height for height in heights]

    @property
    def faults(self) -> list[str]:
        """Sentences on what went wrong; none for a rollout without faults, or not done yet."""
        if self.failure is not None:
            return [f"could not be made: {self.failure.sentence}"]
        if self.result is None:
            return []
        if self.diverged:
            return [f"diverged in frame {self.result['diverged_at']}"]
        faults = []
        if self.result.get("slid_at") is not None:
            shift = 100.0 * self.result["hold_shift"]["max"]
            faults.append(f"slid from frame {self.result['slid_at']}, {shift:.0f} cm")
        inside = self.value("penetration_percent")
        if inside is not None and inside > MOST_INSIDE:
            faults.append(f"{inside:.1f} % of vertices inside the body")
        if self.ratio is not None and self.ratio > FAR_FROM_FLOOR:
            faults.append(f"{self.ratio:.1f} times the reference energy")
        return faults

    @property
    def survived_percent(self) -> float | None:
        """Share of the frames of the scene before divergence; a recording may have fewer frames than requested."""
        if self.result is None:
            return None
        diverged_at = self.result["diverged_at"]
        if diverged_at is None:
            return 100.0
        return 100.0 * float(diverged_at) / (self.result.get("scene_frames") or self.case.job.run.frames or 1)

    @property
    def deepest(self) -> float | None:
        """Deepest penetration of all frames [m]."""
        return (self.result or {}).get("metrics", {}).get("penetration_depth_max", {}).get("max")

    def value(self, quantity: str) -> float | None:
        """A quantity by the name that tables use; energies [J] are means over frames by the released convention.

        An excess height with a step that is not finite is infinite; a rollout that broke off has no distance.

        Args:
            quantity: its name.
        """
        if quantity in ("ratio", "survived_percent"):
            value = getattr(self, quantity)
        elif self.result is None:
            return None
        elif quantity == "excess_height":
            value = 1e3 * statistics.fmean(self.heights) if self.heights else None
        elif quantity == "distance_to_reference" and self.broke_off:
            return None
        elif quantity == "ms":
            value = self.result["ms_per_step"]
        else:
            tables = self.result["metrics"] if quantity in _BESIDE_ENERGIES else self.result["metrics_paper"]
            value = tables.get(quantity, {}).get("mean")
            if value is not None and quantity_named(quantity).unit == "mm":
                value = 1e3 * value
        return None if value is None else float(value)

    def series(self, term: str) -> list[float]:
        """Energy [J] of a term over the frames, by the released convention; NaN if it is missing.

        Args:
            term: name of the energy.
        """
        per_frame = (self.result or {}).get("metrics_paper", {}).get(term, {}).get("per_frame", [])
        return [math.nan if value is None else value for value in per_frame]


@dataclass(frozen=True)
class Cell:
    """A cell of a table: the scenes of one model, level and number of steps.

    Args:
        level: its name.
        model: its name.
        steps: requested number of propagation steps; None for the model's own.
        triangles: mean number of triangles of the garments there are.
        quantities: name -> spread over the scenes that are done.
        deepest: deepest penetration of all [m].
        scenes: scenes in all.
        done: number of scenes with a result.
        failed: number of scenes without a result for a known reason.
        diverged: number of finished scenes that diverged.
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


@dataclass(frozen=True)
class Summary:
    """A run in figures.

    Args:
        plan: rollouts and cases of the run.
        rows: every case with its result or failure.
        failures: (job, sentence) of the failed rollouts, those of references included.
        still: path of the kept frame of a job.
    """

    plan: Plan
    rows: tuple[Row, ...]
    failures: tuple[tuple[str, str], ...]
    still: Callable[[RunJob], Path] = field(repr=False)

    @cached_property
    def energies(self) -> tuple[str, ...]:
        """The terms of the potential and their total: the paper's in its order, then further ones of the results."""
        names = dict.fromkeys(TERMS)
        names |= dict.fromkeys(name for row in self.rows if row.result for name in row.result["metrics_paper"])
        return (*(name for name in names if name != "total"), "total")

    @cached_property
    def columns(self) -> dict[str, tuple[str, int | None]]:
        """Name -> model, and the requested number of propagation steps, for each compared column, in the models'
        order."""
        columns = dict.fromkeys((row.model, row.coordinates["steps"]) for row in self.rows)
        ordered = sorted(columns, key=lambda column: self.plan.protocol.models.index(column[0]))
        return {model if steps is None else f"{model}, K {steps}": (model, steps) for model, steps in ordered}

    def select(self, **coordinates: object) -> list[Row]:
        """Rows whose coordinates have these values.

        Args:
            **coordinates: value by name of the coordinate: level, model, garment, body, motion, seed or steps.
        """
        return [row for row in self.rows if coordinates.items() <= row.coordinates.items()]

    def cell(self, level: str, model: str, steps: int | None = None) -> Cell:
        """The cell of a model at a level.

        Args:
            level: name of the resolution.
            model: name of the model.
            steps: requested number of propagation steps; None for the model's own.
        """
        rows = self.select(level=level, model=model, steps=steps)
        results = [row.result for row in rows if row.result is not None]
        triangles = spread(float(result["triangles"]) for result in results)
        return Cell(
            level,
            model,
            steps,
            triangles.mean if triangles else None,
            {name: spread(row.value(name) for row in rows) for name in (*self.energies, *_BESIDE_ENERGIES)},
            max((row.deepest for row in rows if row.deepest is not None), default=None),
            len(rows),
            len(results),
            sum(row.failure is not None for row in rows),
            sum(row.diverged for row in rows),
        )

    def cells(self) -> list[Cell]:
        """Cells of the run, all of them."""
        at = dict.fromkeys(tuple(row.coordinates[name] for name in ("level", "model", "steps")) for row in self.rows)
        return [self.cell(*place) for place in at]

    def as_json(self) -> dict[str, Any]:
        """Rows and cells as JSON."""
        return {"cells": [asdict(cell) for cell in self.cells()], "rollouts": [_row_json(row) for row in self.rows]}


def summarise(plan: Plan, folder: JobFolder) -> Summary:
    """Read the results of a run.

    Args:
        plan: rollouts and cases of the run.
        folder: folder with its results.
    """
    results = {job.key: folder.result(job) for job in plan.jobs}
    failures = {job.key: folder.failure(job) for job in plan.jobs if results[job.key] is None}
    rows = []
    for case in plan.cases:
        result = results[case.job.key]
        reached, source = _reference_energies(case, results)
        complete = result is not None and result["failed_at"] is None
        above = ratio(_energies(result), reached) if result and complete and reached else None
        finite = above is not None and math.isfinite(above)
        rows.append(Row(case, result, failures.get(case.job.key), above if finite else None, source))
    sentences = tuple((str(job), failure.sentence) for job in plan.jobs if (failure := failures.get(job.key)))
    return Summary(plan, tuple(rows), sentences, folder.trajectory)


def _reference_energies(case: Case, results: dict[str, dict[str, Any] | None]) -> tuple[dict[str, float] | None, str]:
    if isinstance(case.floor, dict):
        return case.floor, "stored"
    result = results.get(case.floor.key) if case.floor else None
    if result is None or result["diverged"]:
        return None, "absent"
    return _energies(result), "solver run"


def _energies(result: dict[str, Any]) -> dict[str, float]:
    means = {term: result["metrics"][term]["mean"] for term in result["metrics_paper"]}
    return {term: math.nan if mean is None else mean for term, mean in means.items()}


def _row_json(row: Row) -> dict[str, Any]:
    return {
        "key": row.case.job.key,
        **row.coordinates,
        "failure": row.failure.sentence if row.failure else None,
        "ratio_to_floor": row.ratio,
        "floor": row.reference_source,
        "result": row.result,
    }
