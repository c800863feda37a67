"""What a simulation needs of a motion: poses of a given body at given times."""

from __future__ import annotations

from abc import ABC, abstractmethod

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence


class Motion(ABC):
    """A motion that any supported skeleton can perform.

    Attributes:
        name: what the user called it.
        duration: length [s]; None for a procedural clip, which has no end.
        notes: plain sentences on what was repaired or ignored while reading (may be empty).
    """

    name: str
    duration: float | None
    notes: tuple[str, ...] = ()

    @abstractmethod
    def poses(self, body: ShapedBody, fps: float, frames: int, start: int = 0) -> PoseSequence:
        """Poses of `body` for frames start..start+frames-1 at `fps`.

        Raises InputError when a recording ends before the last frame asked for.
        """

    def available_frames(self, fps: float) -> int | None:
        """How many frames there are at `fps`; None where the motion has no end."""
        return None if self.duration is None else int(self.duration * fps + 1e-6) + 1
