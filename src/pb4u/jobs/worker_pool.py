"""Workers that do the jobs: a pool of processes on this machine, or a Ray cluster."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from typing import Any, TypeAlias

from pb4u.errors import InputError, extra
from pb4u.jobs.job import Failure, Job

_ANSWER_TIME = 5.0
"""Seconds in which a cluster has to answer; Ray itself takes minutes to find that nobody is there."""

Made: TypeAlias = Any
"""What a job makes; it travels between processes."""

Attempt: TypeAlias = Callable[[Any], Made | Failure]
"""Does a job; what went wrong with it is a value, not an exception."""

Outcome: TypeAlias = tuple[Any, Made | Failure | None]
"""A job and how an attempt at it ended; None where its worker died, and nothing is known of the job."""


class WorkerPool(ABC):
    """Takes jobs and gives their outcomes, in any order.

    Attributes:
        size: number of jobs at a time.
    """

    size: int

    @abstractmethod
    def submit(self, job: Job) -> None:
        """Start a job. Called while fewer than `size` jobs are running.

        Args:
            job: the job.
        """

    @abstractmethod
    def next_outcome(self) -> Outcome:
        """Wait for the next job to end."""

    @abstractmethod
    def close(self) -> None:
        """End the workers, whatever they are doing."""


class LocalPool(WorkerPool):
    """Processes of this machine, one thread each.

    Args:
        workers: how many.
        attempt: importable function that does a job. An exception in it ends its worker.

    Raises:
        InputError: `workers` is not a positive number.
    """

    def __init__(self, workers: int, attempt: Attempt) -> None:
        if workers < 1:
            raise InputError(f"The number of workers must be 1 or more, not {workers}.")
        self.size = workers
        self._attempt = attempt
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, tuple[_Worker, Job]] = {}

    def submit(self, job: Job) -> None:
        # An idle worker may have died too: its pipe then breaks, and another takes its place.
        while True:
            worker = self._idle.pop() if self._idle else _Worker(self._attempt)
            try:
                worker.pipe.send(job)
            except OSError:
                worker.stop()
                continue
            self._busy[worker.pipe] = worker, job
            return

    def next_outcome(self) -> Outcome:
        pipe = next(iter(wait(list(self._busy))))
        assert isinstance(pipe, Connection)
        worker, job = self._busy.pop(pipe)
        try:
            ended = pipe.recv()
        except (EOFError, OSError):
            worker.stop()
            return job, None
        self._idle.append(worker)
        return job, ended

    def close(self) -> None:
        for worker in [*self._idle, *(worker for worker, _ in self._busy.values())]:
            worker.stop()
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

    def stop(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _work(pipe: Connection, attempt: Attempt) -> None:
    """Main loop of a worker process."""
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


class RayPool(WorkerPool):
    """The workers of a Ray cluster, one core each, and one GPU each where the job computes on one.

    Results come back through Ray, so no folder has to be shared; files that the user named (weights, recordings) must
    be found under the same path on every machine.

    Args:
        address: of the cluster, "auto" for the one of this machine, or "local" to start one for this run.
        attempt: function that does a job, importable on every machine.
        workers: cores of a cluster started here.

    Raises:
        MissingExtraError: Ray is not installed.
        InputError: there is no cluster at the address.
    """

    size = 1000  # Ray queues what its machines cannot start yet

    def __init__(self, address: str, attempt: Attempt, workers: int = 1) -> None:
        with extra("ray", "Running on a cluster"):
            import ray
        self._ray = ray
        # Nothing is reported to anyone unless the user asks Ray to.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        options: dict[str, Any] = {}
        if address == "local":
            options = {"num_cpus": workers, "include_dashboard": False, "_node_ip_address": "127.0.0.1"}
        else:
            _check_reachable(address)
        self._on_request_to_end = signal.getsignal(signal.SIGTERM)
        try:
            ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False, **options)
        except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"No Ray cluster can be reached at {address}: {reason}") from error
        self._answer_as_before()
        # Ray's own second tries are off: who hands out the jobs counts them.
        self._attempt = ray.remote(num_cpus=1, max_retries=0)(attempt)
        self._under_way: dict[Any, Job] = {}

    def submit(self, job: Job) -> None:
        gpus = 1 if job.device == "cuda" else 0
        self._under_way[self._attempt.options(num_gpus=gpus).remote(job)] = job

    def next_outcome(self) -> Outcome:
        ready, _ = self._ray.wait(list(self._under_way), num_returns=1)
        job = self._under_way.pop(ready[0])
        try:
            return job, self._ray.get(ready[0])
        except self._ray.exceptions.RayTaskError as error:
            reason = " ".join(str(error.cause or error).split())
            return job, Failure(f"A worker of the cluster cannot do it: {reason}", str(error))
        except self._ray.exceptions.RayError:
            return job, None

    def close(self) -> None:
        self._under_way.clear()
        self._ray.shutdown()
        self._answer_as_before()

    def _answer_as_before(self) -> None:
        """Let a request to end keep what is done: Ray sets a handler of its own, and at its end the system's."""
        if self._on_request_to_end is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, self._on_request_to_end)


def _check_reachable(address: str) -> None:
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    if not colon:
        return
    try:
        socket.create_connection((host, int(port)), timeout=_ANSWER_TIME).close()
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(f"No Ray cluster can be reached at {address}: {error}.") from error
