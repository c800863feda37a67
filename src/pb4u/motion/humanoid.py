"""A shaped body seen as a humanoid: its joints by role, and its pose from the rotations of the roles."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.errors import InputError
from pb4u.geometry.rotation import angle_between, between, conjugate, from_axis_angle, multiply, rotate, slerp
from pb4u.motion.correspondences import FORWARD, ROLE_INDEX, TARGETS, Blend
from pb4u.motion.curves import soft_ramp
from pb4u.motion.reference_pose import ReferencePose, alignment, leg_length

# Between these angles [rad] of two rotations, slerp between them is blended over to swing alone: from the first on it
# may turn the other way round within a frame or two.
_NEARLY_OPPOSITE = np.deg2rad((115.0, 165.0))
_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
_ARM_ROLES = ("upper_arm", "forearm", "forearm_end", "hand")


class Humanoid:
    """A body's joints and bones by role, as retargeting and procedural clips need them.

    Args:
        body: the body at rest.

    Raises:
        InputError: its bones play no known roles.
    """

    def __init__(self, body: ShapedBody) -> None:
        target = TARGETS.get(body.family)
        skeleton = body.skeleton
        if target is None:
            raise InputError(
                f'{body.name}: no motion can be retargeted to a body of the family "{body.family}"; '
                f"known families are {', '.join(TARGETS)}."
            )
        needed = set(target.joints.values()) | (set() if target.partial else set(target.bones))
        if missing := sorted(needed - set(skeleton.names)):
            raise InputError(f"{body.name}: the skeleton lacks the bones {', '.join(missing)} of a {body.family} body.")
        self.body = body
        self.target = target
        self.reference = ReferencePose.of_joints(self.joint, FORWARD)

    def bone_of(self, role: str) -> str:
        """Name of the bone that only this role drives, the first of several.

        Args:
            role: a limb role.
        """
        return next(bone for bone, part in self.target.bones.items() if part == role)

    def joint(self, role: str) -> np.ndarray:
        """Rest position (3,) [m] of the upper joint of a limb role.

        Args:
            role: a limb role.
        """
        return self.body.skeleton.joints[self.body.skeleton.index(self.target.joints[role])]

    @property
    def hip_midpoint(self) -> np.ndarray:
        """Rest position (3,) [m] halfway between the hip joints."""
        return 0.5 * (self.joint("thigh.L") + self.joint("thigh.R"))

    @property
    def leg_length(self) -> float:
        """Length of hip to knee to ankle at rest [m], mean of both legs."""
        return leg_length(self.joint)

    def aligned(self, roles: np.ndarray, source: ReferencePose) -> np.ndarray:
        """Role rotations counted from this body's rest pose.

        Args:
            roles: (frames, roles, 4) unit quaternions wxyz, counted from `source`.
            source: reference pose of another skeleton.

        Returns:
            (frames, roles, 4) unit quaternions wxyz.
        """
        return multiply(roles, alignment(source, self.reference))

    def bone_rotations(self, roles: np.ndarray) -> np.ndarray:
        """World rotations from rest of every bone.

        Args:
            roles: (frames, roles, 4) unit quaternions wxyz, counted from this body's rest pose.

        Returns:
            (frames, bones, 4) unit quaternions wxyz.
        """
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
        """World positions of the root joint that put the middle of the hips at given points.

        Valid for skeletons whose hip joints move only with the root, as in all supported ones.

        Args:
            rotations: (frames, bones, 4) unit quaternions wxyz, from rest.
            hip_midpoints: (frames, 3) wanted middle of the hips [m].

        Returns:
            (frames, 3) [m].
        """
        arm = self.hip_midpoint - self.body.skeleton.joints[0]
        return hip_midpoints - rotate(rotations[:, 0], arm)

    def arms_swung_out(self, poses: PoseSequence, degrees: float) -> PoseSequence:
        """The poses with hanging arms swung outward about the front axis of the chest, to make room for a garment.

        Args:
            poses: poses of this body.
            degrees: the swing of a hanging arm; it decreases with the cosine of the angle between upper arm and the
                chest's downward axis, to zero for a level or raised arm.
        """
        skeleton = self.body.skeleton
        chest = poses.rotations[:, skeleton.index(self.bone_of("spine_upper"))]
        front, down = rotate(chest, np.array([0.0, 0.0, 1.0])), rotate(chest, np.array([0.0, -1.0, 0.0]))
        for side, sign in (("L", 1.0), ("R", -1.0)):
            upper = skeleton.index(self.bone_of(f"upper_arm.{side}"))
            arm = rotate(poses.rotations[:, upper], self.reference.directions[f"upper_arm.{side}"])
            hanging = np.clip(np.sum(arm * down, axis=-1), 0.0, 1.0)
            swing = from_axis_angle(sign * np.deg2rad(degrees) * hanging[:, None] * front)
            poses = self.arm_turned(poses, side, swing)
        return poses

    def arm_turned(self, poses: PoseSequence, side: str, turns: np.ndarray) -> PoseSequence:
        """The poses with a whole arm turned about its shoulder.

        Args:
            poses: poses of this body.
            side: "L" or "R".
            turns: (frames, 4) unit quaternions wxyz in the world.
        """
        rotations = poses.rotations.copy()
        for bone, share in enumerate(self.arm_shares(side).tolist()):
            if share:
                turn = slerp(_IDENTITY, turns, np.full(len(turns), share))
                rotations[:, bone] = multiply(turn, rotations[:, bone])
        return PoseSequence(rotations, poses.root_positions, poses.fps)

    def shares_of(self, roles: Collection[str]) -> np.ndarray:
        """How much of each bone some roles drive; bones that play none go with their parents.

        Args:
            roles: names of roles, as "forearm.L".

        Returns:
            (bones,) in [0, 1].
        """
        skeleton = self.body.skeleton
        shares = np.zeros(skeleton.bone_count)
        for bone, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
            part = self.target.bones.get(name)
            if part is None:
                shares[bone] = shares[parent]
            elif isinstance(part, Blend):
                shares[bone] = (1.0 - part.amount) * (part.first in roles) + part.amount * (part.second in roles)
            else:
                shares[bone] = part in roles
        return shares

    def arm_shares(self, side: str) -> np.ndarray:
        """Share of a turn of the whole arm for each bone (bones,): 1 below the shoulder, less at it.

        Args:
            side: "L" or "R".
        """
        return self.shares_of([f"{role}.{side}" for role in _ARM_ROLES])


def _part_way(first: np.ndarray, second: np.ndarray, amount: float, along: np.ndarray | None) -> np.ndarray:
    """Rotations (frames, 4) `amount` of the way from `first` to `second`, continuous for arms that turn by half a turn.

    Where the two are nearly opposite slerp would jump from one way round to the other: there only the swing of the
    limb `along` (3,) counts, and its twist not.
    """
    straight = slerp(first, second, np.full(len(first), amount))
    if along is None:
        return straight
    angle = angle_between(first, second)
    if angle.max() < _NEARLY_OPPOSITE[0]:
        return straight
    turned = rotate(multiply(conjugate(first), second), along)
    swing = multiply(first, between(np.broadcast_to(along, turned.shape), turned))
    share = soft_ramp((angle - _NEARLY_OPPOSITE[0]) / (_NEARLY_OPPOSITE[1] - _NEARLY_OPPOSITE[0]))
    return slerp(straight, slerp(first, swing, np.full(len(first), amount)), share)


def humanoid_of(body: ShapedBody) -> Humanoid:
    """The humanoid of a body, computed once and kept with it.

    Args:
        body: the resting body.
    """
    return body.kept("humanoid", Humanoid)
