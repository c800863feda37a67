"""An evaluation from request to report: plan, work through what is missing, write the report."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from pb4u.jobs.job_folder import JobFolder, quiet
from pb4u.jobs.worker_pool import WorkerPool
from pb4u.paper.evaluation_request import EvaluationRequest
from pb4u.paper.protocol_plan import plan
from pb4u.paper.report import write_report
from pb4u.progress import Progress


def evaluate(
    request: EvaluationRequest,
    out: Path,
    pool: Callable[[], WorkerPool],
    retry: bool = False,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str], AbstractContextManager[Progress]] = quiet,
) -> dict[str, Any]:
    """Run a protocol into a folder, continuing where an earlier run stopped, and write its report.

    Args:
        request: options of the run.
        out: folder of the run, created if absent.
        pool: makes the workers; called only where rollouts are missing.
        retry: try failed rollouts again.
        say: called with sentences on the progress.
        progress: opens a display for a label; none by default.

    Returns:
        The content of results.json. `failures` in it lists the rollouts that failed.

    Raises:
        InputError: something is unknown or unusable; before any work.
        Pb4uError: the disk refuses, or it was interrupted.
    """
    planned = plan(request)
    for sentence in planned.absent:
        say(sentence)
    with JobFolder(out, "an evaluation", {"protocol": request.protocol}) as folder:
        folder.write_manifest(planned.jobs, request=request.as_json())
        missing = folder.still_to_do(planned.jobs, "rollouts", retry, say)
        folder.complete(planned.jobs, missing, "rollouts", pool, progress, title=f"{request.protocol}: ")
        return write_report(planned, folder, request)
