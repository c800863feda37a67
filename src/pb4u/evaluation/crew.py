"""Who does the rollouts: processes of this machine, each with a pipe to the one who hands out the work."""

from __future__ import annotations

import multiprocessing
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait

from pb4u.errors import InputError
from pb4u.evaluation.rollout import Refused, Rolled, attempt
from pb4u.evaluation.rollout_job import RolloutJob

Attempt = Callable[[RolloutJob], Rolled | Refused]
"""Does a job; what went wrong with it is a value, not an exception."""


@dataclass(frozen=True)
class Died:
    """The worker of a job is gone; of the job itself nothing is known."""


@dataclass(frozen=True)
class Outcome:
    """How an attempt at a job ended."""

    job: RolloutJob
    ended: Rolled | Refused | Died


class Crew(ABC):
    """Takes jobs and brings outcomes, in any order.

    Attributes:
        seats: how many jobs it takes at once.
    """

    seats: int

    @abstractmethod
    def give(self, job: RolloutJob) -> None:
        """Start a job. Called with at most `seats` jobs under way."""

    @abstractmethod
    def collect(self) -> Outcome:
        """Wait for the next job to end."""

    @abstractmethod
    def close(self) -> None:
        """Dismiss the workers, whatever they are at."""


class LocalCrew(Crew):
    """Processes of this machine, one thread each.

    Args:
        workers: how many.
        attempt: what they do with a job; importable, and free of surprises: what it raises ends its worker.

    Raises InputError where that is not a positive number.
    """

    def __init__(self, workers: int, attempt: Attempt = attempt) -> None:
        if workers < 1:
            raise InputError(f"The number of workers must be 1 or more, not {workers}.")
        self.seats = workers
        self._attempt = attempt
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, tuple[_Worker, RolloutJob]] = {}

    def give(self, job: RolloutJob) -> None:
        # An idle worker may have died too: its pipe then breaks, and another takes its place.
        while True:
            worker = self._idle.pop() if self._idle else _Worker(self._attempt)
            try:
                worker.pipe.send(job)
            except OSError:
                worker.dismiss()
                continue
            self._busy[worker.pipe] = worker, job
            return

    def collect(self) -> Outcome:
        pipe = next(iter(wait(list(self._busy))))
        assert isinstance(pipe, Connection)
        worker, job = self._busy.pop(pipe)
        try:
            ended = pipe.recv()
        except (EOFError, OSError):
            worker.dismiss()
            return Outcome(job, Died())
        self._idle.append(worker)
        return Outcome(job, ended)

    def close(self) -> None:
        for worker in [*self._idle, *(worker for worker, _ in self._busy.values())]:
            worker.dismiss()
        self._idle.clear()
        self._busy.clear()


class _Worker:
    """A process that does one job after another."""

    def __init__(self, attempt: Attempt) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, attempt), daemon=True)
        self.process.start()
        theirs.close()

    def dismiss(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _work(pipe: Connection, attempt: Attempt) -> None:
    """The life of a worker."""
    # Set before torch is first imported here: as many workers as cores, each with threads of its own, crawl.
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        while True:
            pipe.send(attempt(pipe.recv()))
    except (EOFError, OSError, KeyboardInterrupt):
        return


def _end_with_parent() -> None:
    """A killed run leaves no worker behind that does what the next run does again."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
