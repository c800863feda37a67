"""The folder of a dataset: a folder of jobs whose results come with a trajectory each.

* clips/KEY.npz: the trajectory of a clip, until it is in a shard
* shards/shard-00000.tar: KEY.npz and KEY.json of many clips, where shards are asked for
* index.parquet: a row a clip
"""

from __future__ import annotations

import io
import json
import os
import tarfile
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pb4u import __version__
from pb4u.dataset.clip import DATASET_VERSION, Clip, ClipJob
from pb4u.errors import InputError
from pb4u.io.atomic_file import MARK, move_into_place
from pb4u.jobs.job_folder import MANIFEST, JobFolder

CLIPS, SHARDS, INDEX = "clips", "shards", "index.parquet"


class Place(NamedTuple):
    """Where the trajectory of a clip lies.

    Args:
        file: path within the folder.
        member: name within that file, where it is an archive.
    """

    file: str
    member: str | None


class DatasetFolder(JobFolder):
    """The files of one dataset; while open, it is this process's alone.

    Args:
        path: the folder, made where it is not there.
        layout: how clips lie in it.
        half: whether trajectories are kept in half precision.

    Raises:
        InputError: it holds something else, or a dataset of another version, layout or precision, or is in use.
    """

    def __init__(self, path: Path, layout: Layout, half: bool) -> None:
        self.layout = layout
        self._half = half
        super().__init__(path, "a dataset")
        try:
            for folder in (path, path / CLIPS, path / SHARDS):
                for leftover in folder.glob(f".*{MARK}"):
                    leftover.unlink()
            self._in_shards = _shard_members(path / SHARDS)
        except OSError as error:
            raise InputError(f"Cannot use the folder {path}: {error.strerror or error}.") from error

    def require_same(self, manifest: dict[str, Any]) -> None:
        held = tuple(manifest[name] for name in ("dataset_version", "pb4u", "format", "half"))
        if held[:2] != (DATASET_VERSION, __version__):
            raise InputError(
                f"{self.path} holds a dataset of version {held[0]} by pb4u {held[1]}, and this is pb4u {__version__} "
                f"with version {DATASET_VERSION}; clips of two do not belong in one dataset: give another --out."
            )
        if held[2:] != (self.layout.name, self._half):
            precision = "half" if held[3] else "full"
            raise InputError(
                f"{self.path} holds a dataset with --format {held[2]} in {precision} precision; go on with those, or "
                "give another --out."
            )

    def write_manifest(self, jobs_file: str, jobs: Sequence[ClipJob]) -> None:
        """Record what the dataset consists of.

        Args:
            jobs_file: name of the file that describes it.
            jobs: every clip of it.
        """
        manifest = {
            "dataset_version": DATASET_VERSION,
            "pb4u": __version__,
            "format": self.layout.name,
            "half": self._half,
            "jobs_file": jobs_file,
            "jobs": [{"key": job.key, "job": str(job)} for job in jobs],
        }
        self.write(MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
        # After the manifest: without one, a folder with clips in it would be taken for somebody else's.
        (self.path / CLIPS).mkdir(exist_ok=True)

    def parts(self, job: ClipJob, made: Clip) -> tuple[dict[str, Any], dict[str, bytes]]:
        return made.record, {_loose(job.key): made.trajectory}

    def result(self, job: Any) -> dict[str, Any] | None:
        """The record of a clip; None where it, or its trajectory, is not there whole."""
        return None if self.place(job.key) is None else super().result(job)

    def place(self, key: str) -> Place | None:
        """Where the trajectory of a clip lies; None where there is none.

        Args:
            key: address of the clip.
        """
        if key in self._in_shards:
            return Place(f"{SHARDS}/{self._in_shards[key]}", f"{key}.npz")
        return Place(_loose(key), None) if (self.path / _loose(key)).is_file() else None

    def pack(self, jobs: Sequence[ClipJob]) -> None:
        """Bring the trajectories of clips that are done into the layout of the dataset.

        Args:
            jobs: clips of the dataset.

        Raises:
            Pb4uError: the disk refuses.
        """
        # In the order of their addresses, which is as good as shuffled and the same in every run.
        done = {job.key: job for job in jobs if (self.path / _loose(job.key)).is_file() and self.result(job)}
        loose = [done[key] for key in sorted(done)]
        for key in self._in_shards:
            (self.path / _loose(key)).unlink(missing_ok=True)
        for batch in self.layout.batches([job for job in loose if job.key not in self._in_shards]):
            self._write_shard(batch)

    def _write_shard(self, jobs: Sequence[ClipJob]) -> None:
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


class Layout(ABC):
    """How clips lie in the folder of a dataset.

    Attributes:
        name: what `--format` calls it.
    """

    name: str

    @abstractmethod
    def batches(self, jobs: Sequence[ClipJob]) -> list[Sequence[ClipJob]]:
        """Clips that go into one shard each."""


class FolderOfTrajectories(Layout):
    """Every clip a file of its own, which `pb4u view` and `pb4u convert` take."""

    name = "folder"

    def batches(self, jobs: Sequence[ClipJob]) -> list[Sequence[ClipJob]]:
        return []


class WebDataset(Layout):
    """Tar files of many clips, read from front to back, as WebDataset reads them.

    Args:
        clips: of one shard.

    Raises:
        InputError: `clips` is not a positive number.
    """

    name = "webdataset"

    def __init__(self, clips: int) -> None:
        if clips < 1:
            raise InputError(f"A shard has 1 clip or more, not {clips}.")
        self.clips = clips

    def batches(self, jobs: Sequence[ClipJob]) -> list[Sequence[ClipJob]]:
        return [jobs[first : first + self.clips] for first in range(0, len(jobs), self.clips)]


def _loose(key: str) -> str:
    return f"{CLIPS}/{key}.npz"


def _shard_members(folder: Path) -> dict[str, str]:
    """The shard of every clip that is in one."""
    found: dict[str, str] = {}
    for shard in sorted(folder.glob("shard-*.tar")):
        try:
            with tarfile.open(shard, "r:") as archive:
                names = archive.getnames()
        except tarfile.TarError as error:
            raise InputError(f"{shard} is no shard that can be read: {error}; move it away.") from None
        found |= {name.removesuffix(".npz"): shard.name for name in names if name.endswith(".npz")}
    return found
