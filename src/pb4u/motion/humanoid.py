"""A shaped body seen as a humanoid: its joints by role, and its pose from the rotations of the roles."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.errors import InputError
from pb4u.geometry.rotation import angle_between, conjugate, multiply, rotate, slerp
from pb4u.motion.correspondences import ROLE_INDEX, TARGETS, Blend
from pb4u.motion.reference_pose import ReferencePose, alignment, between

_NEARLY_OPPOSITE = np.deg2rad((115.0, 165.0))


class Humanoid:
    """What retargeting and procedural clips need to know of one body."""

    def __init__(self, body: ShapedBody) -> None:
        """Raises InputError for a body whose bones play no known roles."""
        target = TARGETS.get(body.family)
        skeleton = body.skeleton
        if target is None:
            raise InputError(
                f'{body.name}: no motion can be put on a body of the family "{body.family}"; '
                f"known families are {', '.join(TARGETS)}."
            )
        needed = set(target.bones) | set(target.joints.values())
        if missing := sorted(needed - set(skeleton.names)):
            raise InputError(f"{body.name}: the skeleton lacks the bones {', '.join(missing)} of a {body.family} body.")
        self.body = body
        self.target = target
        self.reference = ReferencePose.of_joints(self.joint, target.elbow_flexion)

    def bone_of(self, role: str) -> str:
        """Name of the bone that a role drives alone, the first one where there are several."""
        return next(bone for bone, part in self.target.bones.items() if part == role)

    def joint(self, role: str) -> np.ndarray:
        """Rest position (3,) [m] of the upper joint of a limb role."""
        return self.body.skeleton.joints[self.body.skeleton.index(self.target.joints[role])]

    @property
    def hip_midpoint(self) -> np.ndarray:
        """Rest position (3,) [m] halfway between the hip joints."""
        return 0.5 * (self.joint("thigh.L") + self.joint("thigh.R"))

    @property
    def leg_length(self) -> float:
        """Hip to knee to ankle at rest [m], mean of both legs."""
        total = 0.0
        for side in "LR":
            hip, knee, ankle = (self.joint(f"{role}.{side}") for role in ("thigh", "shin", "foot"))
            total += float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))
        return 0.5 * total

    def aligned(self, roles: np.ndarray, source: ReferencePose) -> np.ndarray:
        """Role rotations (frames, roles, 4) counted from `source`, counted from this body's rest pose instead."""
        return multiply(roles, alignment(source, self.reference))

    def bone_rotations(self, roles: np.ndarray) -> np.ndarray:
        """World rotations from rest (frames, bones, 4) of every bone, from aligned role rotations."""
        skeleton = self.body.skeleton
        result = np.empty((len(roles), skeleton.bone_count, 4))
        for i, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
            part = self.target.bones.get(name)
            if part is None:
                result[:, i] = result[:, parent]
            elif isinstance(part, Blend):
                first, second = (roles[:, ROLE_INDEX[role]] for role in (part.first, part.second))
                along = self.reference.directions.get(part.second.replace("forearm_end", "forearm"))
                result[:, i] = _part_way(first, second, part.amount, along)
            else:
                result[:, i] = roles[:, ROLE_INDEX[part]]
        return result

    def root_positions(self, rotations: np.ndarray, hip_midpoints: np.ndarray) -> np.ndarray:
        """World positions (frames, 3) of the root joint that put the middle of the hips at `hip_midpoints`.

        Holds for skeletons whose hip joints are carried by the root alone, as all supported ones are.
        """
        arm = self.hip_midpoint - self.body.skeleton.joints[0]
        return hip_midpoints - rotate(rotations[:, 0], arm)


def _part_way(first: np.ndarray, second: np.ndarray, amount: float, along: np.ndarray | None) -> np.ndarray:
    """Rotations (frames, 4) `amount` of the way from `first` to `second`, continuous for arms that turn by half a turn.

    Where the two are nearly opposite slerp would jump from one way round to the other: there only the swing of the
    limb `along` (3,) counts, and its twist not.
    """
    whole = slerp(first, second, np.full(len(first), amount))
    if along is None:
        return whole
    angle = angle_between(first, second)
    if angle.max() < _NEARLY_OPPOSITE[0]:
        return whole
    carried = rotate(multiply(conjugate(first), second), along)
    swing = multiply(first, between(np.broadcast_to(along, carried.shape), carried))
    s = np.clip((angle - _NEARLY_OPPOSITE[0]) / (_NEARLY_OPPOSITE[1] - _NEARLY_OPPOSITE[0]), 0.0, 1.0)
    return slerp(whole, slerp(first, swing, np.full(len(first), amount)), s * s * (3.0 - 2.0 * s))


@lru_cache(maxsize=16)
def humanoid_of(body: ShapedBody) -> Humanoid:
    """The humanoid of a body, kept for the next call."""
    return Humanoid(body)
