"""Works through the jobs of a folder: those that are not done, each once, whatever becomes of the workers."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from typing import Any, TypeVar

from pb4u.errors import Pb4uError
from pb4u.jobs.job import Failure, Job
from pb4u.jobs.job_folder import JobFolder
from pb4u.jobs.worker_pool import WorkerPool
from pb4u.progress import Progress

MOST_TRIES = 3
"""Workers that may die over a job before it is given up: two may have fallen to what else the machine was doing."""

_Job = TypeVar("_Job", bound=Job)


def still_to_do(
    jobs: Sequence[_Job], folder: JobFolder, noun: str, retry: bool, say: Callable[[str], None]
) -> list[_Job]:
    """The jobs without a result, those left out that failed before.

    Args:
        jobs: every job of the run.
        folder: where results and failures are.
        noun: what the jobs are called, in the plural.
        retry: take those that failed before as well.
        say: takes a sentence on how many are done, failed and to do.
    """
    undone = [job for job in jobs if folder.result(job) is None]
    failed = [job for job in undone if folder.failure(job)]
    if retry:
        for job in failed:
            folder.forget_failure(job)
        failed = []
    left = {job.key for job in failed}
    missing = [job for job in undone if job.key not in left]
    done = len(jobs) - len(undone)
    parts = [f"{len(jobs)} {noun}", f"{done} done before" if done else "", f"{len(missing)} to do"]
    parts.append(f"{len(failed)} failed before and left (--retry tries them again)" if failed else "")
    say(", ".join(part for part in parts if part) + ".")
    return missing


def make_all(
    missing: Sequence[Job],
    pool: Callable[[], WorkerPool],
    keep: Callable[[Any, Any], None],
    progress: Progress,
    stopped: Callable[[], str],
) -> None:
    """Do jobs with workers of their own, which end with them.

    Args:
        missing: the jobs, in the order to start them.
        pool: makes those who do the jobs; called only where there are some.
        keep: takes each job with what came of it.
        progress: called with (jobs ended, jobs in all).
        stopped: gives the sentence on what is kept, where the user ends it.

    Raises:
        Pb4uError: the user ended it, or what came of a job cannot be kept.
    """
    if not missing:
        return
    try:
        with closing(pool()) as workers:
            work_through(missing, workers, keep, progress)
    except KeyboardInterrupt:
        raise Pb4uError(stopped()) from None


def work_through(jobs: Iterable[Job], pool: WorkerPool, keep: Callable[[Any, Any], None], progress: Progress) -> None:
    """Do all jobs. What ends is kept at once; a job whose worker died is given to another.

    Args:
        jobs: in the order to start them.
        pool: who does them.
        keep: takes each job with what came of it.
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
        keep(job, outcome)
        ended += 1
        progress(ended, total)
