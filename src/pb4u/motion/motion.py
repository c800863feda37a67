"""What a simulation needs of a motion: poses of a given body at given times."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.errors import InputError
from pb4u.motion.arm_clearance import ArmClearance
from pb4u.motion.humanoid import humanoid_of


class Performed(NamedTuple):
    """Poses of a body that performs a motion.

    Args:
        poses: its poses.
        notes: plain sentences on differences between the performance and the motion (may be empty).
    """

    poses: PoseSequence
    notes: tuple[str, ...] = ()


class Motion(ABC):
    """A motion that any supported skeleton can perform.

    Args:
        name: as given by the user.
        duration: length [s]; None for a procedural clip, which has no end.
        notes: plain sentences on what was repaired or ignored while reading (may be empty).
        arms_away_degrees: angle by which hanging arms are swung outward, to keep them clear of loose garments. None: as
            in the motion; arms of a recording are swung out as far as they would enter the body.
    """

    def __init__(
        self, name: str, duration: float | None, notes: tuple[str, ...] = (), arms_away_degrees: float | None = None
    ) -> None:
        self.name = name
        self.duration = duration
        self.notes = notes
        self.arms_away_degrees = arms_away_degrees

    def poses(self, body: ShapedBody, fps: float, frames: int, start: int = 0) -> PoseSequence:
        """Poses of a body, see `perform`.

        Args:
            body: that performs.
            fps: frames per second.
            frames: number of frames.
            start: first frame.
        """
        return self.perform(body, fps, frames, start).poses

    def perform(self, body: ShapedBody, fps: float, frames: int, start: int = 0) -> Performed:
        """The performance of a body.

        Args:
            body: who performs.
            fps: frames per second.
            frames: number of frames.
            start: first frame, counted at `fps`.

        Raises:
            InputError: a number is out of range, or a recording ends before the last frame.
        """
        if frames < 1 or start < 0 or not fps > 0:
            raise InputError(f"{self.name}: {frames} frame(s) from frame {start} at {fps:g} fps do not exist.")
        available = self.available_frames(fps)
        if available is not None and start + frames > available:
            raise InputError(
                f"{self.name} ends after {available} frames at {fps:g} fps but {start + frames} are wanted; "
                f"ask for at most {max(available - start, 0)} from frame {start}, or crop less."
            )
        performed = self._perform(body, fps, np.arange(start, start + frames))
        if not self.arms_away_degrees:
            return performed
        swung = humanoid_of(body).arms_swung_out(performed.poses, self.arms_away_degrees)
        return performed._replace(poses=swung)

    def arm_clearance(self, body: ShapedBody) -> ArmClearance | None:
        """Allowed positions of arms that are swung out of the body; None if arms follow the motion.

        Args:
            body: who performs.
        """
        return None

    def available_frames(self, fps: float) -> int | None:
        """Number of frames at `fps` frames per second; None where the motion has no end.

        Args:
            fps: frames per second.
        """
        return None if self.duration is None else int(self.duration * fps + 1e-6) + 1

    @abstractmethod
    def _perform(self, body: ShapedBody, fps: float, frames: np.ndarray) -> Performed:
        """What `body` does at consecutive `frames` (frames,), counted at `fps`."""


class MotionAsRecorded(Motion):
    """A recording played unchanged, by a body of the recorded shape, with a lead-in of its own."""

    @property
    @abstractmethod
    def shape(self) -> dict[str, float]:
        """Shape parameters of the recorded body by name."""

    @abstractmethod
    def led_in(self, body: ShapedBody, fps: float, frames: int) -> PoseSequence:
        """The whole recording after lead-in frames.

        Args:
            body: the body that performs it.
            fps: frames per second [1/s].
            frames: number of lead-in frames.

        Raises:
            InputError: the body cannot perform it, or not at this rate.
        """
