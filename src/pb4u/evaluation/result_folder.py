"""The folder of an evaluation. Killed at any instant, it goes on where it was.

* manifest.json: what the run consists of
* jobs/KEY.json: the result of a rollout, named by the address of its work
* jobs/KEY.npz: one frame of it
* jobs/KEY.failed.json: why there is none
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

from filelock import FileLock, Timeout

from pb4u import __version__
from pb4u.atomic_file import json_text, replace_file
from pb4u.errors import InputError, Pb4uError
from pb4u.evaluation.rollout import PROTOCOL_VERSION, Failure, Rollout, RolloutJob
from pb4u.reading_limits import read_json

MANIFEST, JOBS, LOCK = "manifest.json", "jobs", ".lock"


class ResultFolder:
    """The files of one run; while open, it is this process's alone.

    Args:
        path: the folder, made where it is not there.
        protocol: name of the protocol that is run in it.

    Raises:
        InputError: it holds something else, another protocol or a run of another version, or is in use.
    """

    def __init__(self, path: Path, protocol: str) -> None:
        self.path = path
        self._jobs = path / JOBS
        try:
            foreign = path.exists() and (not path.is_dir() or _is_foreign(path))
            if foreign:
                raise InputError(f"{path} exists and is no folder of an evaluation; give another --out.")
            self._check_manifest(protocol)
            self._jobs.mkdir(parents=True, exist_ok=True)
            self._lock = FileLock(path / LOCK)
            self._lock.acquire(timeout=0)
        except Timeout as error:
            raise InputError(f"Another process is at work in {path}; wait for it, or give another --out.") from error
        except OSError as error:
            raise InputError(f"Cannot use the folder {path}: {error.strerror or error}.") from error
        for leftover in [*path.glob(f".{MANIFEST}.*"), *self._jobs.glob(".*")]:
            leftover.unlink(missing_ok=True)

    def _check_manifest(self, protocol: str) -> None:
        file = self.path / MANIFEST
        if not file.exists():
            return
        again = "give another --out."
        try:
            manifest = read_json(file)
            version, made_by, held = manifest["protocol_version"], manifest["pb4u"], manifest["protocol"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{file} is not the manifest of an evaluation; {again}") from error
        if version != PROTOCOL_VERSION or made_by != __version__:
            raise InputError(
                f"{self.path} holds a run by pb4u {made_by} with protocols of version {version}, and this is pb4u "
                f"{__version__} with version {PROTOCOL_VERSION}; results of two do not belong in one table: {again}"
            )
        if held != protocol:
            raise InputError(f"{self.path} holds a run of the protocol {held}, not {protocol}; {again}")

    def write_manifest(self, protocol: str, request: dict[str, Any], jobs: tuple[RolloutJob, ...]) -> None:
        """Record what the run consists of.

        Args:
            protocol: its name.
            request: what was asked for, as JSON.
            jobs: every rollout of it.
        """
        manifest = {
            "protocol_version": PROTOCOL_VERSION,
            "pb4u": __version__,
            "protocol": protocol,
            "request": request,
            "jobs": [{"key": job.key, **asdict(job)} for job in jobs],
        }
        self.write(MANIFEST, (json.dumps(manifest, indent=1, default=str) + "\n").encode())

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
            raise Pb4uError(
                f"Cannot write {self.path / name}: {error.strerror or error}; what is done is kept, and the same "
                "command goes on."
            ) from error

    def keep(self, job: RolloutJob, rollout: Rollout) -> None:
        """Keep a result; its picture's frame first, so that a result is whole once it is there.

        Args:
            job: the rollout asked for.
            rollout: the rollout made.

        Raises:
            Pb4uError: the disk refuses.
        """
        if rollout.still is not None:
            self.write(f"{JOBS}/{job.key}.npz", rollout.still)
        result = json.loads(json_text(rollout.result))
        envelope = {"key": job.key, "checksum": _checksum(result), "result": result}
        self.write(f"{JOBS}/{job.key}.json", (json.dumps(envelope) + "\n").encode())
        self._failed(job).unlink(missing_ok=True)

    def result(self, job: RolloutJob) -> dict[str, Any] | None:
        """The result of a job; None where there is none, or none that is whole."""
        try:
            envelope = read_json(self._jobs / f"{job.key}.json")
            result = envelope["result"]
            whole = envelope["key"] == job.key and envelope["checksum"] == _checksum(result)
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return result if whole else None

    def still(self, job: RolloutJob) -> Path:
        """Path of the frame kept for pictures; the file may be absent."""
        return self._jobs / f"{job.key}.npz"

    def note_failure(self, job: RolloutJob, failure: Failure) -> None:
        """Keep why a job has no result.

        Args:
            job: the rollout asked for.
            failure: why there is none.

        Raises:
            Pb4uError: the disk refuses.
        """
        record = {"key": job.key, "job": str(job), **asdict(failure)}
        self.write(f"{JOBS}/{job.key}.failed.json", (json.dumps(record, indent=1) + "\n").encode())

    def failure(self, job: RolloutJob) -> Failure | None:
        """Reason why a job has no result; None where it was not tried, or came off."""
        try:
            record = read_json(self._failed(job))
            return Failure(str(record["sentence"]), str(record["trace"]))
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def forget_failure(self, job: RolloutJob) -> None:
        """Let a job be tried again."""
        self._failed(job).unlink(missing_ok=True)

    def _failed(self, job: RolloutJob) -> Path:
        return self._jobs / f"{job.key}.failed.json"

    def __enter__(self) -> ResultFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()


def _is_foreign(path: Path) -> bool:
    """Neither empty nor an evaluation's; a run killed before its manifest was there leaves this much."""
    names = {entry.name for entry in path.iterdir()}
    return MANIFEST not in names and any(name not in (JOBS, LOCK) and not name.startswith(".") for name in names)


def _checksum(result: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
