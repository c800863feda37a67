"""A procedural performance in human terms, and the body that performs it with its feet where they were planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pb4u.body.skeleton import PoseSequence
from pb4u.geometry.rotation import about_axis, between, conjugate, multiply, rotate, slerp
from pb4u.motion.correspondences import ROLE_INDEX, ROLES
from pb4u.motion.curves import soft_ramp
from pb4u.motion.humanoid import Humanoid
from pb4u.motion.reference_pose import T_POSE

# Share of the turn from pelvis to chest, and from chest to head, that each bone has done.
_SPINE_SHARES = {"spine_lower": 0.3, "spine_middle": 0.65, "spine_upper": 1.0}
_NECK_SHARES = {"neck_lower": 0.3, "neck_upper": 0.65, "head": 1.0}
# A planned foot should be no farther from its hip than this share of the leg's length; no leg reaches past the second.
FULL_STRETCH, _LOCKED = 0.993, 0.9995

Angle = np.ndarray | float


@dataclass(frozen=True, eq=False)
class Turn:
    """A rotation Ry(yaw) Rx(pitch) Rz(roll).

    Args:
        pitch: forward [deg], one number or (frames,), like the other angles.
        yaw: to the left [deg].
        roll: with the left side up [deg].
    """

    pitch: Angle = 0.0
    yaw: Angle = 0.0
    roll: Angle = 0.0

    def quaternions(self, frames: int) -> np.ndarray:
        """Unit quaternions (frames, 4) wxyz of the rotation, constant angles repeated for `frames` frames.

        Args:
            frames: number of frames.
        """
        facing = multiply(about("y", self.yaw, frames), about("x", self.pitch, frames))
        return multiply(facing, about("z", self.roll, frames))


@dataclass(frozen=True, eq=False)
class Arm:
    """Angles of an arm, relative to hanging with the palm to the thigh; mirrored on the right.

    Args:
        flexion: upper arm swung forward [deg], one number or (frames,), like the other angles.
        abduction: upper arm lifted sideways [deg].
        sweep: the whole arm turned about the vertical, outward [deg].
        twist: upper arm turned inward about itself [deg].
        elbow: bend of the elbow [deg].
        pronation: forearm turned inward about itself [deg].
        wrist: hand bent towards the palm [deg].
    """

    flexion: Angle = 0.0
    abduction: Angle = 14.0
    sweep: Angle = 0.0
    twist: Angle = 15.0
    elbow: Angle = 15.0
    pronation: Angle = 20.0
    wrist: Angle = 5.0


@dataclass(frozen=True, eq=False)
class Foot:
    """Positions and rotations of a foot over time.

    Args:
        ankle: (frames, 3) world position of the ankle [m].
        rotation: (frames, 4) world rotation of the foot from rest, unit quaternions wxyz.
        toes: (frames, 4) world rotation of the toes from rest, unit quaternions wxyz.
    """

    ankle: np.ndarray
    rotation: np.ndarray
    toes: np.ndarray


@dataclass(frozen=True, eq=False)
class Performance:
    """Movement of a body over time, in terms that fit any humanoid.

    Args:
        hips: (frames, 3) world position of the middle of the hips [m].
        pelvis: rotation of the pelvis in the world.
        feet: planned feet by side.
        chest: rotation of the chest from the pelvis.
        head: rotation of the head from the chest.
        arms: arm angles by side.
    """

    hips: np.ndarray
    pelvis: Turn
    feet: Mapping[str, Foot]
    chest: Turn = field(default_factory=Turn)
    head: Turn = field(default_factory=Turn)
    arms: Mapping[str, Arm] = field(default_factory=lambda: {"L": Arm(), "R": Arm()})


def about(axis: str, degrees: Angle, frames: int) -> np.ndarray:
    """Rotations about a world axis.

    Args:
        axis: "x", "y" or "z".
        degrees: angle [deg], one number or (frames,).
        frames: number of frames.

    Returns:
        (frames, 4) unit quaternions wxyz.
    """
    return about_axis(axis, np.deg2rad(np.broadcast_to(np.asarray(degrees, dtype=np.float64), (frames,))))


def role_rotations(performance: Performance, humanoid: Humanoid) -> np.ndarray:
    """Role rotations of a performance; legs are solved by inverse kinematics.

    Args:
        performance: movement of the body.
        humanoid: the body.

    Returns:
        (frames, roles, 4) unit quaternions wxyz from the rest pose of the body.
    """
    frames = len(performance.hips)
    roles = np.tile([1.0, 0.0, 0.0, 0.0], (frames, len(ROLES), 1))
    pelvis = performance.pelvis.quaternions(frames)
    chest = multiply(pelvis, performance.chest.quaternions(frames))
    head = multiply(chest, performance.head.quaternions(frames))
    roles[:, ROLE_INDEX["pelvis"]] = pelvis
    for shares, start, end in ((_SPINE_SHARES, pelvis, chest), (_NECK_SHARES, chest, head)):
        for role, share in shares.items():
            roles[:, ROLE_INDEX[role]] = slerp(start, end, np.full(frames, share))
    for side in "LR":
        local = _arm_rotations(performance.arms[side], frames)
        for role, rotation in local.items():
            mirrored = rotation if side == "L" else rotation * np.array([1.0, 1.0, -1.0, -1.0])
            roles[:, ROLE_INDEX[f"{role}.{side}"]] = multiply(chest, mirrored)
    roles = humanoid.aligned(roles, T_POSE)
    for side in "LR":
        for role, rotation in _leg_rotations(performance, humanoid, pelvis, side).items():
            roles[:, ROLE_INDEX[f"{role}.{side}"]] = rotation
    return roles


def poses_of(performance: Performance, humanoid: Humanoid, fps: float) -> PoseSequence:
    """Poses of a body that performs.

    Args:
        performance: the movement.
        humanoid: the body.
        fps: frames per second of the movement.
    """
    rotations = humanoid.bone_rotations(role_rotations(performance, humanoid))
    return PoseSequence(rotations, humanoid.root_positions(rotations, performance.hips), fps)


def _arm_rotations(arm: Arm, n: int) -> dict[str, np.ndarray]:
    """Left arm's rotations from a T-pose, in the frame of the chest."""
    lift = np.asarray(arm.abduction, dtype=np.float64) + np.asarray(arm.flexion) * 0.0
    # The collar bone follows an arm that is lifted above the shoulder.
    height = np.maximum(lift, np.abs(arm.flexion))
    collar = about("z", 18.0 * soft_ramp((height - 60.0) / 90.0), n)
    upper = multiply(about("x", -np.asarray(arm.flexion), n), about("z", lift - 90.0, n))
    upper = multiply(about("y", arm.sweep, n), upper)
    upper = multiply(upper, about("x", arm.twist, n))
    fore = multiply(upper, about("y", -np.asarray(arm.elbow), n))
    end = multiply(fore, about("x", arm.pronation, n))
    hand = multiply(end, about("z", -np.asarray(arm.wrist), n))
    return {"clavicle": collar, "upper_arm": upper, "forearm": fore, "forearm_end": end, "hand": hand}


