"""A dataset from runs to index: plan, say what it takes, make what is missing, pack, write the index."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from pb4u.dataset.dataset_folder import CLIPS, INDEX, DatasetFolder
from pb4u.dataset.index import require_parquet, write_index
from pb4u.dataset.planning import footprints, plan_clips, together
from pb4u.errors import InputError
from pb4u.jobs.job_folder import quiet
from pb4u.jobs.worker_pool import WorkerPool
from pb4u.measures.run_job import RunJob
from pb4u.progress import Progress
from pb4u.run import Run

_SPARE = 64 * 2**20
"""Bytes that stay free on the disk: the index, the manifest and what else the machine writes meanwhile."""

_NUMBER = re.compile(r"\d[\d.,]*")


def make_dataset(
    runs: Sequence[Run],
    out: Path,
    pool: Callable[[], WorkerPool],
    clips_per_shard: int | None = None,
    *,
    half: bool = False,
    jobs_file: str = "",
    retry: bool = False,
    plan_only: bool = False,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str], AbstractContextManager[Progress]] = quiet,
) -> dict[str, Any]:
    """Simulate the clips of many runs into a folder, continuing where an earlier run stopped, and write its index.

    Args:
        runs: runs of the clips.
        out: the folder, created if absent.
        pool: makes the workers; called only where clips are missing.
        clips_per_shard: clips of one tar file, as WebDataset reads them; None keeps every clip a file of its own.
        half: keep trajectories in half precision.
        jobs_file: name of the file that describes the runs, for the manifest.
        retry: try clips again that failed before.
        plan_only: only say how much time and space it takes.
        say: called with sentences on the progress.
        progress: opens a display for a label; none by default.

    Returns:
        Counts, bytes and seconds of the dataset, as JSON; `failures` lists the clips that could not be made.

    Raises:
        InputError: something is unknown or unusable, or the disk is too full; raised before any work.
        Pb4uError: the disk refuses, or it was interrupted.
    """
    require_parquet()
    try:
        jobs = plan_clips(runs, half, say)
    except InputError as error:
        raise InputError(f"{jobs_file}: {error}" if jobs_file else str(error)) from None
    with DatasetFolder(out, clips_per_shard, half) as folder:
        missing = folder.still_to_do(jobs, "clips", retry, say, plan_only=plan_only)
        if missing:
            sizes = sorted(footprints(missing))
            size = sum(sizes)
            room = f"{size_text(size)} on the disk, which has {size_text(_free(out))} free"
            say(f"{len(missing):,} clips take about {room}.")
            # A shard is written whole before the clips that it takes in are deleted.
            _require_room(size + sum(sizes[-clips_per_shard:] if clips_per_shard else ()), out)
        if plan_only:
            return _summary(jobs, folder)
        folder.write_manifest(jobs, jobs_file=jobs_file)
        # After the manifest: without one, a folder with clips in it would be taken for somebody else's.
        (out / CLIPS).mkdir(exist_ok=True)

        def finish() -> None:
            folder.pack(jobs)
            write_index(folder, jobs)

        folder.complete(jobs, together(missing), "clips", pool, progress, finish)
        return _summary(jobs, folder)


def _require_room(size: int, out: Path) -> None:
    free = _free(out)
    if size + _SPARE > free:
        raise InputError(
            f"The clips take about {size_text(size)}, and the disk of {out} has {size_text(free)} free; make room, "
            "store them in half precision with --half, or ask for fewer."
        )


def _free(path: Path) -> int:
    return shutil.disk_usage(path).free


def size_text(size: float) -> str:
    """A size in the unit that suits it.

    Args:
        size: bytes.
    """
    for unit, bytes_in in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= bytes_in:
            return f"{size / bytes_in:.3g} {unit}"
    return f"{size / 1e3:.3g} KB"


def _summary(jobs: Sequence[RunJob], folder: DatasetFolder) -> dict[str, Any]:
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
