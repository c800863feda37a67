"""Pictures of kept frames: one moment of every model beside the physics reference, and sheets of any others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap

import numpy as np
from matplotlib.figure import Figure

from pb4u.errors import InputError, Pb4uError
from pb4u.export.still_renderer import render
from pb4u.export.view import View
from pb4u.measures.run_job import RunJob
from pb4u.paper.page import Block, Plot, Remark
from pb4u.paper.protocol_plan import Case
from pb4u.paper.summary import Row, Summary
from pb4u.scene.trajectory import Trajectory

_VIEW = View(width=300, height=430)
_TITLE_WIDTH = 30
"""Letters in a line of a picture's title, beyond which it would reach into the next picture's."""

_TITLE = "Picture grid"
_REFERENCE = "physics reference"


def picture_grid(summary: Summary) -> list[Block]:
    """Grid of pictures at the top level, on the first motion and body: a row a garment, a column a model or the solver.

    Args:
        summary: the run.
    """
    protocol = summary.plan.protocol
    shown: dict[tuple[str, str], tuple[RunJob, str]] = {}
    for row in summary.rows:
        if protocol.pictures(row.case.level, row.case.motion, str(row.case.job.run.body)):
            shown[row.case.garment, row.model] = row.case.job, _state(row)
            if (reference := _reference(row.case, summary)) is not None:
                shown[row.case.garment, _REFERENCE] = reference, ""
    models = [*(model for model in protocol.models if model != "solver"), _REFERENCE]
    panels: list[tuple[np.ndarray | None, str]] = []
    try:
        for garment in dict.fromkeys(garment for garment, _ in shown):
            for model in models:
                job, state = shown.get((garment, model), (None, ""))
                picture = None if job is None else draw_still(summary.still(job))
                state = state or ("absent" if picture is None else "")
                panels.append((picture, f"{garment}: {model}" + (f"\n{state}" if state else "")))
    except Pb4uError as error:
        return [Remark(_TITLE, (str(error),))]
    if all(picture is None for picture, _ in panels):
        return []
    moment = f"The same moment of {protocol.motions[0]} at level {protocol.levels[-1]}."
    caption = f"{moment} Without contact response, skin shows between the vertices of coarse meshes."
    return [Plot("picture_grid", _TITLE, caption, sheet(panels, len(models)))]


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
    """Picture (height, width, 3) uint8 of a kept frame; None if it does not exist or cannot be read.

    Args:
        still: file with the kept frames.
        frame: index among them: the first is the same moment for all models, the last the worst of its rollout.
    """
    try:
        trajectory = Trajectory.open(still)
    except InputError:
        return None
    return next(iter(render(trajectory, [frame % trajectory.frame_count], _VIEW)))


def sheet(panels: Sequence[tuple[np.ndarray | None, str]], columns: int) -> Figure:
    """Pictures side by side, each under its title.

    Args:
        panels: (height, width, 3) uint8, or None for an empty place, and the title; row by row.
        columns: pictures in a row.
    """
    rows = math.ceil(len(panels) / columns)
    titles = ["\n".join(line for part in title.split("\n") for line in wrap(part, _TITLE_WIDTH)) for _, title in panels]
    lines = max((title.count("\n") + 1 for title in titles), default=1)
    figure = Figure(figsize=(2.1 * columns, (3.2 + 0.14 * lines) * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes:
        axis.set_axis_off()
    for axis, (picture, _), title in zip(axes, panels, titles, strict=False):
        axis.set_title(title, fontsize=7)
        if picture is not None:
            axis.imshow(picture)
    return figure
