"""Frames as they are computed: a point cache of each garment that grows, and a line for every step.

`--live FOLDER` writes `NAME.pc2` there for each garment, on its author's own mesh, and `progress.jsonl`. A PC2 has the
number of its samples in its header; it is raised once a frame's bytes are there, so that whoever reads the file
meanwhile, Blender's Mesh Cache modifier or another program, never meets half a frame. What is there stays after an
interrupt.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np

from pb4u.errors import InputError
from pb4u.export.selection import source_garments, source_motion
from pb4u.io.atomic_file import LOCK, locked
from pb4u.io.point_cache import pc2_header
from pb4u.scene.trajectory import Frame, TrajectoryHeader

PROGRESS = "progress.jsonl"
"""A line {"step": done, "steps": in all, "frames": written} for every step; it also marks a folder as one of these."""


def check_live_folder(folder: Path) -> None:
    """Refuse a folder that holds anything but the frames of an earlier run; called before any work is done.

    Args:
        folder: to write to; it is created if absent.

    Raises:
        InputError: it is a file, it cannot be made or written to, or it holds something else.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} for --live is a file; give the name of a folder.")
    parent = folder if folder.exists() else folder.absolute().parent
    if not parent.is_dir():
        raise InputError(f"The folder {parent} for --live does not exist; make it first.")
    if not os.access(parent, os.W_OK):
        raise InputError(f"The folder {parent} for --live cannot be written to.")
    others = folder.exists() and any(entry.name != LOCK for entry in folder.iterdir())
    if others and not (folder / PROGRESS).is_file():
        raise InputError(f"{folder} for --live holds other files; give a new folder, or an empty one.")


class LiveCaches:
    """Point caches of a run's garments that grow during the run.

    Args:
        folder: to write to; the caches of an earlier run there are replaced.
        header: of the trajectory that is computed.
        fps: frames per second that are written [1/s]; other than the header's, frames are interpolated as they arrive.
        frames: most frames to write; None for all.

    Raises:
        InputError: the folder cannot be written to, or another process writes there.
    """

    def __init__(self, folder: Path, header: TrajectoryHeader, fps: float, frames: int | None = None) -> None:
        self._on_source = source_motion(header)
        owner = source_garments(header)
        self._rows = [np.flatnonzero(owner == k) for k in range(len(header.garments))]
        self._stride = header.fps / fps
        self._frames = frames
        self._arrived: list[np.ndarray] = []
        self._dropped = self.frame_count = 0
        self._open = ExitStack()
        try:
            folder.mkdir(exist_ok=True)
            self._open.enter_context(_held(folder))
            for earlier in folder.glob("*.pc2"):
                earlier.unlink()
            self._progress = self._open.enter_context((folder / PROGRESS).open("w", encoding="ascii"))
            self._caches: list[BinaryIO] = [
                self._open.enter_context((folder / name).open("wb")) for name in _file_names(header)
            ]
            for cache, rows in zip(self._caches, self._rows, strict=True):
                cache.write(pc2_header(len(rows), 0))
                cache.flush()
        except OSError as error:
            self._open.close()
            raise _not_written(folder, error) from error
        self._folder = folder

    def append(self, frame: Frame) -> None:
        """Accept a computed frame, and write the frames that can be interpolated from the frames so far.

        Args:
            frame: the next one.

        Raises:
            InputError: the disk is full.
        """
        self._arrived.append(frame.positions)
        frames = self._dropped + len(self._arrived)
        while self._frames is None or self.frame_count < self._frames:
            low, weight = self._place(self.frame_count)
            if low + (weight > 0) >= frames:
                return
            self._arrived, self._dropped = self._arrived[low - self._dropped :], low
            first = self._arrived[0]
            shown = (1 - weight) * first + weight * self._arrived[1] if weight else first
            self._write(self._on_source(shown[None])[0])

    def progress(self, done: int, total: int) -> None:
        """Write the line of a step.

        Args:
            done: steps done, lead-in included.
            total: steps in all.
        """
        line = {"step": done, "steps": total, "frames": self.frame_count}
        try:
            self._progress.write(json.dumps(line) + "\n")
            self._progress.flush()
        except OSError as error:
            raise _not_written(self._folder, error) from error

    def _place(self, frame: int) -> tuple[int, np.float32]:
        """The computed frame before a written one, and how far it is to the next; as `selection.resampled` has it."""
        at = frame * self._stride
        # A product that rounding left just beside a computed frame is that frame: the next may never come.
        low = round(at) if abs(at - round(at)) < 1e-6 else int(at)
        return low, np.float32(max(at - low, 0.0) if at - low > 1e-6 else 0.0)

    def _write(self, positions: np.ndarray) -> None:
        self.frame_count += 1
        try:
            for cache, rows in zip(self._caches, self._rows, strict=True):
                cache.write(np.ascontiguousarray(positions[rows], dtype="<f4").tobytes())
                cache.flush()
                end = cache.tell()
                cache.seek(0)
                cache.write(pc2_header(len(rows), self.frame_count))
                cache.flush()
                cache.seek(end)
        except OSError as error:
            raise _not_written(self._folder, error) from error

    def __enter__(self) -> LiveCaches:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Keep other processes from writing in a folder."""
    with locked(folder, f"Another process writes in {folder}; wait for it, or give --live another folder."):
        try:
            yield
        finally:
            # Before it is released, since another could hold it then.
            with suppress(OSError):
                (folder / LOCK).unlink()


def _file_names(header: TrajectoryHeader) -> list[str]:
    """A name for each garment's cache, without what a file system may refuse; of one name the later are numbered."""
    stems = [re.sub(r"[^\w.+-]+", "_", str(garment["name"])).strip("._") or "garment" for garment in header.garments]
    numbers = [stems[: k + 1].count(stem) for k, stem in enumerate(stems)]
    return [
        f"{stem}-{number}.pc2" if number > 1 else f"{stem}.pc2" for stem, number in zip(stems, numbers, strict=True)
    ]


def _not_written(folder: Path, error: OSError) -> InputError:
    return InputError(f"Cannot write in {folder}: {error.strerror or error}.")
