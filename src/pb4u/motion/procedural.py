"""The built-in clips: motions that are functions of time, without files and without an end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.errors import InputError
from pb4u.motion.arm_clearance import arms_swung_out
from pb4u.motion.gait import RUN, WALK, Gaiting
from pb4u.motion.humanoid import Humanoid, humanoid_of
from pb4u.motion.motion import Motion
from pb4u.motion.performance import Performance, poses_of
from pb4u.motion.standing_clips import ArmRaises, Jump, Squat, TrunkTwist
from pb4u.motion.stepping_clips import Dance, SpotTurn

# A clip fitted to a body: time (frames,) [s] -> what the body does.
Clip = Callable[[np.ndarray], Performance]

CLIPS: Mapping[str, Callable[[Humanoid, float], Clip]] = {
    "walk": lambda humanoid, amplitude: Gaiting(WALK, humanoid, amplitude),
    "run": lambda humanoid, amplitude: Gaiting(RUN, humanoid, amplitude),
    "jump": Jump,
    "arms": ArmRaises,
    "twist": TrunkTwist,
    "squat": Squat,
    "turn": SpotTurn,
    "dance": Dance,
}


DESCRIPTIONS: Mapping[str, str] = {
    "walk": "Walking straight ahead at about 1.3 m/s.",
    "run": "Jogging straight ahead at about 2.8 m/s, both feet off the ground between steps.",
    "jump": "Jumps on the spot with a crouch, swinging arms and a soft landing.",
    "arms": "Arms lifted sideways and overhead, to the front, and swept across the chest.",
    "twist": "The trunk turning from side to side with the arms swinging out.",
    "squat": "Deep knee bends with the arms reaching forward.",
    "turn": "Turning on the spot with small steps, a full turn in about five seconds.",
    "dance": "Side steps with swaying hips and wide arms, sixteen beats long.",
}


class ProceduralMotion(Motion):
    """A built-in clip; the same seed gives the same motion, seed 0 the plain one."""

    def __init__(self, name: str, seed: int = 0, arms_away_degrees: float = 0.0) -> None:
        if name not in CLIPS:
            raise InputError(f'There is no built-in motion "{name}"; there are {", ".join(CLIPS)}.')
        self.name = name
        self.duration = None
        self.seed = seed
        self.arms_away_degrees = arms_away_degrees
        draw = np.random.default_rng(seed).uniform(-1.0, 1.0, 2) if seed else np.zeros(2)
        self.tempo = 1.0 + 0.06 * float(draw[0])
        self.amplitude = 1.0 + 0.12 * float(draw[1])
        self._fitted = lru_cache(maxsize=4)(self._fit)

    def _fit(self, body: ShapedBody) -> Clip:
        return CLIPS[self.name](humanoid_of(body), self.amplitude)

    def poses(self, body: ShapedBody, fps: float, frames: int, start: int = 0) -> PoseSequence:
        if frames < 1 or start < 0 or not fps > 0:
            raise InputError(f"{self.name}: asked for {frames} frame(s) from frame {start} at {fps:g} fps.")
        humanoid = humanoid_of(body)
        performance = self._fitted(body)(self.tempo * np.arange(start, start + frames) / fps)
        poses = poses_of(performance, humanoid, fps)
        if self.arms_away_degrees:
            poses = arms_swung_out(humanoid, poses, self.arms_away_degrees)
        return poses
