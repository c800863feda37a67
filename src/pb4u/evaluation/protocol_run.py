"""An evaluation from request to report: plan, work through what is missing, write the report."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from typing import Any

from pb4u.errors import Pb4uError
from pb4u.evaluation.planning import EvaluationRequest, Plan, plan
from pb4u.evaluation.report import write_report
from pb4u.evaluation.result_folder import ResultFolder
from pb4u.evaluation.rollout import Failure, RolloutJob
from pb4u.evaluation.worker_pool import WorkerPool
from pb4u.progress import Progress, unheard

MOST_TRIES = 3
"""Workers that may die over a job before it is given up: two may have fallen to what else the machine was doing."""


def evaluate(
    request: EvaluationRequest,
    out: Path,
    pool: Callable[[], WorkerPool],
    retry: bool = False,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str], AbstractContextManager[Progress]] = lambda label: nullcontext(unheard),
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
        folder.write_manifest(planned.protocol.name, request.as_json(), planned.jobs)
        missing = _missing(planned, folder, retry, say)
        try:
            if missing:
                label = f"{planned.protocol.name}: {len(missing)} rollouts"
                with closing(pool()) as workers, progress(label) as show:
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


def work_through(jobs: Iterable[RolloutJob], pool: WorkerPool, folder: ResultFolder, progress: Progress) -> None:
    """Make all rollouts. What ends is kept at once; a job whose worker died is given to another.

    Args:
        jobs: in the order to start them.
        pool: who does them.
        folder: where results and failures go.
        progress: called with (jobs ended, jobs in all).
    """
    waiting = deque(jobs)
    ended, total, under_way = 0, len(waiting), 0
    tries: Counter[str] = Counter()
    progress(ended, total)
    while waiting or under_way:
        while waiting and under_way < pool.size:
            job = waiting.popleft()
            tries[job.key] += 1
            pool.submit(job)
            under_way += 1
        job, outcome = pool.next_outcome()
        under_way -= 1
        if outcome is None and tries[job.key] < MOST_TRIES:
            waiting.appendleft(job)
            continue
        if outcome is None:
            sentence = f"Its worker died {MOST_TRIES} times, for want of memory perhaps; try fewer --workers."
            outcome = Failure(sentence, "")
        if isinstance(outcome, Failure):
            folder.note_failure(job, outcome)
        else:
            folder.keep(job, outcome)
        ended += 1
        progress(ended, total)
