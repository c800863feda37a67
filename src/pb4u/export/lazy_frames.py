"""Frames computed when they are touched, so that a long trajectory is never held whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np

Compute = Callable[[Any, Any], np.ndarray]
"""(index of frames, index of vertices) -> positions of those; an int as the first drops the frame axis."""

_ALL = slice(None)


class LazyFrames:
    """Stands where an array (frames, vertices, 3) float32 is expected and computes what is asked of it.

    `frames[t]`, `frames[a:b]`, `frames[:, vertices]` and iteration compute that part only;
    any other use goes through a full array.
    """

    def __init__(self, frames: int, vertices: int, compute: Compute) -> None:
        self.shape = (frames, vertices, 3)
        self.dtype = np.dtype(np.float32)
        self.ndim = 3
        self._compute = compute

    def as_array(self) -> np.ndarray:
        """Itself, for the type checker: everything that a trajectory is asked for, it answers."""
        return cast(np.ndarray, self)

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[t] for t in range(len(self)))

    def __getitem__(self, key: Any) -> np.ndarray:
        keys = key if isinstance(key, tuple) else (key,)
        if len(keys) > 2 or any(k is Ellipsis or k is None for k in keys):
            return np.asarray(self)[key]
        frames, vertices = (*keys, _ALL)[:2]
        if isinstance(frames, int | np.integer):
            if not -len(self) <= frames < len(self):
                raise IndexError(f"There is no frame {frames} in {len(self)}.")
            frames = int(frames) % len(self)
        return self._compute(frames, vertices)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self._compute(_ALL, _ALL), dtype=dtype)
