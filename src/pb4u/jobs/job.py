"""A piece of work with an address: the same for the same work, so that what is done is never done again."""

from __future__ import annotations

import hashlib
import json
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from pb4u.errors import InputError, sentence_on

Work = TypeVar("Work")


class Job(Protocol):
    """Work for one worker; `str(job)` identifies it in plain words."""

    @property
    def key(self) -> str:
        """Content hash that identifies the result, see `address`."""

    @property
    def device(self) -> str:
        """Where it computes: "cpu" or "cuda"."""


@dataclass(frozen=True)
class JobPack:
    """Jobs that one worker does together; an attempt at it gives a list of their outcomes.

    Args:
        jobs: for one device.
    """

    jobs: tuple[Any, ...]

    @property
    def key(self) -> str:
        """Addresses of their results."""
        return " ".join(job.key for job in self.jobs)

    @property
    def device(self) -> str:
        """Where they compute: "cpu" or "cuda"."""
        return str(self.jobs[0].device)


def jobs_of(job: Job) -> tuple[Any, ...]:
    """The jobs of a pack; of a single job that one."""
    return job.jobs if isinstance(job, JobPack) else (job,)


class Made(NamedTuple):
    """Result of a job.

    Args:
        result: JSON but for numbers that are not finite.
        trajectory: content of the trajectory file that belongs to it; None where there is none.
    """

    result: dict[str, Any]
    trajectory: bytes | None = None


@dataclass(frozen=True)
class Failure:
    """Why a job has no result.

    Args:
        sentence: why, in plain words.
        trace: where, for the maintainers.
    """

    sentence: str
    trace: str = ""


def attempted(run: Callable[[Work], Made], work: Work) -> Made | Failure:
    """Do a job; any error is returned as a `Failure` with a sentence.

    Args:
        run: function that does the job.
        work: the job.
    """
    try:
        return run(work)
    except Exception as error:
        unexpected = f"It ended with an unexpected error: {type(error).__name__}: {' '.join(str(error).split())}"
        return Failure(sentence_on(error) or unexpected, traceback.format_exc())


def address(identity: Mapping[str, Any]) -> str:
    """Address of the work that has this identity.

    Args:
        identity: everything that the result depends on, as JSON.
    """
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:24]


def digest(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder and their names, in hexadecimal.

    Args:
        path: a file or a folder.
    """
    hasher = hashlib.sha256()
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    for file in files:
        if file != path:
            hasher.update(file.relative_to(path).as_posix().encode())
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                hasher.update(block)
    return hasher.hexdigest()


def require_content(path: Path, expected: str) -> None:
    """Refuse a file that differs from the one that the job was planned with.

    Args:
        path: the file, or folder.
        expected: its digest then.

    Raises:
        InputError: it is absent, or its content has changed.
    """
    if not path.exists():
        raise InputError(f"The file {path} does not exist on the machine that needs it.")
    if digest(path) != expected:
        raise InputError(f"The file {path} changed after the run was planned; start the run again.")
