"""A dataset from runs to index: plan, say what it takes, make what is missing, pack, write the index."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from pb4u.dataset.clip import ClipJob
from pb4u.dataset.dataset_folder import INDEX, DatasetFolder, Layout
from pb4u.dataset.index import require_parquet, write_index
from pb4u.dataset.planning import Footprint, expected_seconds, footprints, plan_clips
from pb4u.errors import InputError, Pb4uError
from pb4u.jobs.job_queue import make_all, still_to_do
from pb4u.jobs.worker_pool import WorkerPool
from pb4u.progress import Progress, no_progress
from pb4u.run import Run

_SPARE = 64 * 2**20
"""Bytes that stay free on the disk: the index, the manifest and what else the machine writes meanwhile."""

_NUMBER = re.compile(r"\d[\d.,]*")


def make_dataset(
    runs: Sequence[Run],
    out: Path,
    pool: Callable[[], WorkerPool],
    layout: Layout,
    *,
    half: bool = False,
    jobs_file: str = "",
    workers: int | None = 1,
    retry: bool = False,
    plan_only: bool = False,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str], AbstractContextManager[Progress]] = lambda label: nullcontext(no_progress),
) -> dict[str, Any]:
    """Make the clips of many runs into a folder, going on where an earlier run stopped, and write its index.

    Args:
        runs: what the clips are of.
        out: the folder, made where it is not there.
        pool: makes those who do the work; called only where clips are missing.
        layout: how clips lie in the folder.
        half: keep trajectories in half precision.
        jobs_file: name of the file that describes the runs, for the manifest.
        workers: how many work, for the time told; None where that is not known.
        retry: try clips again that failed before.
        plan_only: say what it takes, and make nothing.
        say: takes sentences on how it goes.
        progress: opens a display for a label; none by default.

    Returns:
        Counts, bytes and seconds of the dataset, as JSON; `failures` lists the clips that could not be made.

    Raises:
        InputError: something is unknown or unusable, or the disk has not room enough; before any work.
        Pb4uError: the disk refuses, or it was interrupted.
    """
    require_parquet()
    try:
        jobs = plan_clips(runs, half, say)
    except InputError as error:
        raise InputError(f"{jobs_file}: {error}" if jobs_file else str(error)) from None
    takes = dict(zip((job.key for job in jobs), footprints(jobs), strict=True))
    with DatasetFolder(out, layout, half) as folder:
        missing = still_to_do(jobs, folder, "clips", retry, say)
        if missing:
            say(_told(missing, jobs, takes, folder, workers))
            _require_room(sum(takes[job.key].size for job in missing), out)
        if plan_only:
            return _summary(jobs, folder)
        folder.write_manifest(jobs_file, jobs)

        def stopped() -> str:
            done = sum(folder.result(job) is not None for job in jobs)
            return f"Stopped with {done} of {len(jobs)} clips done; the same command goes on."

        with progress(f"{len(missing)} clips") if missing else nullcontext(no_progress) as show:
            make_all(missing, pool, folder.take, show, stopped)
        try:
            folder.pack(jobs)
            write_index(folder, jobs)
        except KeyboardInterrupt:
            raise Pb4uError(stopped()) from None
        return _summary(jobs, folder)


def _told(
    missing: Sequence[ClipJob],
    jobs: Sequence[ClipJob],
    takes: dict[str, Footprint],
    folder: DatasetFolder,
    workers: int | None,
) -> str:
    """Sentence on what the missing clips take."""
    records = [(takes[job.key], record) for job in jobs if (record := folder.result(job)) is not None]
    seconds = expected_seconds([(job, takes[job.key]) for job in missing], records, workers or 1)
    size = sum(takes[job.key].size for job in missing)
    basis = "by those that are done" if records else "a first guess"
    doing = "of one core's time" if workers is None else f"with {workers} {'worker' if workers == 1 else 'workers'}"
    return (
        f"{len(missing):,} clips take about {told_size(size)} on the disk, which has "
        f"{told_size(_free(folder.path))} free, and about {_told_time(seconds)} {doing} ({basis})."
    )


def _require_room(size: int, out: Path) -> None:
    free = _free(out)
    if size + _SPARE > free:
        raise InputError(
            f"The clips take about {told_size(size)}, and the disk of {out} has {told_size(free)} free; make room, "
            "keep them in half precision with --half, or ask for fewer."
        )


def _free(path: Path) -> int:
    return shutil.disk_usage(path).free


def told_size(size: float) -> str:
    """A size in the unit that suits it.

    Args:
        size: bytes.
    """
    for unit, bytes_in in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= bytes_in:
            return f"{size / bytes_in:.3g} {unit}"
    return f"{size / 1e3:.3g} KB"


def _told_time(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{max(seconds, 1.0):.0f} s"


def _summary(jobs: Sequence[ClipJob], folder: DatasetFolder) -> dict[str, Any]:
    results = [(job, folder.result(job)) for job in jobs]
    records = [record for _, record in results if record is not None]
    failed = [(job, failure) for job, record in results if record is None and (failure := folder.failure(job))]
    return {
        "clips": len(jobs),
        "done": len(records),
        "diverged": sum(bool(record["diverged"]) for record in records),
        "limbs_through_cloth": sum(bool(record.get("limbs_through_cloth")) for record in records),
        "notes": _summed(record.get("notes", ()) for record in records),
        "failures": [{"key": job.key, "job": str(job), "sentence": failure.sentence} for job, failure in failed],
        "bytes": sum(record["bytes"] for record in records),
        "worker_seconds": sum(record["seconds"] for record in records),
        "index": str(folder.path / INDEX),
    }


def _summed(notes: Iterable[Sequence[str]]) -> list[dict[str, Any]]:
    """The sentences of all clips, the most frequent first; those that differ in their numbers count as one."""
    first: dict[str, str] = {}
    counts: Counter[str] = Counter()
    for sentences in notes:
        alike = {_NUMBER.sub("N", sentence): sentence for sentence in sentences}
        counts.update(alike.keys())
        first = {**alike, **first}
    return [{"clips": count, "sentence": first[kind]} for kind, count in counts.most_common()]
