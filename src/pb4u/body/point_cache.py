"""Point caches: the PC2 and MDD files in which animation tools store the vertices of each frame."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pb4u.errors import InputError

CACHE_SUFFIXES = (".pc2", ".mdd")
_PC2_MAGIC = b"POINTCACHE2\0"
_PC2_HEADER = struct.Struct("<12siiffi")
_MDD_HEADER = struct.Struct(">ii")


@dataclass(frozen=True, eq=False)
class PointCache:
    """Vertices of each frame of an animation.

    Args:
        positions: (frames, points, 3) float32 in the units of the file, mapped from the file and read when touched.
        fps: frames per second, None where the file does not tell.
    """

    positions: np.ndarray
    fps: float | None


def read_point_cache(path: Path) -> PointCache:
    """Map a .pc2 or .mdd file. Raises InputError when it is another file, or cut short."""
    try:
        return _read_pc2(path) if path.suffix.lower() == ".pc2" else _read_mdd(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error


def _read_pc2(path: Path) -> PointCache:
    with path.open("rb") as file:
        header = file.read(_PC2_HEADER.size)
    if len(header) < _PC2_HEADER.size or not header.startswith(_PC2_MAGIC):
        raise InputError(f'{path}: not a PC2 point cache, it does not begin with "POINTCACHE2"; export it again.')
    _, _, points, _, _, frames = _PC2_HEADER.unpack(header)
    # Its sample rate counts samples per frame of a scene whose frame rate the file does not hold.
    return PointCache(_map(path, _PC2_HEADER.size, frames, points, "<f4"), None)


def _read_mdd(path: Path) -> PointCache:
    with path.open("rb") as file:
        header = file.read(_MDD_HEADER.size)
        if len(header) < _MDD_HEADER.size:
            raise InputError(f"{path}: not an MDD point cache, it ends in its header; export it again.")
        frames, points = _MDD_HEADER.unpack(header)
        times = np.frombuffer(file.read(4 * frames), dtype=">f4") if 0 < frames < 10**7 else np.zeros(0, dtype=">f4")
    positions = _map(path, _MDD_HEADER.size + 4 * max(frames, 0), frames, points, ">f4")
    duration = float(times[-1] - times[0])
    return PointCache(positions, (frames - 1) / duration if duration > 0 else None)


def _map(path: Path, offset: int, frames: int, points: int, dtype: str) -> np.ndarray:
    if frames < 1 or points < 1:
        raise InputError(f"{path} holds {frames} frames of {points} points; export it again.")
    needed, size = offset + 12 * frames * points, path.stat().st_size
    if size < needed:
        raise InputError(
            f"{path} is cut short: {frames} frames of {points} points need {needed} bytes and it has {size}; "
            "export or copy it again."
        )
    return np.memmap(path, dtype=dtype, mode="r", offset=offset, shape=(frames, points, 3))
