"""The built-in clips: motions that are functions of time, without files and without an end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.errors import refuse_unknown
from pb4u.motion.gait import RUN, WALK, Gaiting
from pb4u.motion.humanoid import Humanoid, humanoid_of
from pb4u.motion.motion import Motion, Performed
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


# How far a seed may change the tempo and the amplitude of a clip: seen, and still the same human movement.
_TEMPO_SPREAD, _AMPLITUDE_SPREAD = 0.06, 0.12


class ProceduralMotion(Motion):
    """A built-in clip; the same seed gives the same motion, seed 0 the unvaried one.

    Args:
        name: one of `CLIPS`.
        seed: varies tempo and amplitude a little.
        arms_away_degrees: see `Motion`.

    Raises:
        InputError: there is no such clip.
    """

    def __init__(self, name: str, seed: int = 0, arms_away_degrees: float | None = None) -> None:
        refuse_unknown("built-in motion", [name], CLIPS)
        super().__init__(name, None, arms_away_degrees=arms_away_degrees)
        self.seed = seed
        draw = np.random.default_rng(seed).uniform(-1.0, 1.0, 2) if seed else np.zeros(2)
        self.tempo = 1.0 + _TEMPO_SPREAD * float(draw[0])
        self.amplitude = 1.0 + _AMPLITUDE_SPREAD * float(draw[1])
        self._fitted = lru_cache(maxsize=4)(self._fit)

    def _fit(self, body: ShapedBody) -> Clip:
        return CLIPS[self.name](humanoid_of(body), self.amplitude)

    def _perform(self, body: ShapedBody, fps: float, frames: np.ndarray) -> Performed:
        return Performed(poses_of(self._fitted(body)(self.tempo * frames / fps), humanoid_of(body), fps))
