"""Hands the rollouts out and keeps what comes back."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable

from pb4u.evaluation.crew import Crew, Died
from pb4u.evaluation.result_folder import ResultFolder
from pb4u.evaluation.rollout import Refused
from pb4u.evaluation.rollout_job import RolloutJob

MOST_TRIES = 3
"""Workers that may die over a job before it is given up."""

Progress = Callable[[int, int], None]


def work_through(jobs: Iterable[RolloutJob], crew: Crew, folder: ResultFolder, progress: Progress) -> None:
    """Do all jobs. What ends is kept at once; a job whose worker died is given to another.

    Args:
        jobs: in the order to start them.
        crew: who does them.
        folder: where results and failures go.
        progress: called with (jobs ended, jobs in all).
    """
    waiting = deque(jobs)
    ended, total, under_way = 0, len(waiting), 0
    tries: Counter[str] = Counter()
    progress(ended, total)
    while waiting or under_way:
        while waiting and under_way < crew.seats:
            job = waiting.popleft()
            tries[job.key] += 1
            crew.give(job)
            under_way += 1
        outcome = crew.collect()
        under_way -= 1
        if isinstance(outcome.ended, Died):
            if tries[outcome.job.key] < MOST_TRIES:
                waiting.appendleft(outcome.job)
                continue
            sentence = f"Its worker died {MOST_TRIES} times, for want of memory perhaps; try fewer --workers."
            folder.note_failure(outcome.job, Refused(sentence, ""))
        elif isinstance(outcome.ended, Refused):
            folder.note_failure(outcome.job, outcome.ended)
        else:
            folder.keep(outcome.job, outcome.ended)
        ended += 1
        progress(ended, total)
