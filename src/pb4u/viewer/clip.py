"""What a page plays: the frames of one garment on one body, all there from the start or still coming."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod

import numpy as np

from pb4u.errors import InputWarning
from pb4u.export.finite_frames import held_frames, hold_finite
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader


class Clip(ABC):
    """Frames to show, every one of them finite.

    Attributes:
        label: what the page calls it.
        held: frames that stand still because their own values are not finite.
    """

    label: str
    held: frozenset[int] = frozenset()

    @property
    @abstractmethod
    def header(self) -> TrajectoryHeader:
        """What does not change from frame to frame."""

    @property
    @abstractmethod
    def frame_count(self) -> int:
        """Frames that are there now."""

    @abstractmethod
    def garment(self, t: int) -> np.ndarray:
        """(vertices, 3) float32 [m]."""

    @abstractmethod
    def body(self, t: int) -> np.ndarray:
        """(body vertices, 3) float32 [m]."""

    @abstractmethod
    def trajectory(self) -> Trajectory:
        """The frames that are there now, as they were simulated: for measuring and exporting."""


class RecordedClip(Clip):
    """A trajectory from a file or from memory; frames that are not finite show the one before them.

    Raises InputError when no frame is finite.
    """

    def __init__(self, trajectory: Trajectory, label: str) -> None:
        self.label = label
        self._simulated = trajectory
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            self._shown = hold_finite(trajectory)
        self.held = frozenset(held_frames(self._shown))

    @property
    def header(self) -> TrajectoryHeader:
        return self._simulated.header

    @property
    def frame_count(self) -> int:
        return self._shown.frame_count

    def garment(self, t: int) -> np.ndarray:
        return np.asarray(self._shown.positions[t], dtype=np.float32)

    def body(self, t: int) -> np.ndarray:
        return np.asarray(self._shown.body_positions[t], dtype=np.float32)

    def trajectory(self) -> Trajectory:
        return self._simulated


class GrowingClip(Clip):
    """Frames of a simulation that is running.

    Args:
        header: what does not change.
        capacity: frames there will be at most.
        label: what the page calls it.
    """

    def __init__(self, header: TrajectoryHeader, capacity: int, label: str) -> None:
        self.label = label
        self._header = header
        self._count = 0
        # Memory is taken up by the system as it is written to, so room for all frames costs nothing yet.
        self._positions = np.empty((capacity, len(header.rest_positions), 3), dtype=np.float32)
        self._velocities = np.empty_like(self._positions)
        self._bodies = np.empty((capacity, len(header.body_contact), 3), dtype=np.float32)

    def append(self, frame: Frame) -> None:
        """Take in the next frame."""
        self._positions[self._count] = frame.positions
        self._velocities[self._count] = frame.velocities
        self._bodies[self._count] = frame.body_positions
        # Last, so that a reader in another thread never sees a frame before it is whole.
        self._count += 1

    @property
    def header(self) -> TrajectoryHeader:
        return self._header

    @property
    def frame_count(self) -> int:
        return self._count

    def garment(self, t: int) -> np.ndarray:
        return self._positions[t]

    def body(self, t: int) -> np.ndarray:
        return self._bodies[t]

    def trajectory(self) -> Trajectory:
        count = self._count
        return Trajectory(self._header, self._positions[:count], self._velocities[:count], self._bodies[:count])
