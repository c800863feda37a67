"""A skeleton at rest, and sequences of poses of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bones of a body in its rest pose.

    Every pose is written as world rotations *from rest*: the identity is the rest pose whatever frames a file used,
    so no local bone axes are needed anywhere downstream of a loader.

    Args:
        names: bone names, parents before children; the root is first.
        parents: (bones,) int64 index of each parent, -1 for the root.
        joints: (bones, 3) float64 rest position of each bone's head [m], world axes (Y up, facing +Z).
    """

    names: tuple[str, ...]
    parents: np.ndarray
    joints: np.ndarray

    def index(self, name: str) -> int:
        """Index of the bone called `name`. Raises ValueError when there is none."""
        return self.names.index(name)

    @property
    def bone_count(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class PoseSequence:
    """Poses of one skeleton over time.

    Args:
        rotations: (frames, bones, 4) float64 unit quaternions wxyz: world rotation of each bone from rest.
        root_positions: (frames, 3) float64 world position of the root joint [m].
        fps: frames per second.
    """

    rotations: np.ndarray
    root_positions: np.ndarray
    fps: float

    def __len__(self) -> int:
        return len(self.rotations)
