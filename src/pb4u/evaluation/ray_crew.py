"""Many machines through Ray: the same jobs, handed to a cluster."""

from __future__ import annotations

import logging
import os
import socket
from typing import Any

from pb4u.errors import InputError, MissingExtraError
from pb4u.evaluation.crew import Attempt, Crew, Died, Outcome
from pb4u.evaluation.rollout import Refused, attempt
from pb4u.evaluation.rollout_job import RolloutJob

_PATIENCE = 5.0
"""Seconds in which a cluster has to answer."""


class RayCrew(Crew):
    """The workers of a Ray cluster, one core each, and one GPU each where the job computes on one.

    Results come back through Ray, so no folder has to be shared; files that the user named (weights, recordings) must
    be found under the same path on every machine.

    Args:
        address: of the cluster, "auto" for the one of this machine, or "local" to start one for this run.
        workers: cores of a cluster started here.
        attempt: what they do with a job; importable on every machine.

    Raises:
        MissingExtraError: Ray is not installed.
        InputError: there is no cluster at the address.
    """

    seats = 1000

    def __init__(self, address: str, workers: int = 1, attempt: Attempt = attempt) -> None:
        try:
            import ray
        except ImportError as error:
            raise MissingExtraError("ray", "Running on a cluster") from error
        self._ray = ray
        # Nothing is reported to anyone unless the user asks Ray to.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        own: dict[str, Any] = {}
        if address == "local":
            own = {"num_cpus": workers, "include_dashboard": False, "_node_ip_address": "127.0.0.1"}
        else:
            _check_reachable(address)
        try:
            ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False, **own)
        except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"There is no Ray cluster to reach at {address}: {reason}") from error
        # Ray's own second tries are off: the schedule counts them.
        self._attempt = ray.remote(num_cpus=1, max_retries=0)(attempt)
        self._under_way: dict[Any, RolloutJob] = {}

    def give(self, job: RolloutJob) -> None:
        gpus = 1 if job.settings.device == "cuda" else 0
        self._under_way[self._attempt.options(num_gpus=gpus).remote(job)] = job

    def collect(self) -> Outcome:
        ready, _ = self._ray.wait(list(self._under_way), num_returns=1)
        job = self._under_way.pop(ready[0])
        try:
            return Outcome(job, self._ray.get(ready[0]))
        except self._ray.exceptions.RayTaskError as error:
            reason = " ".join(str(error.cause or error).split())
            return Outcome(job, Refused(f"A worker of the cluster cannot do it: {reason}", str(error)))
        except self._ray.exceptions.RayError:
            return Outcome(job, Died())

    def close(self) -> None:
        self._under_way.clear()
        self._ray.shutdown()


def _check_reachable(address: str) -> None:
    """Ray itself takes minutes to find that nobody is there."""
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    if not colon:
        return
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(f"There is no Ray cluster to reach at {address}: {error}.") from error
