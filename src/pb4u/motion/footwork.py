"""Feet that stand, roll and step without sliding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.geometry.rotation import multiply, rotate
from pb4u.motion.curves import bump, ease
from pb4u.motion.humanoid import Humanoid
from pb4u.motion.performance import Foot, about


@dataclass(frozen=True, eq=False)
class FootShape:
    """Points that a foot rolls over, relative to its ankle when it stands flat at rest [m].

    Args:
        ankle: (3,) rest position of the ankle [m].
        heel: (3,) the point on the ground under the back of the heel [m].
        ball: (3,) the joint between foot and toes [m].
    """

    ankle: np.ndarray
    heel: np.ndarray
    ball: np.ndarray

    @classmethod
    def of(cls, humanoid: Humanoid, side: str) -> FootShape:
        body = humanoid.body
        ankle, toes = humanoid.joint(f"foot.{side}"), humanoid.joint(f"toes.{side}")
        near = (np.abs(body.vertices[:, 0] - ankle[0]) < 0.1) & (body.vertices[:, 1] < 0.5 * ankle[1])
        sole = body.vertices[near & (np.sign(body.vertices[:, 0]) == np.sign(ankle[0]))]
        back = float(sole[:, 2].min()) if len(sole) else float(ankle[2])
        # A heel is round: it rolls on a point a little before its back.
        heel = np.array([ankle[0], 0.0, back + 0.25 * (ankle[2] - back)])
        return cls(ankle, heel - ankle, toes - ankle)

    def rolled(self, pitch: np.ndarray) -> np.ndarray:
        """Displacement of the ankle from its position with a flat foot, when the foot rolls on the ground.

        Args:
            pitch: (frames,) roll [deg], heel up positive.

        Returns:
            (frames, 3) [m].
        """
        rotation = about("x", pitch, len(pitch))
        pivot = np.where(pitch[:, None] > 0.0, self.ball, self.heel)
        return pivot - rotate(rotation, pivot)

    def foot(self, place: np.ndarray, yaw: np.ndarray, pitch: np.ndarray, toe_pitch: np.ndarray) -> Foot:
        """Positions and rotations over time of a foot that rolls on the ground at a given place.

        Args:
            place: (frames, 3) position of the ankle [m] when the foot is flat; y counts from its height at rest.
            yaw: (frames,) turn of the foot [deg].
            pitch: (frames,) roll over the ball (heel up, positive) or over the heel (toes up, negative) [deg].
            toe_pitch: (frames,) pitch of the toes in the world [deg].
        """
        frames = len(pitch)
        turned = about("y", yaw, frames)
        ankle = place + np.array([0.0, self.ankle[1], 0.0]) + rotate(turned, self.rolled(pitch))
        return Foot(ankle, multiply(turned, about("x", pitch, frames)), multiply(turned, about("x", toe_pitch, frames)))


@dataclass(frozen=True)
class Step:
    """One step of a foot within a repeated cycle.

    Args:
        start: phase at which the foot leaves the ground.
        stop: phase at which it is down again, below 1.
        x: lateral position where it lands, positive to the left [m].
        z: where it lands, to the front [m].
        yaw: heading of the foot there [deg].
        height: largest height of the ankle above its start [m].
    """

    start: float
    stop: float
    x: float
    z: float
    yaw: float = 0.0
    height: float = 0.07


def stepping_foot(shape: FootShape, cycles: np.ndarray, steps: list[Step], turn_per_cycle: float = 0.0) -> Foot:
    """A foot that stands between the steps of a cycle and rolls off and on at each of them.

    Args:
        shape: the foot.
        cycles: (frames,) time counted in cycles.
        steps: the steps of one cycle in order; the last one lands where the cycle begins.
        turn_per_cycle: how far the whole cycle has turned about the origin when it repeats [deg].
    """
    number, phase = np.floor(cycles), np.mod(cycles, 1.0)
    last = steps[-1]
    x = np.full(len(cycles), last.x)
    z = np.full(len(cycles), last.z)
    yaw = np.full(len(cycles), last.yaw - turn_per_cycle)
    lift, pitch, bent = (np.zeros(len(cycles)) for _ in range(3))
    # The cycle begins where the last step of the one before landed, one turn back.
    back = np.deg2rad(-turn_per_cycle)
    x, z = x * np.cos(back) + z * np.sin(back), z * np.cos(back) - x * np.sin(back)
    for step in steps:
        length = step.stop - step.start
        # It is lifted before it travels, and has travelled before it is down.
        going = ease((phase - step.start - 0.15 * length) / (0.7 * length))
        x, z, yaw = (a + going * (b - a) for a, b in ((x, step.x), (z, step.z), (yaw, step.yaw)))
        # Rolling begins before the step and may begin before the cycle does.
        middle = 0.5 * (step.start + step.stop)
        s = (np.mod(phase - middle + 0.5, 1.0) - 0.5) / length + 0.5
        lift += step.height * bump(s)
        # The heel leaves first and the ball lands first.
        pitch += 24.0 * bump(s + 0.35, 0.42) + 10.0 * bump((s - 0.6) / 0.6)
        bent += ease((s + 0.05) / 0.4) - ease((s - 0.55) / 0.4)
    turn = np.deg2rad(number * turn_per_cycle)
    place = np.stack([x * np.cos(turn) + z * np.sin(turn), lift, z * np.cos(turn) - x * np.sin(turn)], axis=1)
    return shape.foot(place, yaw + number * turn_per_cycle, pitch, pitch * bent)
