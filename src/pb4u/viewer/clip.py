"""What a page plays: the frames of garments on a body, all there from the start or still coming."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from pb4u.errors import InputWarning
from pb4u.export.finite_frames import held_frames, hold_finite
from pb4u.export.registry import WRITERS
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader


class Clip:
    """A sequence of frames to show, all finite.

    Args:
        label: what the page calls it.
        simulated: the simulated frames.
        shown: the same frames, with frames that are not finite replaced by finite ones (`hold_finite`).
    """

    def __init__(self, label: str, simulated: Trajectory, shown: Trajectory) -> None:
        self.label = label
        self._simulated, self._shown = simulated, shown

    @property
    def header(self) -> TrajectoryHeader:
        """Header of the trajectory: all data that do not change from frame to frame."""
        return self._simulated.header

    @property
    def held(self) -> frozenset[int]:
        """Frames that repeat an earlier one because their own values are not finite."""
        return frozenset(held_frames(self._shown))

    @property
    def frame_count(self) -> int:
        """Number of frames that are there now."""
        return self._shown.frame_count

    @property
    def file_stem(self) -> str:
        """Name of its files, without suffix."""
        name = Path(self.label)
        stem = name.stem if name.suffix.lower() in WRITERS else self.label
        return re.sub(r"\W+", "_", stem).strip("_") or "garment"

    def garment(self, t: int) -> np.ndarray:
        """Vertices (vertices, 3) float32 [m] of all garments at frame t.

        Args:
            t: number of the frame.
        """
        return np.asarray(self._shown.positions[t], dtype=np.float32)

    def body(self, t: int) -> np.ndarray:
        """Vertices (body vertices, 3) float32 [m] of the body at frame t.

        Args:
            t: number of the frame.
        """
        return np.asarray(self._shown.body_positions[t], dtype=np.float32)

    def trajectory(self) -> Trajectory:
        """The simulated frames so far, for measuring and exporting."""
        return self._simulated


class RecordedClip(Clip):
    """A trajectory from a file or from memory; frames that are not finite show the one before them.

    Args:
        trajectory: all frames.
        label: what the page calls it.

    Raises:
        InputError: no frame is finite.
    """

    def __init__(self, trajectory: Trajectory, label: str) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            super().__init__(label, trajectory, hold_finite(trajectory))


class GrowingClip(Clip):
    """Frames of a simulation that is running.

    Args:
        header: what does not change.
        capacity: frames there will be at most.
        label: what the page calls it.
        before: clip with whose frames it begins.
        count: number of these frames.
    """

    def __init__(
        self,
        header: TrajectoryHeader,
        capacity: int,
        label: str,
        before: GrowingClip | None = None,
        count: int = 0,
    ) -> None:
        # Memory is taken up by the system as it is written to, so room for all frames costs nothing yet.
        garment, body = (
            np.empty((capacity, vertices, 3), dtype=np.float32)
            for vertices in (len(header.rest_positions), len(header.body_contact))
        )
        room = Trajectory(header, garment, np.empty_like(garment), body)
        super().__init__(label, room, room)
        self._count = count
        self._notes: tuple[str, ...] = () if before is None else before._notes
        for values, old_values in zip(self._values, () if before is None else before._values, strict=False):
            values[:count] = old_values[:count]

    def until(self, count: int, header: TrajectoryHeader | None = None) -> GrowingClip:
        """A new clip that begins with the first frames of this one, which does not change.

        Args:
            count: number of these frames.
            header: of its cloth, on the same mesh; by default that of this one.
        """
        return GrowingClip(header or self.header, len(self._shown.positions), self.label, self, count)

    def note(self, sentence: str) -> None:
        """Record in the metadata, once, an action on the cloth.

        Args:
            sentence: description of the action.
        """
        self._notes = tuple(dict.fromkeys((*self._notes, sentence)))

    @property
    def _values(self) -> tuple[np.ndarray, ...]:
        return self._shown.positions, self._shown.velocities, self._shown.body_positions

    def append(self, frame: Frame) -> None:
        """Add the next frame; from one thread only.

        Args:
            frame: the next frame.
        """
        self._shown.positions[self._count] = frame.positions
        self._shown.velocities[self._count] = frame.velocities
        self._shown.body_positions[self._count] = frame.body_positions
        # Last, so that a reader in another thread never sees a frame before it is whole.
        self._count += 1

    @property
    def frame_count(self) -> int:
        return self._count

    def trajectory(self) -> Trajectory:
        count, header = self._count, self.header
        trajectory = self._shown.with_frames(lambda values: values[:count], header.fps)
        if not self._notes:
            return trajectory
        notes = [*header.metadata.get("notes", ()), *self._notes]
        return replace(trajectory, header=header.with_metadata(notes=notes))


def middle(body: np.ndarray) -> np.ndarray:
    """(3,) [m] the point of the ground below the middle of a body.

    Args:
        body: (vertices, 3) [m].
    """
    centre = np.median(body, axis=0)
    return np.array([centre[0], 0.0, centre[2]])
