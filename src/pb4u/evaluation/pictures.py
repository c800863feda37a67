"""The picture grid: one moment of every model beside the physics reference."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from pb4u.errors import Pb4uError
from pb4u.evaluation.page import Block, Plot, Remark
from pb4u.evaluation.planning import Case
from pb4u.evaluation.rollout_job import RolloutJob

if TYPE_CHECKING:
    from pb4u.evaluation.summary import Row, Summary

_WIDTH, _HEIGHT = 300, 430
_TITLE = "Picture grid"
_REFERENCE = "physics reference"


def picture_grid(summary: Summary) -> list[Block]:
    """Rows are garments, columns models and the solver; at the top level, on the first motion and body."""
    protocol = summary.plan.protocol
    rows = [row for row in summary.rows if protocol.pictures(row.case.level, row.case.motion, row.case.job.scene.body)]
    grid: dict[str, dict[str, tuple[RolloutJob, str]]] = {}
    for row in rows:
        garment = row.case.job.scene.label("garment")
        grid.setdefault(garment, {})[row.model] = row.case.job, _state(row)
        reference = _reference(row.case, summary)
        if reference is not None:
            grid[garment][_REFERENCE] = reference, ""
    models = [model for model in protocol.models if model != "solver"] + [_REFERENCE]
    if "solver" in protocol.models and not any(_REFERENCE in shown for shown in grid.values()):
        models[-1] = "solver"
    try:
        pictures = {
            (garment, model): picture
            for garment, shown in grid.items()
            for model, (job, _) in shown.items()
            if model in models and (picture := _draw(summary.still(job))) is not None
        }
    except Pb4uError as error:
        return [Remark(_TITLE, (str(error),))]
    if not pictures:
        return []
    png = _compose(list(grid), models, pictures, {g: {m: s for m, (_, s) in row.items()} for g, row in grid.items()})
    moment = f"The same moment of {protocol.motions[0]} at level {protocol.levels[-1]}."
    caption = f"{moment} Without contact response, skin shows between the vertices of coarse meshes."
    return [Plot("picture_grid", _TITLE, caption, png)]


def _state(row: Row) -> str:
    if row.failure:
        return "failed"
    return "diverged" if row.diverged else ""


def _reference(case: Case, summary: Summary) -> RolloutJob | None:
    """The solver's rollout of the same scene, as a model of the run or as its floor."""
    if isinstance(case.floor, RolloutJob):
        return case.floor
    jobs = (job for job in summary.plan.jobs if job.model.name == "solver" and job.scene == case.job.scene)
    return next(jobs, None)


def _draw(still: Any) -> np.ndarray | None:
    """(height, width, 3) uint8; None where the frame is not there or cannot be read."""
    from pb4u.errors import InputError
    from pb4u.export.picture import View, render
    from pb4u.scene.trajectory import Trajectory

    try:
        trajectory = Trajectory.open(still)
    except InputError:
        return None
    return next(iter(render(trajectory, [0], View(width=_WIDTH, height=_HEIGHT))))


def _compose(
    garments: list[str],
    models: list[str],
    pictures: dict[tuple[str, str], np.ndarray],
    states: dict[str, dict[str, str]],
) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.0 * len(models), 2.85 * len(garments) + 0.3), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(garments), len(models), squeeze=False)
    for garment, row in zip(garments, panels, strict=True):
        for model, axis in zip(models, row, strict=True):
            axis.set_xticks([])
            axis.set_yticks([])
            for spine in axis.spines.values():
                spine.set_visible(False)
            picture = pictures.get((garment, model))
            if picture is not None:
                axis.imshow(picture)
            else:
                axis.text(0.5, 0.5, states[garment].get(model) or "absent", ha="center", transform=axis.transAxes)
            if states[garment].get(model):
                axis.set_xlabel(states[garment][model], fontsize=8, color="#b00020")
        row[0].set_ylabel(garment, fontsize=9)
    for model, axis in zip(models, panels[0], strict=True):
        axis.set_title(model, fontsize=9)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=150)
    return stream.getvalue()
