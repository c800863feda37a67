"""A folder of jobs and their results. Killed at any instant, the run in it goes on where it was.

* manifest.json: what the run consists of
* jobs/KEY.json: the result of a job, named by the address of its work
* jobs/KEY.failed.json: why there is none
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from filelock import FileLock, Timeout

from pb4u.errors import InputError, Pb4uError
from pb4u.io.atomic_file import json_text, replace_file
from pb4u.io.reading_limits import MOST_NUMBERS_TEXT, read_json
from pb4u.jobs.job import Failure, Job

MANIFEST, JOBS, LOCK = "manifest.json", "jobs", ".lock"
_Folder = TypeVar("_Folder", bound="JobFolder")


class JobFolder(ABC):
    """The files of one run; while open, it is this process's alone.

    Args:
        path: the folder, made where it is not there.
        kind: what such a folder is of, such as "an evaluation".

    Raises:
        InputError: it holds something else or another run, or is in use.
    """

    def __init__(self, path: Path, kind: str) -> None:
        self.path = path
        self._jobs = path / JOBS
        try:
            foreign = path.exists() and (not path.is_dir() or _is_foreign(path))
            if foreign:
                raise InputError(f"{path} exists and is no folder of {kind}; give another --out.")
            self._read_manifest(kind)
            self._jobs.mkdir(parents=True, exist_ok=True)
            self._lock = FileLock(path / LOCK)
            self._lock.acquire(timeout=0)
        except Timeout as error:
            raise InputError(f"Another process is at work in {path}; wait for it, or give another --out.") from error
        except OSError as error:
            raise InputError(f"Cannot use the folder {path}: {error.strerror or error}.") from error
        for leftover in [*path.glob(f".{MANIFEST}.*"), *self._jobs.glob(".*")]:
            leftover.unlink(missing_ok=True)

    @abstractmethod
    def require_same(self, manifest: dict[str, Any]) -> None:
        """Refuse the manifest of a run that this one does not go on with.

        Raises:
            InputError: it is one; in that case nothing of the folder was changed.
            KeyError: it lacks what every manifest of the kind has.
        """

    @abstractmethod
    def parts(self, job: Any, made: Any) -> tuple[Mapping[str, Any], Mapping[str, bytes]]:
        """What is kept of a job that was done: its result, and other files by path within the folder.

        Args:
            job: the job.
            made: what it made.
        """

    def take(self, job: Any, outcome: Any) -> None:
        """Keep what came of a job.

        Args:
            job: the job asked for.
            outcome: what it made, or the `Failure` that says why it made nothing.

        Raises:
            Pb4uError: the disk refuses.
        """
        if isinstance(outcome, Failure):
            self.note_failure(job, outcome)
        else:
            self.keep(job, *self.parts(job, outcome))

    def _read_manifest(self, kind: str) -> None:
        file = self.path / MANIFEST
        if not file.exists():
            return
        try:
            self.require_same(read_json(file))
        except InputError:
            raise
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{file} is not the manifest of {kind}; give another --out.") from error

    def write(self, name: str, content: bytes) -> None:
        """Write a file of the run, beside and moved into place.

        Args:
            name: path of the file within the folder.
            content: its bytes.

        Raises:
            Pb4uError: the disk refuses.
        """
        try:
            replace_file(self.path / name, content)
        except OSError as error:
            raise self.refused(name, error) from error

    def refused(self, name: str, error: OSError) -> Pb4uError:
        """What is said where the disk refuses a file of the run.

        Args:
            name: path of the file within the folder.
            error: why.
        """
        return Pb4uError(
            f"Cannot write {self.path / name}: {error.strerror or error}; what is done is kept, and the same "
            "command goes on."
        )

    def keep(self, job: Job, result: Mapping[str, Any], beside: Mapping[str, bytes]) -> None:
        """Keep a result, and before it the files that belong to it, so that a result is whole once it is there.

        Args:
            job: the job that was done.
            result: JSON but for numbers that are not finite.
            beside: content of the other files, by path within the folder.

        Raises:
            Pb4uError: the disk refuses.
        """
        for name, content in beside.items():
            self.write(name, content)
        kept = json.loads(json_text(dict(result)))
        envelope = {"key": job.key, "checksum": _checksum(kept), "result": kept}
        self.write(f"{JOBS}/{job.key}.json", (json.dumps(envelope) + "\n").encode())
        self._failed(job).unlink(missing_ok=True)

    def result(self, job: Job) -> dict[str, Any] | None:
        """The result of a job; None where there is none, or none that is whole."""
        try:
            # Series of numbers: a long clip has more of them than other texts may have.
            envelope = read_json(self._jobs / f"{job.key}.json", MOST_NUMBERS_TEXT)
            result = envelope["result"]
            whole = envelope["key"] == job.key and envelope["checksum"] == _checksum(result)
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return result if whole else None

    def note_failure(self, job: Job, failure: Failure) -> None:
        """Keep why a job has no result.

        Args:
            job: the job that was tried.
            failure: why it has none.

        Raises:
            Pb4uError: the disk refuses.
        """
        record = {"key": job.key, "job": str(job), **asdict(failure)}
        self.write(f"{JOBS}/{job.key}.failed.json", (json.dumps(record, indent=1) + "\n").encode())

    def failure(self, job: Job) -> Failure | None:
        """Reason why a job has no result; None where it was not tried, or came off."""
        try:
            record = read_json(self._failed(job))
            return Failure(str(record["sentence"]), str(record["trace"]))
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def forget_failure(self, job: Job) -> None:
        """Let a job be tried again."""
        self._failed(job).unlink(missing_ok=True)

    def _failed(self, job: Job) -> Path:
        return self._jobs / f"{job.key}.failed.json"

    def __enter__(self: _Folder) -> _Folder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()


def _is_foreign(path: Path) -> bool:
    """Neither empty nor a run's; a run killed before its manifest was there leaves this much."""
    names = {entry.name for entry in path.iterdir()}
    return MANIFEST not in names and any(name not in (JOBS, LOCK) and not name.startswith(".") for name in names)


def _checksum(result: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
