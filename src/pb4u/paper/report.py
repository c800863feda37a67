"""The report of a run: results.json, plots, a page of tables that shows them, and the tables as CSV."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from pb4u import __version__
from pb4u.io.atomic_file import json_text
from pb4u.jobs.job_folder import FOLDER_VERSION, JobFolder
from pb4u.paper.evaluation_request import EvaluationRequest
from pb4u.paper.page import Block, Plot, Remark, as_csv, as_markdown
from pb4u.paper.paper_figures import PAPER
from pb4u.paper.paper_layout import loss_and_latency, terms_by_level, total_by_arm
from pb4u.paper.pictures import picture_grid
from pb4u.paper.plots import across_levels, against_steps, over_time
from pb4u.paper.protocol_plan import Plan
from pb4u.paper.robustness import failure_pictures, failure_table, parts_tables, robustness_table
from pb4u.paper.summary import Summary, summarise
from pb4u.paper.tables import controls_tables, level_table, terms_tables

RESULTS, TABLES, VALUES, PLOTS = "results.json", "tables.md", "tables.csv", "plots"

View = Callable[[Summary], list[Block]]
"""Draws tables or plots of a run; none where the run has nothing for them."""

_STRETCH_OVER_TIME = partial(over_time, term="stretch", preferred="07_02")

VIEWS: dict[str, tuple[View, ...]] = {
    "resolution": (terms_tables, across_levels, _STRETCH_OVER_TIME),
    "unseen": (terms_tables, _STRETCH_OVER_TIME),
    "depth": (against_steps, partial(level_table, quantities=("total",))),
    "efficiency": (
        partial(level_table, quantities=("total", "ms")),
        partial(across_levels, quantities=("ratio", "ms")),
    ),
    "ablation": (
        partial(level_table, quantities=("total",)),
        partial(across_levels, quantities=("stretch", "ratio", "survived_percent")),
    ),
    "controls": (controls_tables, terms_tables),
    "robustness": (robustness_table, parts_tables, failure_table, failure_pictures),
}
"""Protocol -> its tables and plots, in the order of the page; pictures follow where it has them."""

PAPERS_VIEWS: dict[str, tuple[View, ...]] = {
    "resolution": (terms_by_level, _STRETCH_OVER_TIME),
    "unseen": (terms_by_level,),
    "depth": (against_steps,),
    "efficiency": (loss_and_latency,),
    "ablation": (total_by_arm,),
}
"""The same as the paper lays it out, of what it has."""


def write_report(planned: Plan, folder: JobFolder, request: EvaluationRequest) -> dict[str, Any]:
    """Write results.json, the plots, a page with tables of the finished rollouts, and these tables as CSV.

    Args:
        planned: rollouts and cases of the run.
        folder: with the results, and for the report.
        request: options of the evaluation.

    Returns:
        The content of results.json.
    """
    summary = summarise(planned, folder)
    protocol = planned.protocol
    laid_out = VIEWS if request.layout == "project" else VIEWS | PAPERS_VIEWS
    views = (*laid_out[protocol.name], *([picture_grid] if protocol.pictured else []))
    blocks = [_about(summary), *(block for view in views for block in view(summary)), *_remarks(summary)]
    shutil.rmtree(folder.path / PLOTS, ignore_errors=True)
    (folder.path / PLOTS).mkdir()
    for block in blocks:
        if isinstance(block, Plot):
            folder.write(f"{PLOTS}/{block.name}.png", block.png)
    folder.write(TABLES, as_markdown(f"pb4u evaluation: {protocol.name}", blocks).encode())
    folder.write(VALUES, as_csv(blocks).encode())
    text = json_text(
        {
            "protocol": protocol.name,
            "protocol_version": FOLDER_VERSION,
            "pb4u": __version__,
            "reproduces": protocol.reproduces,
            "request": request.as_json(),
            "absent": planned.absent,
            "failures": [{"job": job, "sentence": sentence} for job, sentence in summary.failures],
            **summary.as_json(),
            "paper": PAPER.get(protocol.name, {}),
        },
        indent=1,
    )
    folder.write(RESULTS, (text + "\n").encode())
    return dict(json.loads(text))


def _about(summary: Summary) -> Block:
    protocol = summary.plan.protocol
    count = sum(row.result is not None for row in summary.rows)
    where = f"{', '.join(protocol.garments)} on {', '.join(protocol.motions)} ({', '.join(protocol.bodies)})"
    lines = [
        protocol.reproduces,
        f"{count} of {len(summary.rows)} rollouts are done: {where}, {protocol.frames} frames at levels "
        f"{', '.join(protocol.levels)}; what varies is {protocol.varied}.",
        *summary.plan.absent,
    ]
    return Remark("", lines)


def _remarks(summary: Summary) -> list[Block]:
    blocks: list[Block] = []
    if summary.failures:
        lines = [f"{job}: {sentence}" for job, sentence in summary.failures]
        blocks.append(Remark("Rollouts that could not be made", lines))
    results = [row.result for row in summary.rows if row.result]
    if notes := merge_similar(dict.fromkeys(note for result in results for note in result["notes"])):
        blocks.append(Remark("Notes", notes))
    machines = dict.fromkeys(
        ", ".join(f"{key} {value}" for key, value in result["machine"].items()) for result in results
    )
    if machines:
        lines = [
            f"pb4u {__version__}, protocols of version {FOLDER_VERSION}.",
            *machines,
            "Times are medians a step of a rollout, without metrics and files; workers beside it share the machine.",
        ]
        blocks.append(Remark("Made on", lines))
    return blocks


def merge_similar(notes: Iterable[str]) -> list[str]:
    """Notes shortened: notes that differ only in their numbers are replaced by the first one and the number of the
    others.

    Args:
        notes: notes of all rollouts.
    """
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(re.sub(r"\d+(?:\.\d+)?", "#", note), []).append(note)
    return [
        first + (f" ({len(others)} more with other numbers, in results.json.)" if others else "")
        for first, *others in alike.values()
    ]
