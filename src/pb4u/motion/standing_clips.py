"""Clips on planted feet: raising the arms, twisting the trunk, squatting, jumping."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from pb4u.motion.curves import bump, ease, hermite, keyframes, wave
from pb4u.motion.footwork import FootShape
from pb4u.motion.humanoid import Humanoid
from pb4u.motion.performance import FULL_STRETCH, Arm, Foot, Performance, Turn

# Of the person who jumps [m/s^2]: a clip is a human movement on Earth, whatever the gravity of the scene is.
_GRAVITY = 9.81


class StandingClip(ABC):
    """A clip that starts with both feet on the ground, side by side.

    Args:
        humanoid: the body.
        amplitude: size of the movement relative to the original, which is 1.
    """

    HALF_WIDTH = 0.15
    """From the middle to each ankle, as a share of the leg length."""
    TOES_OUT = 0.0
    """How far the feet are turned outward from rest [deg]."""

    def __init__(self, humanoid: Humanoid, amplitude: float = 1.0) -> None:
        self.amplitude = amplitude
        self.leg = humanoid.leg_length
        self.shapes = {side: FootShape.of(humanoid, side) for side in "LR"}
        # The middle of the hips is over the middle of the feet, between heel and ball.
        shape = self.shapes["L"]
        width, self.forward = self.HALF_WIDTH * self.leg, -0.5 * float(shape.heel[2] + shape.ball[2])
        self.places = {side: np.array([sign * width, 0.0, self.forward]) for side, sign in (("L", 1.0), ("R", -1.0))}
        hip = humanoid.joint("thigh.L") - humanoid.hip_midpoint
        level = np.hypot(width - hip[0], self.forward - hip[2])
        # Knees are never quite straight in a relaxed stance.
        reach = (FULL_STRETCH - 0.003) * self.leg
        self.height = float(shape.ankle[1] + np.sqrt(reach**2 - level**2) - hip[1])

    @abstractmethod
    def __call__(self, time: np.ndarray) -> Performance:
        """The performance at `time` (frames,) [s]."""

    def feet(self, frames: int, pitch: np.ndarray | float = 0.0, lift: np.ndarray | float = 0.0) -> dict[str, Foot]:
        """Positions and rotations of both feet in place, by side; toes stay flat.

        Args:
            frames: number of frames.
            pitch: (frames,) how far they are rolled over the ball [deg].
            lift: (frames,) how far they are lifted [m].
        """
        pitch, lift = np.broadcast_to(pitch, (frames,)), np.broadcast_to(lift, (frames,))
        free = ease(lift / (0.05 * self.leg))
        result = {}
        for side, sign in (("L", 1.0), ("R", -1.0)):
            place = self.places[side] + lift[:, None] * np.array([0.0, 1.0, 0.0])
            yaw = np.full(frames, sign * self.TOES_OUT)
            result[side] = self.shapes[side].foot(place, yaw, pitch, 0.5 * pitch * free)
        return result

    def hips(self, x: np.ndarray | float, y: np.ndarray | float, z: np.ndarray | float, frames: int) -> np.ndarray:
        """Positions of the middle of the hips, from offsets from standing; an offset may be one number.

        Args:
            x: (frames,) offset to the left [leg lengths].
            y: (frames,) offset upward [leg lengths].
            z: (frames,) offset to the front [leg lengths].
            frames: number of frames.

        Returns:
            (frames, 3) [m].
        """
        path = [np.broadcast_to(np.asarray(a, dtype=np.float64), (frames,)) for a in (x, y, z)]
        return self.leg * np.stack(path, axis=1) + np.array([0.0, self.height, 0.0])


class ArmRaises(StandingClip):
    """Arms are lifted to the sides and overhead, to the front, and swept across the chest."""

    PERIOD = 8.8
    """Length of one repetition [s]."""
    _KNOTS = (0.0, 0.09, 0.18, 0.28, 0.36, 0.46, 0.54, 0.64, 0.74, 0.84, 0.93)

    def __call__(self, time: np.ndarray) -> Performance:
        phase, a, frames = time / self.PERIOD, min(self.amplitude, 1.1), len(time)
        #        hang  side  over  side  hang  front  over  front wide  cross hang
        lift = (14.0, 88.0, 158.0, 90.0, 15.0, 16.0, 16.0, 16.0, 84.0, 62.0, 17.0)
        forward = (0.0, 0.0, 0.0, 0.0, 0.0, 86.0, 150.0, 88.0, 8.0, 24.0, 8.0)
        sweep = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 8.0, -58.0, 0.0)
        elbow = (18.0, 8.0, 14.0, 8.0, 20.0, 8.0, 14.0, 10.0, 10.0, 60.0, 24.0)
        twist = (4.0, -12.0, -30.0, -10.0, 4.0, 6.0, 0.0, 4.0, -8.0, 10.0, 6.0)
        arms = {}
        for side, delay in (("L", 0.0), ("R", 0.012)):
            p = phase - delay
            arms[side] = Arm(
                flexion=a * keyframes(p, self._KNOTS, forward),
                abduction=14.0 + a * (keyframes(p, self._KNOTS, lift) - 14.0),
                sweep=keyframes(p, self._KNOTS, sweep),
                elbow=keyframes(p, self._KNOTS, elbow),
                twist=keyframes(p, self._KNOTS, twist),
                pronation=30.0,
            )
        raised = bump((np.mod(phase, 1.0) - 0.05) / 0.28) + bump((np.mod(phase, 1.0) - 0.40) / 0.26)
        sway = wave(2 * phase, 0.2)
        return Performance(
            hips=self.hips(0.012 * sway, -0.006 + 0.002 * wave(4 * phase), -0.015 * raised, frames),
            pelvis=Turn(roll=0.8 * sway, pitch=-1.5 * raised),
            chest=Turn(pitch=-4.0 * raised + 1.0, roll=-1.2 * sway, yaw=2.0 * wave(phase, 0.8)),
            head=Turn(pitch=-7.0 * raised, yaw=3.0 * wave(phase, 0.3)),
            arms=arms,
            feet=self.feet(frames),
        )


class TrunkTwist(StandingClip):
    """The trunk turns from side to side, arms swinging out with it."""

    PERIOD = 2.9
    """Length of one repetition [s]."""
    HALF_WIDTH = 0.20
    TOES_OUT = 4.0

    def __call__(self, time: np.ndarray) -> Performance:
        phase, a, frames = time / self.PERIOD, self.amplitude, len(time)
        turn, late = wave(phase), wave(phase, 0.07)
        arms = {}
        for side, sign in (("L", 1.0), ("R", -1.0)):
            # The arm on the side turned to trails behind the back, the other one comes across the front.
            across = -sign * late
            arms[side] = Arm(
                flexion=22.0 + 16.0 * across,
                abduction=46.0 + 5.0 * wave(2 * phase),
                sweep=-26.0 * a * across,
                elbow=34.0 + 16.0 * across,
                twist=10.0 + 12.0 * across,
            )
        return Performance(
            hips=self.hips(0.03 * turn, -0.018 - 0.006 * wave(2 * phase), 0.0, frames),
            pelvis=Turn(yaw=13.0 * a * turn, pitch=2.0),
            chest=Turn(yaw=34.0 * a * wave(phase, 0.03), pitch=3.0, roll=2.0 * turn),
            head=Turn(yaw=12.0 * a * wave(phase, 0.05), pitch=-3.0),
            arms=arms,
            feet=self.feet(frames),
        )


class Squat(StandingClip):
    """Knees bend until the thighs are near level, arms reaching forward for balance, and up again."""

    PERIOD = 3.4
    """Length of one repetition [s]."""
    HALF_WIDTH = 0.22
    TOES_OUT = 12.0

    def __call__(self, time: np.ndarray) -> Performance:
        phase, a, frames = np.mod(time / self.PERIOD, 1.0), min(self.amplitude, 1.05), len(time)
        deep = hermite(phase, [0.0, 0.08, 0.45, 0.54, 0.90, 1.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]) * a
        reach = hermite(phase, [0.0, 0.04, 0.42, 0.56, 0.94, 1.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]) * a
        arm = Arm(flexion=4.0 + 108.0 * reach, abduction=15.0 + 2.0 * reach, elbow=16.0 + 4.0 * reach, twist=6.0)
        return Performance(
            hips=self.hips(0.0, -0.46 * deep, -0.19 * deep, frames),
            pelvis=Turn(pitch=30.0 * deep),
            chest=Turn(pitch=10.0 * deep + 1.0),
            head=Turn(pitch=-27.0 * deep),
            arms={"L": arm, "R": arm},
            feet=self.feet(frames),
        )


class Jump(StandingClip):
    """A jump on the spot: crouch and swing the arms back, take off, land softly, stand up."""

    PERIOD = 2.5
    """Length of one repetition [s]."""
    FLIGHT = 0.44
    HALF_WIDTH = 0.16
    TOES_OUT = 3.0

    def __call__(self, time: np.ndarray) -> Performance:
        t, frames, leg = np.mod(time, self.PERIOD), len(time), self.leg
        flight = self.FLIGHT * np.sqrt(self.amplitude)
        crouch, off = 0.64, 0.92
        land = off + flight
        low, up = land + 0.24, land + 0.85
        # Hips in metres: a parabola in flight, joined with its velocity and acceleration.
        speed = 0.5 * _GRAVITY * flight
        tall = 0.012 * leg
        y = hermite(
            t,
            [0.0, 0.12, crouch, off, land, low, up, self.PERIOD],
            [0.0, 0.0, -0.27 * leg, tall, tall - 0.02 * leg, -0.22 * leg, 0.0, 0.0],
            [0.0, 0.0, 0.0, speed, -speed, 0.0, 0.0, 0.0],
            [0.0, 0.0, 6.0, -_GRAVITY, -_GRAVITY, 6.0, 0.0, 0.0],
        )
        bent = hermite(t, [0.0, 0.12, crouch, off, land, low, up], [0.0, 0.0, 1.0, 0.0, 0.12, 0.75, 0.0])
        pitch = hermite(
            t,
            [0.0, crouch + 0.04, off, off + 0.5 * flight, land, land + 0.13],
            [0.0, 0.0, 52.0, 40.0, 26.0, 0.0],
            [0.0, 0.0, 120.0, -50.0, -120.0, 0.0],
        )
        s = (t - off) / flight
        # The feet follow the hips up a little less, so that the legs are drawn up towards landing.
        rise = 0.5 * _GRAVITY * (t - off) * (land - t) * ease(s / 0.3) * ease((1.0 - s) / 0.3)
        lift = np.where((s > 0.0) & (s < 1.0), rise + 0.03 * leg * bump(s, 0.6), 0.0)
        arm = Arm(
            flexion=hermite(
                t, [0.0, 0.08, crouch - 0.1, off + 0.18, land + 0.06, low + 0.2, up + 0.2],
                [0.0, 0.0, -34.0, 112.0, 78.0, 22.0, 0.0], [0.0, 0.0, 0.0, 0.0, -160.0, -60.0, 0.0],
            ),
            abduction=hermite(t, [0.0, crouch, off, land, up], [14.0, 17.0, 16.0, 26.0, 14.0]),
            elbow=hermite(t, [0.0, crouch, off, land, low, up], [16.0, 14.0, 38.0, 34.0, 40.0, 16.0]),
            twist=6.0,
        )  # fmt: skip
        return Performance(
            hips=self.hips(0.0, y / leg, -0.09 * bent + 0.02 * bump(s), frames),
            pelvis=Turn(pitch=26.0 * bent),
            chest=Turn(pitch=14.0 * bent - 4.0 * bump((t - off + 0.1) / (flight + 0.1))),
            head=Turn(pitch=-26.0 * bent),
            arms={"L": arm, "R": arm},
            feet=self.feet(frames, pitch, lift),
        )
