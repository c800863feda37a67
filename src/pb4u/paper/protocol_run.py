"""An evaluation from request to report: plan, work through what is missing, write the report."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from pb4u.jobs.job_queue import make_all, still_to_do
from pb4u.jobs.worker_pool import WorkerPool
from pb4u.paper.protocol_plan import EvaluationRequest, plan
from pb4u.paper.report import write_report
from pb4u.paper.result_folder import ResultFolder
from pb4u.progress import Progress, no_progress


def evaluate(
    request: EvaluationRequest,
    out: Path,
    pool: Callable[[], WorkerPool],
    retry: bool = False,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str], AbstractContextManager[Progress]] = lambda label: nullcontext(no_progress),
) -> dict[str, Any]:
    """Run a protocol into a folder, going on where an earlier run stopped, and write its report.

    Args:
        request: what to run.
        out: folder of the run, made where it is not there.
        pool: makes those who do the rollouts; called only where some are missing.
        retry: try those again that failed before.
        say: takes sentences on how it goes.
        progress: opens a display for a label; none by default.

    Returns:
        The content of results.json. `failures` in it lists the rollouts that could not be made.

    Raises:
        InputError: something is unknown or unusable; before any work.
        Pb4uError: the disk refuses, or it was interrupted.
    """
    planned = plan(request)
    for sentence in planned.absent:
        say(sentence)
    with ResultFolder(out, planned.protocol.name) as folder:
        folder.write_manifest(request.as_json(), planned.jobs)
        missing = still_to_do(planned.jobs, folder, "rollouts", retry, say)

        def stopped() -> str:
            done = sum(folder.result(job) is not None for job in planned.jobs)
            return f"Stopped with {done} of {len(planned.jobs)} rollouts done; the same command goes on."

        with (
            progress(f"{planned.protocol.name}: {len(missing)} rollouts")
            if missing
            else nullcontext(no_progress) as show
        ):
            make_all(missing, pool, folder.take, show, stopped)
        return write_report(planned, folder, request)
