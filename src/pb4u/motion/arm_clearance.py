"""Arms held away from the torso, so that garments have room between them."""

from __future__ import annotations

import numpy as np

from pb4u.body.skeleton import PoseSequence
from pb4u.geometry.rotation import from_axis_angle, multiply, rotate, slerp
from pb4u.motion.correspondences import Blend
from pb4u.motion.humanoid import Humanoid

_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
_ARM_ROLES = ("upper_arm", "forearm", "forearm_end", "hand")


def arms_swung_out(humanoid: Humanoid, poses: PoseSequence, degrees: float) -> PoseSequence:
    """The poses with hanging arms swung outward about the front axis of the chest.

    The swing is `degrees` times the cosine of the angle between upper arm and the chest's downward axis: whole for a
    hanging arm, none for one that is level or raised.
    """
    skeleton = humanoid.body.skeleton
    chest = poses.rotations[:, skeleton.index(humanoid.bone_of("spine_upper"))]
    front, down = rotate(chest, np.array([0.0, 0.0, 1.0])), rotate(chest, np.array([0.0, -1.0, 0.0]))
    rotations = poses.rotations.copy()
    for side, sign in (("L", 1.0), ("R", -1.0)):
        upper = skeleton.index(humanoid.bone_of(f"upper_arm.{side}"))
        arm = rotate(poses.rotations[:, upper], humanoid.reference.directions[f"upper_arm.{side}"])
        hanging = np.clip(np.sum(arm * down, axis=-1), 0.0, 1.0)
        swing = from_axis_angle(sign * np.deg2rad(degrees) * hanging[:, None] * front)
        for bone, share in enumerate(_shares(humanoid, side)):
            if share:
                turn = slerp(_IDENTITY, swing, np.full(len(swing), share))
                rotations[:, bone] = multiply(turn, rotations[:, bone])
    return PoseSequence(rotations, poses.root_positions, poses.fps)


def _shares(humanoid: Humanoid, side: str) -> list[float]:
    """How much of the arm's swing each bone takes."""
    arm = {f"{role}.{side}" for role in _ARM_ROLES}
    skeleton = humanoid.body.skeleton
    shares: list[float] = []
    for name, parent in zip(skeleton.names, skeleton.parents.tolist(), strict=True):
        part = humanoid.target.bones.get(name)
        if part is None:
            shares.append(shares[parent])
        elif isinstance(part, Blend):
            shares.append((1.0 - part.amount) * (part.first in arm) + part.amount * (part.second in arm))
        else:
            shares.append(float(part in arm))
    return shares
