"""The folder of a dataset: a folder of jobs whose results come with a trajectory each.

* clips/KEY.npz: the trajectory of a clip, until it is in a shard
* shards/shard-00000.tar: KEY.npz and KEY.json of many clips, with `--format webdataset`
* index.parquet: a row a clip
"""

from __future__ import annotations

import io
import json
import os
import re
import tarfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pb4u.errors import InputError, on_disk
from pb4u.io.atomic_file import MARK, move_into_place
from pb4u.jobs.job_folder import JobFolder
from pb4u.measures.run_job import RunJob

CLIPS, SHARDS, INDEX = "clips", "shards", "index.parquet"


class Place(NamedTuple):
    """Location of the trajectory of a clip.

    Args:
        file: path within the folder.
        member: name within that file, where it is an archive.
    """

    file: str
    member: str | None


class DatasetFolder(JobFolder):
    """The files of one dataset; while open, no other process may use the folder.

    Args:
        path: the folder, created if absent.
        clips_per_shard: clips of one tar file, as WebDataset reads them; None keeps every clip a file of its own.
        half: whether trajectories are kept in half precision.

    Raises:
        InputError: it holds something else, or a dataset of another version, format or precision, or is in use; or a
            shard would have no clip.
    """

    arrays = CLIPS

    def __init__(self, path: Path, clips_per_shard: int | None, half: bool) -> None:
        if clips_per_shard is not None and clips_per_shard < 1:
            raise InputError(f"A shard must have 1 clip or more, not {clips_per_shard}.")
        self._clips_per_shard = clips_per_shard
        form = "folder" if clips_per_shard is None else "webdataset"
        super().__init__(path, "a dataset", {"format": form, "precision": "half" if half else "full"})
        with on_disk(f"Cannot use the folder {path}"):
            for folder in (path, path / CLIPS, path / SHARDS):
                for leftover in folder.glob(f".*{MARK}"):
                    leftover.unlink()
            self._in_shards = _shard_members(path / SHARDS)

    def result(self, job: Any) -> dict[str, Any] | None:
        """The record of a clip; None where it or its trajectory is missing or damaged.

        Args:
            job: the clip.
        """
        return None if self.place(job.key) is None else super().result(job)

    def place(self, key: str) -> Place | None:
        """Location of the trajectory of a clip; None where there is none.

        Args:
            key: address of the clip.
        """
        if key in self._in_shards:
            return Place(f"{SHARDS}/{self._in_shards[key]}", f"{key}.npz")
        return Place(_loose(key), None) if (self.path / _loose(key)).is_file() else None

    def pack(self, jobs: Sequence[RunJob]) -> None:
        """Bring the trajectories of clips that are done into the layout of the dataset.

        Args:
            jobs: clips of the dataset.

        Raises:
            Pb4uError: the disk refuses.
        """
        # In the order of their addresses, which is as good as shuffled and the same in every run.
        finished = {job.key: job for job in jobs if (self.path / _loose(job.key)).is_file() and self.result(job)}
        loose = [finished[key] for key in sorted(finished)]
        for key in self._in_shards:
            (self.path / _loose(key)).unlink(missing_ok=True)
        if size := self._clips_per_shard:
            unpacked = [job for job in loose if job.key not in self._in_shards]
            for first in range(0, len(unpacked), size):
                self._write_shard(unpacked[first : first + size])

    def _write_shard(self, jobs: Sequence[RunJob]) -> None:
        last = max((int(name[6:-4]) for name in self._in_shards.values()), default=-1)
        name = f"shard-{last + 1:05d}.tar"
        shards = self.path / SHARDS
        beside = shards / f".{name}.{os.getpid()}{MARK}"
        try:
            shards.mkdir(exist_ok=True)
            with tarfile.open(beside, "w", format=tarfile.PAX_FORMAT) as archive:
                for job in jobs:
                    record = json.dumps({"key": job.key, **(self.result(job) or {})}).encode()
                    for suffix, content in ((".npz", (self.path / _loose(job.key)).read_bytes()), (".json", record)):
                        member = tarfile.TarInfo(job.key + suffix)
                        member.size = len(content)
                        archive.addfile(member, io.BytesIO(content))
            move_into_place(beside, shards / name)
        except OSError as error:
            beside.unlink(missing_ok=True)
            raise self.refused(f"{SHARDS}/{name}", error) from error
        self._in_shards |= {job.key: name for job in jobs}
        for job in jobs:
            (self.path / _loose(job.key)).unlink()


def _loose(key: str) -> str:
    return f"{CLIPS}/{key}.npz"


def _shard_members(folder: Path) -> dict[str, str]:
    shards: dict[str, str] = {}
    for shard in sorted(file for file in folder.glob("shard-*.tar") if re.fullmatch(r"shard-\d+\.tar", file.name)):
        try:
            with tarfile.open(shard, "r:") as archive:
                names = archive.getnames()
        except tarfile.TarError as error:
            raise InputError(f"{shard} is not a shard that can be read: {error}; move it away.") from None
        shards |= {name.removesuffix(".npz"): shard.name for name in names if name.endswith(".npz")}
    return shards
