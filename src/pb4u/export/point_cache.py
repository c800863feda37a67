"""PC2 and MDD point caches, each with the OBJ that it moves.

`walk.pc2` comes with walk.obj: the garment at its first frame, vertices in the order of the cache, with its UVs.
In Blender import the OBJ, then add a Mesh Cache modifier with the cache file and leave its axes as they are: the
importer turns the object, not its vertices, so object and cache agree although both are Y up, in metres. The frame
rate of the scene has to be set to that of the trajectory: PC2 holds none, and Blender plays one sample a frame.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from pb4u.errors import InputError
from pb4u.export.obj_sequence import SIGNATURE, write_obj
from pb4u.export.progress import Progress
from pb4u.scene.trajectory import Trajectory


def companion(path: Path) -> Path:
    """The OBJ that belongs to a cache."""
    return path.with_suffix(".obj")


def check_companion(path: Path) -> None:
    """Raises InputError where the OBJ beside the cache would overwrite a mesh that was not written here."""
    mesh = companion(path)
    if not mesh.exists():
        return
    with mesh.open("rb") as file:
        ours = mesh.is_file() and file.read(len(SIGNATURE)) == SIGNATURE.encode()
    if not ours:
        raise InputError(f"{mesh} exists and is not from pb4u, and {path.name} needs that name: choose another name.")


def write_pc2(trajectory: Trajectory, path: Path, progress: Progress | None = None) -> None:
    """PC2, little-endian: header (magic, version 1, points, first frame, sampling 1, samples), then the vertices."""
    samples, points = trajectory.positions.shape[:2]
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, points, 0.0, 1.0, samples)
    _write(trajectory, path, lambda file: file.write(header), "<f4", progress)


def write_mdd(trajectory: Trajectory, path: Path, progress: Progress | None = None) -> None:
    """MDD (LightWave), big-endian: samples, points, the time of each sample [s], then the vertices."""
    samples, points = trajectory.positions.shape[:2]
    times = (np.arange(samples) / trajectory.fps).astype(">f4")
    header = struct.pack(">ii", samples, points) + times.tobytes()
    _write(trajectory, path, lambda file: file.write(header), ">f4", progress)


def _write(
    trajectory: Trajectory, path: Path, begin: Callable[[BinaryIO], object], dtype: str, progress: Progress | None
) -> None:
    with path.open("wb") as file:
        begin(file)
        for done, positions in enumerate(trajectory.positions, start=1):
            file.write(positions.astype(dtype).tobytes())
            if progress:
                progress(done, trajectory.frame_count)
    write_obj(trajectory, companion(path))
