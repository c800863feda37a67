"""A folder of jobs and their results. A run that was killed at any instant goes on where it stopped.

* manifest.json: what the run consists of
* jobs/KEY.json: the result of a job, named by the address of its work
* jobs/KEY.npz: the trajectory that belongs to it
* jobs/KEY.failed.json: why there is no result
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from pb4u import __version__
from pb4u.errors import InputError, Pb4uError, on_disk
from pb4u.io.atomic_file import LOCK, json_text, locked, replace_file
from pb4u.io.reading_limits import read_json
from pb4u.jobs.job import Failure, Job, JobPack, Made, jobs_of
from pb4u.jobs.worker_pool import WorkerPool
from pb4u.progress import Progress, no_progress

MANIFEST, JOBS = "manifest.json", "jobs"

FOLDER_VERSION = 3
"""Raised when a job or its measuring comes to mean something else, so that no older result is taken for it.

Evaluations were at 2 and datasets at 1, each by an entry of its own, when they became one."""

MOST_TRIES = 3
"""Workers that may die over a job before it is given up: two may have fallen to what else the machine was doing."""

_Folder = TypeVar("_Folder", bound="JobFolder")


class JobFolder:
    """The files of one run; while open, no other process may use the folder.

    Args:
        path: the folder, created if absent.
        kind: purpose of such a folder, such as "an evaluation".
        settings: values that a continued run must share, by the name of their flag.

    Raises:
        InputError: it holds something else, a run of other settings or of another version, or is in use.
    """

    arrays = JOBS
    """Folder of the trajectories."""

    def __init__(self, path: Path, kind: str, settings: Mapping[str, str]) -> None:
        self.path, self._kind, self._settings = path, kind, dict(settings)
        self._jobs = path / JOBS
        with on_disk(f"Cannot use the folder {path}"):
            foreign = path.exists() and (not path.is_dir() or _is_foreign(path))
            if foreign:
                raise InputError(f"{path} exists and is not a folder of {kind}; give another --out.")
            self._require_same()
            self._jobs.mkdir(parents=True, exist_ok=True)
            self._lock = locked(path, f"Another process is at work in {path}; wait for it, or give another --out.").lock
        for leftover in [*path.glob(f".{MANIFEST}.*"), *self._jobs.glob(".*")]:
            leftover.unlink(missing_ok=True)

    def _require_same(self) -> None:
        """Refuse the manifest of a run that this one does not go on with; nothing of the folder was changed then."""
        file = self.path / MANIFEST
        if not file.exists():
            return
        try:
            meta = read_json(file)
            versions = [meta.get(name) for name in ("version", "protocol_version", "dataset_version")]
            version, made_by = next(version for version in versions if version is not None), meta["pb4u"]
            if (version, made_by) != (FOLDER_VERSION, __version__):
                raise InputError(
                    f"{self.path} holds a run of version {version} by pb4u {made_by}, and this is pb4u {__version__} "
                    f"with version {FOLDER_VERSION}; results of two versions are not comparable: give another --out."
                )
            if meta["kind"] != self._kind:
                raise InputError(f"{self.path} is a folder of {meta['kind']}, not of {self._kind}; give another --out.")
            for name, value in self._settings.items():
                if meta[name] != value:
                    raise InputError(
                        f"{self.path} holds {self._kind} with {name} {meta[name]}, not {value}; continue with that "
                        "value, or give another --out."
                    )
        except InputError:
            raise
        except (OSError, ValueError, KeyError, TypeError, AttributeError, StopIteration) as error:
            raise InputError(f"{file} is not the manifest of {self._kind}; give another --out.") from error

    def write_manifest(self, jobs: Sequence[Job], **more: Any) -> None:
        """Record what the run consists of.

        Args:
            jobs: all jobs of the run.
            more: further entries, as JSON.
        """
        manifest = {
            "version": FOLDER_VERSION,
            "pb4u": __version__,
            "kind": self._kind,
            **self._settings,
            **more,
            "jobs": [{"key": job.key, "job": str(job)} for job in jobs],
        }
        self.write(MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())

    def trajectory(self, job: Job) -> Path:
        """Path of the trajectory of a job; the file may be absent.

        Args:
            job: the job.
        """
        return self.path / self.arrays / f"{job.key}.npz"

    def take(self, job: Job, outcome: Made | Failure) -> None:
        """Store the outcome of a job.

        Args:
            job: the finished job.
            outcome: its result, or its failure.

        Raises:
            Pb4uError: the disk refuses.
        """
        if isinstance(outcome, Failure):
            record = {"key": job.key, "job": str(job), **asdict(outcome)}
            self.write(f"{JOBS}/{job.key}.failed.json", (json.dumps(record, indent=1) + "\n").encode())
            return
        # First, so that a result is whole once it is there.
        if outcome.trajectory is not None:
            self.write(f"{self.arrays}/{job.key}.npz", outcome.trajectory)
        values = json.loads(json_text(dict(outcome.result)))
        envelope = {"key": job.key, "checksum": _checksum(values), "result": values}
        self.write(f"{JOBS}/{job.key}.json", (json.dumps(envelope) + "\n").encode())
        self.forget_failure(job)

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
        """Error for a file of the run that cannot be written.

        Args:
            name: path of the file within the folder.
            error: why.
        """
        return Pb4uError(
            f"Cannot write {self.path / name}: {error.strerror or error}; finished jobs are kept: run the same "
            "command again to continue."
        )

    def result(self, job: Job) -> dict[str, Any] | None:
        """The result of a job; None where it is missing or damaged.

        Args:
            job: the job.
        """
        try:
            envelope = read_json(self._jobs / f"{job.key}.json")
            result = envelope["result"]
            is_sound = envelope["key"] == job.key and envelope["checksum"] == _checksum(result)
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return result if is_sound else None

    def failure(self, job: Job) -> Failure | None:
        """Reason why a job failed; None if it was not tried, or succeeded.

        Args:
            job: the job.
        """
        try:
            record = read_json(self._failed(job))
            return Failure(str(record["sentence"]), str(record["trace"]))
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def forget_failure(self, job: Job) -> None:
        """Let a job be tried again.

        Args:
            job: the job.
        """
        self._failed(job).unlink(missing_ok=True)

    def still_to_do(
        self, jobs: Sequence[Job], noun: str, retry: bool, say: Callable[[str], None], *, plan_only: bool = False
    ) -> list[Any]:
        """The jobs without a result, except those that failed before.

        Args:
            jobs: every job of the run.
            noun: name of the jobs, in the plural.
            retry: include jobs that failed before.
            say: called with a sentence on how many are done, failed and to do.
            plan_only: only count the jobs, and keep the records of failures.
        """
        undone = [job for job in jobs if self.result(job) is None]
        failed = {job.key for job in undone if self.failure(job)}
        if retry:
            for job in () if plan_only else undone:
                self.forget_failure(job)
            failed = set()
        missing = [job for job in undone if job.key not in failed]
        finished = len(jobs) - len(undone)
        parts = [f"{len(jobs)} {noun}", f"{finished} done before" if finished else "", f"{len(missing)} to do"]
        parts.append(f"{len(failed)} failed before and are skipped (--retry tries them again)" if failed else "")
        say(", ".join(part for part in parts if part) + ".")
        return missing

    def work_through(self, jobs: Sequence[Job], pool: WorkerPool, progress: Progress) -> None:
        """Do all jobs. Each result is written at once; a job whose worker died is given to another worker, jobs of a
        pack one by one.

        Args:
            jobs: or packs of them, in the order to start them.
            pool: the workers that do them.
            progress: called with (jobs ended, jobs in all).
        """
        waiting = deque(jobs)
        ended, total, under_way = 0, sum(len(jobs_of(job)) for job in jobs), 0
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
            if outcome is None and (tries[job.key] < MOST_TRIES or isinstance(job, JobPack)):
                waiting.extendleft(jobs_of(job))
                continue
            if outcome is None:
                outcome = Failure(
                    f"Its worker died {MOST_TRIES} times, for want of memory perhaps; try fewer --workers."
                )
            outcomes = outcome if isinstance(outcome, list) else [outcome] * len(jobs_of(job))
            for one, answer in zip(jobs_of(job), outcomes, strict=True):
                self.take(one, answer)
            ended += len(outcomes)
            progress(ended, total)

    def complete(
        self,
        jobs: Sequence[Job],
        missing: Sequence[Job],
        noun: str,
        pool: Callable[[], WorkerPool],
        progress: Callable[[str], AbstractContextManager[Progress]],
        finish: Callable[[], None] = lambda: None,
        title: str = "",
    ) -> None:
        """Do the missing jobs with workers of their own, which end with them.

        Args:
            jobs: every job of the run.
            missing: result of `still_to_do`, or packs of these jobs, in the order to start them.
            noun: name of the jobs, in the plural.
            pool: makes the workers; called only where there are jobs.
            progress: opens a display for a label.
            finish: called at the end.
            title: beginning of the label of the display.

        Raises:
            Pb4uError: the user ended it, or a result cannot be written.
        """
        label = f"{title}{sum(len(jobs_of(job)) for job in missing)} {noun}"
        try:
            if missing:
                with progress(label) as show, closing(pool()) as workers:
                    self.work_through(missing, workers, show)
            finish()
        except KeyboardInterrupt:
            finished = sum(self.result(job) is not None for job in jobs)
            raise Pb4uError(
                f"Stopped with {finished} of {len(jobs)} {noun} done; run the same command again to continue."
            ) from None

    def _failed(self, job: Job) -> Path:
        return self._jobs / f"{job.key}.failed.json"

    def __enter__(self: _Folder) -> _Folder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()


def quiet(label: str) -> AbstractContextManager[Progress]:
    """No progress bar.

    Args:
        label: label of a progress bar.
    """
    return nullcontext(no_progress)


def _is_foreign(path: Path) -> bool:
    """Neither empty nor a run's; a run killed before its manifest was there leaves this much."""
    names = {entry.name for entry in path.iterdir()}
    return MANIFEST not in names and any(name not in (JOBS, LOCK) and not name.startswith(".") for name in names)


def _checksum(result: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
