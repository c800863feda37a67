"""How the limbs of two skeletons at rest stand to each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pb4u.geometry.rotation import between, from_axis_angle, multiply, rotate
from pb4u.motion.correspondences import ROLE_INDEX, ROLES, SEGMENTS

# Of an elbow that is bent, or short of folded up, by less than 10 degrees the rest pose does not determine the plane.
_STRAIGHT = np.sin(np.deg2rad(10.0))


@dataclass(frozen=True, eq=False)
class ReferencePose:
    """Directions of the limbs in the pose that a skeleton's rotations are counted from, facing +Z.

    Args:
        directions: limb segment role -> unit vector (3,) from its upper joint to its lower one.
        elbow_flexion: side -> unit vector (3,) in which the forearm folds, square to the upper arm.
    """

    directions: Mapping[str, np.ndarray]
    elbow_flexion: Mapping[str, np.ndarray]

    @classmethod
    def of_joints(
        cls, joint: Callable[[str], np.ndarray], t_pose_elbow_flexion: tuple[float, float, float]
    ) -> ReferencePose:
        """Reference pose of a skeleton, from joint positions by limb role.

        Args:
            joint: position (3,) of the upper joint of a limb role, in any unit.
            t_pose_elbow_flexion: direction in which the left forearm bends in a T-pose; for straight elbows.
        """
        directions = {upper: _unit(joint(lower) - joint(upper)) for upper, lower in SEGMENTS.items()}
        flexion = {}
        for side, sign in (("L", 1.0), ("R", -1.0)):
            upper, fore = directions[f"upper_arm.{side}"], directions[f"forearm.{side}"]
            across = fore - np.dot(fore, upper) * upper
            if np.linalg.norm(across) < _STRAIGHT:
                lateral = np.array([sign, 0.0, 0.0])
                folding = np.array(t_pose_elbow_flexion) * np.array([sign, 1.0, 1.0])
                across = rotate(between(lateral, upper), folding)
                across = across - np.dot(across, upper) * upper
            flexion[side] = _unit(across)
        return cls(directions, flexion)


T_POSE = ReferencePose(
    {
        **{f"{role}.L": np.array([1.0, 0.0, 0.0]) for role in ("upper_arm", "forearm")},
        **{f"{role}.R": np.array([-1.0, 0.0, 0.0]) for role in ("upper_arm", "forearm")},
        **{f"{role}.{side}": np.array([0.0, -1.0, 0.0]) for role in ("thigh", "shin") for side in "LR"},
    },
    {side: np.array([0.0, 0.0, 1.0]) for side in "LR"},
)


def leg_length(joint: Callable[[str], np.ndarray]) -> float:
    """Length of hip to knee to ankle, mean of both legs, in the unit of the joints.

    Args:
        joint: position (3,) of the upper joint of a limb role, in any unit.
    """
    total = 0.0
    for side in "LR":
        hip, knee, ankle = (joint(f"{role}.{side}") for role in ("thigh", "shin", "foot"))
        total += float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))
    return 0.5 * total


def alignment(source: ReferencePose, target: ReferencePose) -> np.ndarray:
    """Rotations that bring the limbs of one skeleton at rest into the reference pose of another.

    Torso, clavicles and feet are assumed to have the same rest pose. A limb's upper segment takes the smallest
    rotation, and the upper arm the twist that makes the elbows bend in the same direction; lower segments are
    straightened relative to the aligned upper ones.

    Args:
        source: the pose that they are brought into.
        target: the pose that is turned.

    Returns:
        (roles, 4) unit quaternions wxyz.
    """
    result = np.tile([1.0, 0.0, 0.0, 0.0], (len(ROLES), 1))
    for side in "LR":
        for upper, lower in (("upper_arm", "forearm"), ("thigh", "shin")):
            upper, lower = f"{upper}.{side}", f"{lower}.{side}"
            axis = source.directions[upper]
            turn = between(target.directions[upper], axis)
            if upper.startswith("upper_arm"):
                folded, source_fold = rotate(turn, target.elbow_flexion[side]), source.elbow_flexion[side]
                twist = np.arctan2(np.dot(np.cross(folded, source_fold), axis), np.dot(folded, source_fold))
                turn = multiply(from_axis_angle(twist * axis), turn)
            unbend = between(rotate(turn, target.directions[lower]), source.directions[lower])
            result[ROLE_INDEX[upper]] = turn
            result[ROLE_INDEX[lower]] = multiply(unbend, turn)
        for role in ("forearm_end", "hand"):
            result[ROLE_INDEX[f"{role}.{side}"]] = result[ROLE_INDEX[f"forearm.{side}"]]
    return result


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
