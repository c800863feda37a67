"""The picture grid: one moment of every model beside the physics reference."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from pb4u.errors import InputError, Pb4uError
from pb4u.export.still_renderer import render
from pb4u.export.view import View
from pb4u.measures.run_job import RunJob
from pb4u.paper.page import Block, Plot, Remark, png
from pb4u.paper.protocol_plan import Case
from pb4u.paper.summary import Row, Summary
from pb4u.scene.trajectory import Trajectory

_VIEW = View(width=300, height=430)
_TITLE = "Picture grid"
_REFERENCE = "physics reference"


class _Cell(NamedTuple):
    """A picture (height, width, 3) uint8, or None, and what is wrong with the run, or nothing."""

    picture: np.ndarray | None
    state: str


_ABSENT = _Cell(None, "")


def picture_grid(summary: Summary) -> list[Block]:
    """Grid of pictures at the top level, on the first motion and body: a row a garment, a column a model or the solver.

    Args:
        summary: the run.
    """
    protocol = summary.plan.protocol
    jobs: dict[str, dict[str, tuple[RunJob, str]]] = {}
    for row in summary.rows:
        if protocol.pictures(row.case.level, row.case.motion, str(row.case.job.run.body)):
            shown = jobs.setdefault(row.coordinates["garment"], {})
            shown[row.model] = row.case.job, _state(row)
            reference = _reference(row.case, summary)
            if reference is not None:
                shown[_REFERENCE] = reference, ""
    models = [model for model in protocol.models if model != "solver"] + [_REFERENCE]
    if "solver" in protocol.models and not any(_REFERENCE in shown for shown in jobs.values()):
        models[-1] = "solver"
    try:
        grid = {
            garment: {
                model: _Cell(draw_still(summary.still(job)), state)
                for model, (job, state) in shown.items()
                if model in models
            }
            for garment, shown in jobs.items()
        }
    except Pb4uError as error:
        return [Remark(_TITLE, (str(error),))]
    if all(cell.picture is None for cells in grid.values() for cell in cells.values()):
        return []
    moment = f"The same moment of {protocol.motions[0]} at level {protocol.levels[-1]}."
    caption = f"{moment} Without contact response, skin shows between the vertices of coarse meshes."
    return [Plot("picture_grid", _TITLE, caption, _compose(grid, models))]


def _state(row: Row) -> str:
    if row.failure:
        return "failed"
    return "diverged" if row.diverged else ""


def _reference(case: Case, summary: Summary) -> RunJob | None:
    """The solver's rollout of the same scene, as a model of the run or as its floor."""
    if isinstance(case.floor, RunJob):
        return case.floor
    jobs = (job for job in summary.plan.jobs if job.run.model == "solver" and job.run.scene == case.job.run.scene)
    return next(jobs, None)


def draw_still(still: Path, frame: int = 0) -> np.ndarray | None:
    """Picture (height, width, 3) uint8 of a kept frame; None where it is not there or cannot be read.

    Args:
        still: file of the kept frames.
        frame: which of them: the first is one moment for all models, the last the worst of its rollout.
    """
    try:
        trajectory = Trajectory.open(still)
    except InputError:
        return None
    return next(iter(render(trajectory, [frame % trajectory.frame_count], _VIEW)))


def _compose(grid: dict[str, dict[str, _Cell]], models: list[str]) -> bytes:
    figure = Figure(figsize=(2.0 * len(models), 2.85 * len(grid) + 0.3), layout="constrained")
    panels = figure.subplots(len(grid), len(models), squeeze=False)
    for (garment, cells), row in zip(grid.items(), panels, strict=True):
        for model, axis in zip(models, row, strict=True):
            axis.set_xticks([])
            axis.set_yticks([])
            for spine in axis.spines.values():
                spine.set_visible(False)
            cell = cells.get(model, _ABSENT)
            if cell.picture is not None:
                axis.imshow(cell.picture)
            else:
                axis.text(0.5, 0.5, cell.state or "absent", ha="center", transform=axis.transAxes)
            if cell.state:
                axis.set_xlabel(cell.state, fontsize=8, color="#b00020")
        row[0].set_ylabel(garment, fontsize=9)
    for model, axis in zip(models, panels[0], strict=True):
        axis.set_title(model, fontsize=9)
    return png(figure, 150)
