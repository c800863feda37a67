"""PC2 point caches that grow: read while a run writes them, written while Blender plays them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

_HEADER = struct.Struct("<12siiffi")
_MAGIC = b"POINTCACHE2\0"


class GrowingCache:
    """A cache written sample by sample; its header is raised once a sample is whole.

    Args:
        path: the file; one of this name is replaced.
        points: vertices of each sample.
    """

    def __init__(self, path: Path, points: int) -> None:
        self.path, self.points, self.samples = path, points, 0
        path.write_bytes(_HEADER.pack(_MAGIC, 1, points, 0.0, 1.0, 0))

    def append(self, positions: np.ndarray) -> None:
        """Write samples (samples, points, 3)."""
        with self.path.open("r+b") as file:
            file.seek(_HEADER.size + 12 * self.points * self.samples)
            file.write(np.ascontiguousarray(positions, dtype="<f4").tobytes())
            file.flush()
            self.samples += len(positions)
            file.seek(0)
            file.write(_HEADER.pack(_MAGIC, 1, self.points, 0.0, 1.0, self.samples))


def read_new(path: Path, taken: int, points: int) -> np.ndarray:
    """Samples (samples, points, 3) float32 of a cache that are whole and were not taken yet.

    Args:
        path: the file, which may not be there yet.
        taken: samples that were read before.
        points: vertices that each has to have.

    Raises:
        ValueError: it moves another number of points.
    """
    none = np.zeros((0, points, 3), dtype=np.float32)
    if not path.is_file():
        return none
    with path.open("rb") as file:
        header = file.read(_HEADER.size)
        if len(header) < _HEADER.size:
            return none
        _, _, own_points, _, _, samples = _HEADER.unpack(header)
        if own_points != points:
            raise ValueError(f"{path.name} moves {own_points} vertices, and the mesh has {points}.")
        file.seek(_HEADER.size + 12 * points * taken)
        values = np.frombuffer(file.read(12 * points * max(samples - taken, 0)), dtype="<f4")
    return values.reshape(-1, points, 3)