def _leg_rotations(
    performance: Performance, humanoid: Humanoid, pelvis: np.ndarray, side: str
) -> dict[str, np.ndarray]:
    """Two-bone inverse kinematics: rotations from rest of a leg's bones that put the ankle where it was planned."""
    foot = performance.feet[side]
    rest_hip, rest_knee, rest_ankle = (humanoid.joint(f"{role}.{side}") for role in ("thigh", "shin", "foot"))
    hip = performance.hips + rotate(pelvis, rest_hip - humanoid.hip_midpoint)
    upper, lower = float(np.linalg.norm(rest_knee - rest_hip)), float(np.linalg.norm(rest_ankle - rest_knee))
    reach = foot.ankle - hip
    distance = np.linalg.norm(reach, axis=1)
    along = reach / distance[:, None]
    distance = reachable_distance(distance, upper + lower)
    front = np.array([0.0, 0.0, 1.0])
    # A knee points between where the pelvis and where the foot point.
    pole = rotate(slerp(pelvis, level_heading(foot.rotation), np.full(len(reach), 0.6)), front)
    pole = pole - np.sum(pole * along, axis=1, keepdims=True) * along
    pole /= np.linalg.norm(pole, axis=1, keepdims=True)
    cosine = np.clip((upper**2 + distance**2 - lower**2) / (2 * upper * distance), -1.0, 1.0)
    thigh = cosine[:, None] * along + np.sqrt(1.0 - cosine**2)[:, None] * pole
    shin = (distance[:, None] * along - upper * thigh) / lower
    return {
        "thigh": _frame_to_frame(rest_knee - rest_hip, front, thigh, pole),
        "shin": _frame_to_frame(rest_ankle - rest_knee, front, shin, pole),
        "foot": foot.rotation,
        "toes": foot.toes,
    }


def reachable_distance(distance: np.ndarray, leg: float) -> np.ndarray:
    """Hip-to-ankle distance limited to the leg's reach: unchanged up to `FULL_STRETCH`, then approaching a straight
    leg.

    Args:
        distance: (frames,) wanted distance [m].
        leg: length of the straight leg [m].

    Returns:
        (frames,) [m].
    """
    start, end = FULL_STRETCH * leg, _LOCKED * leg
    over = np.maximum(distance - start, 0.0)
    return np.minimum(distance, start) + (end - start) * np.tanh(over / (end - start))


def level_heading(rotation: np.ndarray) -> np.ndarray:
    """Turn about Y in rotations: the twist part of their swing-twist decomposition; none of a half turn on the level.

    Args:
        rotation: (frames, 4) unit quaternions wxyz.

    Returns:
        (frames, 4) unit quaternions wxyz.
    """
    twist = rotation * np.array([1.0, 0.0, 1.0, 0.0])
    size = np.linalg.norm(twist, axis=-1, keepdims=True)
    return np.where(size > 1e-9, twist / np.maximum(size, 1e-9), [1.0, 0.0, 0.0, 0.0])


def _frame_to_frame(rest_along: np.ndarray, rest_pole: np.ndarray, along: np.ndarray, pole: np.ndarray) -> np.ndarray:
    """Rotations (frames, 4) that take the rest direction and its pole to the posed ones."""
    rest = _frame_quaternions(rest_along[None], rest_pole[None])
    return multiply(_frame_quaternions(along, pole), conjugate(rest))


def _frame_quaternions(along: np.ndarray, pole: np.ndarray) -> np.ndarray:
    """Quaternions (frames, 4) of the frames whose -Y is `along` and whose Z lies towards `pole`."""
    y = -along / np.linalg.norm(along, axis=1, keepdims=True)
    z = pole - np.sum(pole * y, axis=1, keepdims=True) * y
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    # Y to its place by the smallest rotation, then a twist about it.
    swing = between(np.array([0.0, 1.0, 0.0]), y)
    local = rotate(conjugate(swing), z)
    return multiply(swing, about_axis("y", np.arctan2(local[:, 0], local[:, 2])))
