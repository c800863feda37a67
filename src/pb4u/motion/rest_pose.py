"""The pose that a recording counts its rotations from: its own where a person stands in it, or one that frames tell.

A file may rest in any pose, lying, seated or with all bones in a line, and still move as it should.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.body.skeleton import PoseSequence, joint_positions
from pb4u.errors import InputError
from pb4u.geometry.rotation import conjugate, from_xyzw, multiply, rotate
from pb4u.motion.bone_axes import SHORT, axes_in_t_pose, nearly_axes, trunk, unit
from pb4u.motion.correspondences import SEGMENTS
from pb4u.motion.recording import Recording
from pb4u.motion.reference_pose import T_POSE
from pb4u.motion.up_axis import standing_axis

# Frames that are looked at, at most.
_SAMPLES = 240
# Cosine between both thighs and the pelvis' upward axis from which on a person has them within the trunk.
_WITHIN = 0.85


def standing_at_rest(recording: Recording, path: Path) -> Recording:
    """The same performance in a world with Y up, relative to an upright rest pose facing +Z.

    Args:
        recording: joints at rest and rotations from there, in the axes of its file.
        path: the file, for messages.

    Raises:
        InputError: the joints make no person in its frames.
    """
    all_poses = recording.poses
    chosen = np.unique(np.linspace(0, len(all_poses) - 1, _SAMPLES).round().astype(int))
    poses = PoseSequence(all_poses.rotations[chosen], all_poses.root_positions[chosen], all_poses.fps)
    joints = joint_positions(recording.skeleton, poses)
    _require_person(recording, joints, path)
    stance = _stance(recording)
    up = standing_axis(recording, joints, None if stance is None else stance[1])
    if stance is not None:
        axes = np.tile(from_xyzw(Rotation.from_matrix(stance).as_quat()), (recording.skeleton.bone_count, 1))
    else:
        axes, recording = axes_in_t_pose(recording, poses, joints, up)
        note = f"{recording.name}: nobody stands in its rest pose, so the frames tell how its bones are turned."
        recording = replace(recording, notes=(*recording.notes, note))
    return _counted_from(recording, axes).stood_up(up)


def _counted_from(recording: Recording, axes: np.ndarray) -> Recording:
    """The recording counted from the pose in which each bone has lost its rotation `axes` (bones, 4)."""
    skeleton, poses = recording.skeleton, recording.poses
    joints = skeleton.joints.copy()
    for bone, parent in enumerate(skeleton.parents.tolist()):
        if parent >= 0:
            joints[bone] = joints[parent] + rotate(axes[parent], skeleton.joints[bone] - skeleton.joints[parent])
    rotations = multiply(poses.rotations, conjugate(axes))
    return replace(recording, skeleton=replace(skeleton, joints=joints), poses=replace(poses, rotations=rotations))


def _require_person(recording: Recording, joints: np.ndarray, path: Path) -> None:
    """Refuse a recording whose joints (frames, bones, 3) make no person."""
    at = {role: joints[:, recording.joint_index(role)] for role in recording.source.roles if "." in role}
    hips = 0.5 * (at["thigh.L"] + at["thigh.R"])
    for first, second in (*SEGMENTS.items(), ("thigh.L", "thigh.R"), ("upper_arm.L", "upper_arm.R")):
        if not np.linalg.norm(at[second] - at[first], axis=1).max() > SHORT * recording.leg_length:
            names = [recording.skeleton.names[recording.joint_index(role)] for role in (first, second)]
            raise InputError(
                f"{path}: {names[0]} and {names[1]} are at the same point in its rest pose (the OFFSETs of its "
                "HIERARCHY); "
                "export it again with the skeleton that it was recorded with."
            )
    waist = unit(joints[:, trunk(recording)[1]] - hips)
    thighs = [unit(at[f"shin.{side}"] - at[f"thigh.{side}"]) for side in "LR"]
    if min(float(np.sum(thigh * waist, axis=1).min()) for thigh in thighs) > _WITHIN:
        raise InputError(
            f"{path}: in all of its frames the thighs point into the trunk, so its rest pose (the OFFSETs of its "
            "HIERARCHY) is not the one that its rotations are counted from; export it again with the skeleton that it "
            "was recorded with."
        )


def _stance(recording: Recording) -> np.ndarray | None:
    """Rows (3, 3): left, up and front of the rest pose in the axes of its file; None where no person stands in it."""
    joint, rest = recording.joint, recording.skeleton.joints
    left = joint("thigh.L") - joint("thigh.R")
    up = joint("upper_arm.L") + joint("upper_arm.R") - joint("thigh.L") - joint("thigh.R")
    least = SHORT * recording.leg_length
    if np.linalg.norm(left) < least or np.linalg.norm(up) < least or abs(unit(left) @ unit(up)) > 0.5:
        return None
    up = unit(up)
    left = unit(left - (left @ up) * up)
    axes = np.stack([left, up, np.cross(left, up)])

    def seen(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return axes @ unit(second - first)

    bones = trunk(recording)[1:]
    spine = [seen(rest[a], rest[b]) for a, b in pairwise(bones)]
    stands = [along[1] > 0.5 for along in spine if along.any()]
    stands.append(seen(joint("upper_arm.R"), joint("upper_arm.L"))[0] > 0.7)
    for upper, lower in SEGMENTS.items():
        along = seen(joint(upper), joint(lower))
        if upper.startswith(("thigh", "shin")):
            stands.append(along[1] < -0.7 and abs(along[2]) < 0.4)
        else:  # anywhere but across the body
            stands.append(along @ T_POSE.directions[upper] > -0.35)
    for side in "LR":
        stands.append(seen(joint(f"foot.{side}"), joint(f"toes.{side}"))[2] > -0.3)
    return nearly_axes(axes) if all(stands) else None
