"""A motion that was recorded, performed by any body."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.errors import InputError
from pb4u.motion.arm_clearance import arms_swung_out
from pb4u.motion.humanoid import humanoid_of
from pb4u.motion.motion import Motion
from pb4u.motion.recording import Recording
from pb4u.motion.retargeting import Retargeting


class RecordedMotion(Motion):
    """A recording with an end; every body's retargeting is worked out once."""

    def __init__(self, recording: Recording, arms_away_degrees: float = 0.0) -> None:
        self.name = recording.name
        self.duration = recording.duration
        self.notes = recording.notes
        self.recording = recording
        self.arms_away_degrees = arms_away_degrees
        self._retargeting = lru_cache(maxsize=4)(self._retarget)

    def _retarget(self, body: ShapedBody) -> Retargeting:
        return Retargeting(self.recording, body)

    def poses(self, body: ShapedBody, fps: float, frames: int, start: int = 0) -> PoseSequence:
        if frames < 1 or start < 0 or not fps > 0:
            raise InputError(f"{self.name}: asked for {frames} frame(s) from frame {start} at {fps:g} fps.")
        available = self.available_frames(fps)
        if available is not None and start + frames > available:
            raise InputError(
                f"{self.name} ends after {available} frames at {fps:g} fps and {start + frames} were asked for; "
                f"ask for at most {max(available - start, 0)} from frame {start}, or crop less."
            )
        poses = self._retargeting(body).poses(np.arange(start, start + frames) / fps)
        poses = PoseSequence(poses.rotations, poses.root_positions, fps)
        if self.arms_away_degrees:
            poses = arms_swung_out(humanoid_of(body), poses, self.arms_away_degrees)
        return poses
