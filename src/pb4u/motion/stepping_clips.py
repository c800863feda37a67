"""Clips that step about: turning on the spot and dancing."""

from __future__ import annotations

import numpy as np

from pb4u.geometry.rotation import rotate
from pb4u.motion.curves import keyframes, wave
from pb4u.motion.footwork import Step, stepping_foot
from pb4u.motion.humanoid import Humanoid
from pb4u.motion.performance import Arm, Performance, Turn, about
from pb4u.motion.standing_clips import StandingClip


class SpotTurn(StandingClip):
    """Turning to the left on the spot, stepping with one foot after the other, arms lifted by the turn.

    Args:
        humanoid: the body.
        amplitude: size of the movement relative to the original, which is 1.
    """

    PERIOD = 1.2
    TURN = 84.0
    HALF_WIDTH = 0.13

    def __init__(self, humanoid: Humanoid, amplitude: float = 1.0) -> None:
        super().__init__(humanoid, amplitude)
        half, forward = self.HALF_WIDTH * self.leg, self.forward
        turn = self.TURN * amplitude
        self.turn = turn
        # Each foot is planted turned half way ahead of the body, and left when the body has turned past it.
        self.steps = {
            "L": self._step(0.04, 0.40, half, forward, 0.62 * turn),
            "R": self._step(0.54, 0.90, -half, forward, 1.10 * turn),
        }

    @staticmethod
    def _step(start: float, stop: float, x: float, z: float, yaw: float) -> Step:
        angle = np.deg2rad(yaw)
        return Step(
            start, stop, x * np.cos(angle) + z * np.sin(angle), z * np.cos(angle) - x * np.sin(angle), yaw, height=0.06
        )

    def __call__(self, time: np.ndarray) -> Performance:
        cycles, frames = time / self.PERIOD, len(time)
        yaw = self.turn * (cycles + 0.035 * np.sin(4.0 * np.pi * (cycles - 0.1)))
        # Weight is on the standing foot: right while the left one steps.
        sway = -wave(cycles, 0.22)
        hips = self.hips(0.035 * sway, -0.022 - 0.006 * wave(2 * cycles, 0.22), 0.0, frames)
        turned = about("y", yaw, frames)
        shapes = self.shapes
        feet = {side: stepping_foot(shapes[side], cycles, [step], self.turn) for side, step in self.steps.items()}
        arms = {
            side: Arm(
                flexion=6.0 + 5.0 * wave(cycles, 0.1 if side == "L" else 0.6),
                abduction=27.0 + 3.0 * wave(2 * cycles, 0.3),
                sweep=12.0 * sign,
                elbow=26.0,
                twist=2.0,
            )
            for side, sign in (("L", 1.0), ("R", -1.0))
        }
        return Performance(
            hips=rotate(turned, hips),
            pelvis=Turn(yaw=yaw, roll=-2.5 * sway, pitch=1.5),
            chest=Turn(yaw=8.0 + 2.0 * wave(2 * cycles, 0.3), roll=2.0 * sway, pitch=1.0),
            head=Turn(yaw=16.0 + 4.0 * wave(2 * cycles, 0.3), pitch=2.0),
            arms=arms,
            feet=feet,
        )


class Dance(StandingClip):
    """Side steps on the beat with swaying hips and arms that sweep wide, overhead and across, over sixteen beats.

    Args:
        humanoid: the body.
        amplitude: size of the movement relative to the original, which is 1.
    """

    BEAT = 0.52
    BEATS = 16
    HALF_WIDTH = 0.14
    TOES_OUT = 4.0

    def __init__(self, humanoid: Humanoid, amplitude: float = 1.0) -> None:
        super().__init__(humanoid, amplitude)
        leg = self.leg
        forward = self.forward
        near, stride, beat = self.HALF_WIDTH * leg, 0.28 * leg, 1.0 / self.BEATS
        # Four beats to the left and four to the right, twice: step, together, step, together.
        self.steps: dict[str, list[Step]] = {"L": [], "R": []}
        for bar in range(4):
            direction = 1.0 if bar % 2 == 0 else -1.0
            leading, following = ("L", "R") if direction > 0 else ("R", "L")
            begin = 0.0 if direction > 0 else 2.0 * stride
            for k in range(2):
                middle = begin + direction * (k + 1) * stride
                for foot, sign, late in ((leading, direction, 0.0), (following, -direction, 1.0)):
                    start = 0.25 * bar + (2 * k + late + 0.12) * beat
                    self.steps[foot].append(Step(start, start + 0.83 * beat, middle + sign * near, forward, sign * 6.0))

    def __call__(self, time: np.ndarray) -> Performance:
        beats = time / self.BEAT
        cycles, a, frames = beats / self.BEATS, self.amplitude, len(time)
        leg = self.leg
        feet = {side: stepping_foot(self.shapes[side], cycles, steps) for side, steps in self.steps.items()}
        # Hips travel over the feet, a little late, and sway to the side that is stepped to.
        middle = 0.5 * (feet["L"].ankle[:, 0] + feet["R"].ankle[:, 0])
        sway = wave(beats / 2, 0.45) * wave(cycles * 2, 0.125)
        side_to_side = np.sin(2.0 * np.pi * (beats / 2.0 - 0.1))
        path = self.hips(0.0, -0.048 - 0.016 * a * wave(beats, 0.3), 0.012 * wave(beats / 2), frames)
        path[:, 0] += middle + 0.02 * leg * a * side_to_side
        knots = tuple(k / 16 for k in range(16))
        up = (20, 60, 120, 150, 110, 40, 25, 70, 130, 140, 90, 45, 30, 80, 70, 30)
        forward = (10, 5, 0, 0, 10, 40, 60, 30, 0, 0, 15, 40, 55, 20, 0, 10)
        sweep = (0, 8, 10, 0, -20, -35, -20, 0, 10, 5, -15, -40, -25, 8, 12, 0)
        elbow = (50, 25, 25, 45, 60, 75, 55, 25, 25, 50, 65, 80, 50, 20, 25, 55)
        arms = {}
        for side, delay in (("L", 0.0), ("R", 2.0 / 16.0)):
            p = cycles - delay
            arms[side] = Arm(
                flexion=keyframes(p, knots, forward),
                abduction=12.0 + a * (keyframes(p, knots, up) - 12.0),
                sweep=keyframes(p, knots, sweep),
                elbow=np.maximum(keyframes(p, knots, elbow), 5.0),
                twist=-8.0 + 8.0 * wave(beats / 4),
                wrist=8.0 * wave(beats / 2, 0.2),
            )
        yaw = 16.0 * a * keyframes(cycles, knots[::2], (0, 1.0, 0.6, -0.4, -1.0, -0.5, 0.3, 0.2))
        return Performance(
            hips=path,
            pelvis=Turn(
                yaw=yaw + 5.0 * a * wave(beats / 2, 0.2), roll=6.0 * a * side_to_side, pitch=2.0 + 1.5 * wave(beats)
            ),
            chest=Turn(
                yaw=-9.0 * a * wave(beats / 2, 0.3) + 0.4 * yaw,
                roll=-8.0 * a * side_to_side + 4.0 * sway,
                pitch=3.0 + 2.5 * wave(beats, 0.4),
            ),
            head=Turn(yaw=-0.5 * yaw, roll=-3.0 * side_to_side, pitch=-3.0 + 2.0 * wave(beats, 0.5)),
            arms=arms,
            feet=feet,
        )
