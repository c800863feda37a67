"""Report of a run whose scenes are drawn: how often something fails, how far from the floor, and each failure."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable

import numpy as np

from pb4u.errors import Pb4uError
from pb4u.measures.divergence import SLID, SLID_FRAMES
from pb4u.paper.page import Block, Plot, Remark, Table
from pb4u.paper.pictures import draw_still, sheet
from pb4u.paper.summary import FAR_FROM_FLOOR, MOST_INSIDE, Row, Summary, share_text

MOST_PICTURES = 24
"""Failures that are drawn; all are named."""

_COLUMNS = 6

_NOTE = (
    "Energy / reference: the mean energy without gravity over that of the solver on the same scene, under the same "
    f"contact, of rollouts that did not diverge. Slid: what holds the garment up was more than {100 * SLID:.0f} cm "
    f"from where skinning puts it for {SLID_FRAMES} frames on end. Failed: diverged, slid, more than "
    f"{MOST_INSIDE:.0f} % of the vertices inside the body over all frames, or more than {FAR_FROM_FLOOR:.0f} times "
    "the floor."
)


def robustness_table(summary: Summary) -> list[Block]:
    """Table with a row for each model and setting.

    Args:
        summary: the run.
    """
    head = [
        "model", "rollouts", "diverged", "slid", "failed", "energy / reference, median", "95 %", "worst",
        "inside, mean [%]", "worst [%]", "deepest [mm]", "crossings a frame, mean", "worst", "time a step [ms]",
    ]  # fmt: skip
    rows = []
    for model in summary.plan.protocol.models:
        cases = [row for row in summary.select(model=model) if row.result or row.failure]
        inside = _finite(row.value("penetration_percent") for row in cases)
        crossings = _finite(row.value("self_intersections") for row in cases)
        ratios = _ratios(cases)
        rows.append(
            [
                model,
                f"{len(cases)}",
                _share(cases, lambda row: row.diverged),
                _share(cases, lambda row: (row.result or {}).get("slid_at") is not None),
                _share(cases, lambda row: bool(row.faults)),
                _shown(ratios, statistics.median, ".2f"),
                _shown(ratios, lambda values: float(np.percentile(values, 95)), ".2f"),
                _shown(ratios, max, ".2f"),
                _shown(inside, statistics.fmean, ".2g"),
                _shown(inside, max, ".2g"),
                _shown([1e3 * row.deepest for row in cases if row.deepest is not None], max, ".1f"),
                _shown(crossings, statistics.fmean, ".1f"),
                _shown(crossings, max, ".0f"),
                _shown(_finite(row.value("ms") for row in cases), statistics.median, ".0f"),
            ]
        )
    return [Table("All scenes", _NOTE, head, rows)]


def parts_tables(summary: Summary) -> list[Block]:
    """Tables by garment, motion, material and level: median and worst energy over the reference, and failures.

    Args:
        summary: the run.
    """
    models = summary.plan.protocol.models
    parts: dict[str, Callable[[Row], str]] = {
        "garment": lambda row: str(row.coordinates["garment"]),
        "motion": lambda row: str(row.case.job.labels["motion"]),
        "material": lambda row: str(row.coordinates.get("material")),
        "level": lambda row: row.case.level,
    }
    tables: list[Block] = []
    for part, name_of in parts.items():
        groups: dict[str, list[Row]] = {}
        for row in summary.rows:
            groups.setdefault(name_of(row), []).append(row)
        if len(groups) < 2:
            continue
        rows = []
        for name, members in sorted(groups.items()):
            cells = []
            for model in models:
                runs = [row for row in members if row.model == model and (row.result or row.failure)]
                ratios, failed = _ratios(runs), sum(bool(row.faults) for row in runs)
                cells.append(
                    f"{_shown(ratios, statistics.median, '.2f')}, {_shown(ratios, max, '.2f')}; {failed} of {len(runs)}"
                )
            rows.append([name, *cells])
        caption = "Energy over the reference, median and worst; failed rollouts."
        tables.append(Table(f"By {part}", caption, [part, *models], rows))
    return tables


def failure_table(summary: Summary) -> list[Block]:
    """Every failure with the number of its scene, and the options that reproduce it.

    Args:
        summary: the run.
    """
    rows = [
        [str(row.case.number), row.model, _scene_words(row), "; ".join(row.faults)]
        for row in summary.rows
        if row.faults
    ]
    if not rows:
        return [Remark("Failures", ["None."])]
    caption = "The scene's options are those of `pb4u simulate`."
    return [Table("Failures", caption, ["scene", "model", "made by", "what"], rows, words=4)]


def failure_pictures(summary: Summary) -> list[Block]:
    """Pictures of the failures, each in the frame that shows it best.

    Args:
        summary: the run.
    """
    title = "Failures, each in its worst frame"
    failed = [row for row in summary.rows if row.faults and row.result]
    shown: list[tuple[np.ndarray | None, str]] = []
    try:
        for row in failed[:MOST_PICTURES]:
            picture = draw_still(summary.still(row.case.job), frame=-1)
            if picture is not None:
                shown.append((picture, f"{row.case.number}: {row.model}\n{row.faults[0]}"))
    except Pb4uError as error:
        return [Remark(title, (str(error),))]
    if not shown:
        return []
    more = f" {len(failed) - MOST_PICTURES} more are named above alone." if len(failed) > MOST_PICTURES else ""
    return [Plot("failures", title, f"Number of the scene, model, and what went wrong.{more}", sheet(shown, _COLUMNS))]


def _scene_words(row: Row) -> str:
    run, seed = row.case.job.run, row.case.seed
    (spec,) = run.garments
    seeded = "" if seed is None else f" --seed {seed}"
    shape = "".join(f" --body-shape {name}={value:g}" for name, value in run.body_shape.items())
    return (
        f"--garment {spec.garment} --triangles {spec.triangles} --material {spec.material} --body {run.body}{shape} "
        f"--motion {run.motion}{seeded} --frames {run.frames} --lead-in {run.led_frames}"
    )


def _ratios(rows: Iterable[Row]) -> list[float]:
    return _finite(row.ratio for row in rows if not row.diverged)


def _finite(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None and math.isfinite(value)]


def _shown(values: list[float], of: Callable[[list[float]], float], digits: str) -> str:
    return format(of(values), digits) if values else "-"


def _share(rows: list[Row], what: Callable[[Row], bool]) -> str:
    count = sum(what(row) for row in rows)
    return share_text(count, len(rows)) if rows else "-"
