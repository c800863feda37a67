"""An evaluation from request to report: plan, work through what is missing, sum up, write."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pb4u import __version__
from pb4u.errors import Pb4uError
from pb4u.evaluation.crew import Crew
from pb4u.evaluation.page import Block, Plot, Remark, as_html, as_markdown
from pb4u.evaluation.paper_figures import PAPER
from pb4u.evaluation.planning import Plan, Request, plan
from pb4u.evaluation.result_folder import ResultFolder
from pb4u.evaluation.rollout import finite
from pb4u.evaluation.rollout_job import PROTOCOL_VERSION, RolloutJob
from pb4u.evaluation.schedule import Progress, work_through
from pb4u.evaluation.summary import Summary, summarise

RESULTS, TABLES, PLOTS, PAGE = "results.json", "tables.md", "plots", "report.html"


def evaluate(
    request: Request,
    out: Path,
    crew: Callable[[], Crew],
    retry: bool = False,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str], AbstractContextManager[Progress]] | None = None,
) -> dict[str, Any]:
    """Run a protocol into a folder, going on where an earlier run stopped, and write its report.

    Args:
        request: what to run.
        out: folder of the run, made where it is not there.
        crew: makes those who do the rollouts; called only where some are missing.
        retry: try those again that failed before.
        say: takes sentences on how it goes.
        progress: opens a display for a label; none by default.

    Returns:
        The content of results.json. `failures` in it lists the rollouts that could not be made.

    Raises InputError for anything unknown or unusable, before any work, and Pb4uError where the disk refuses.
    """
    planned = plan(request)
    for sentence in planned.absent:
        say(sentence)
    with ResultFolder(out, planned.protocol.name) as folder:
        folder.write_manifest(planned.protocol.name, _request_json(request), planned.jobs)
        missing = _missing(planned, folder, retry, say)
        try:
            if missing:
                label = f"{planned.protocol.name}: {len(missing)} rollouts"
                with closing(crew()) as workers, _shown(progress, label) as show:
                    work_through(missing, workers, folder, show)
        except KeyboardInterrupt:
            done = sum(folder.result(job) is not None for job in planned.jobs)
            raise Pb4uError(
                f"Stopped with {done} of {len(planned.jobs)} rollouts done; the same command goes on."
            ) from None
        return write_report(planned, folder, request)


def _missing(planned: Plan, folder: ResultFolder, retry: bool, say: Callable[[str], None]) -> list[RolloutJob]:
    undone = [job for job in planned.jobs if folder.result(job) is None]
    failed = [job for job in undone if folder.failure(job)]
    if retry:
        for job in failed:
            folder.forget_failure(job)
        failed = []
    missing = [job for job in undone if job not in failed]
    done = len(planned.jobs) - len(undone)
    parts = [f"{len(planned.jobs)} rollouts", f"{done} done before" if done else "", f"{len(missing)} to do"]
    parts.append(f"{len(failed)} failed before and left (--retry tries them again)" if failed else "")
    say(", ".join(part for part in parts if part) + ".")
    return missing


def _shown(
    progress: Callable[[str], AbstractContextManager[Progress]] | None, label: str
) -> AbstractContextManager[Progress]:
    from contextlib import nullcontext

    return progress(label) if progress else nullcontext(lambda done, total: None)


def write_report(planned: Plan, folder: ResultFolder, request: Request) -> dict[str, Any]:
    """Write results.json, the tables, the plots and the page of what is done. Returns the first."""
    summary = summarise(planned, folder)
    protocol = planned.protocol
    blocks = [block for view in protocol.views for block in view.draw(summary)]
    title = f"pb4u evaluation: {protocol.name}"
    blocks = [_about(summary), *blocks, *_remarks(summary)]
    shutil.rmtree(folder.path / PLOTS, ignore_errors=True)
    (folder.path / PLOTS).mkdir()
    for block in blocks:
        if isinstance(block, Plot):
            folder.write(f"{PLOTS}/{block.name}.png", block.png)
    folder.write(TABLES, as_markdown(title, blocks).encode())
    folder.write(PAGE, as_html(title, blocks).encode())
    results = finite(
        {
            "protocol": protocol.name,
            "protocol_version": PROTOCOL_VERSION,
            "pb4u": __version__,
            "reproduces": protocol.reproduces,
            "request": _request_json(request),
            "absent": list(planned.absent),
            "failures": [asdict(failure) for failure in summary.failures],
            **summary.as_json(),
            "paper": PAPER.get(protocol.name, {}),
        }
    )
    folder.write(RESULTS, (json.dumps(results, indent=1) + "\n").encode())
    return dict(results)


def _request_json(request: Request) -> dict[str, Any]:
    fields = asdict(request)
    return fields | {"recordings": None if request.recordings is None else str(request.recordings)}


def _about(summary: Summary) -> Block:
    protocol = summary.plan.protocol
    done = sum(row.result is not None for row in summary.rows)
    where = f"{', '.join(protocol.garments)} on {', '.join(protocol.motions)} ({', '.join(protocol.bodies)})"
    lines = [
        protocol.reproduces,
        f"{done} of {len(summary.rows)} rollouts are done: {where}, {protocol.frames} frames at levels "
        f"{', '.join(protocol.levels)}; what varies is {protocol.varied}.",
        *summary.plan.absent,
    ]
    return Remark("", lines)


def _remarks(summary: Summary) -> list[Block]:
    blocks: list[Block] = []
    if summary.failures:
        lines = [f"{failure.job}: {failure.sentence}" for failure in summary.failures]
        blocks.append(Remark("Rollouts that could not be made", lines))
    results = [row.result for row in summary.rows if row.result]
    if notes := told_once(dict.fromkeys(note for result in results for note in result["notes"])):
        blocks.append(Remark("Notes", notes))
    machines = dict.fromkeys(
        ", ".join(f"{key} {value}" for key, value in result["machine"].items()) for result in results
    )
    if machines:
        lines = [
            f"pb4u {__version__}, protocols of version {PROTOCOL_VERSION}.",
            *machines,
            "Times are medians a step of a rollout, without metrics and files; workers beside it share the machine.",
        ]
        blocks.append(Remark("Made on", lines))
    return blocks


def told_once(notes: Iterable[str]) -> list[str]:
    """Notes that differ in their numbers alone as one: the first, and how many more there are."""
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(re.sub(r"\d+(?:\.\d+)?", "#", note), []).append(note)
    return [
        first + (f" ({len(others)} more with other numbers, in results.json.)" if others else "")
        for first, *others in alike.values()
    ]
