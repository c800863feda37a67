"""Recordings given as SMPL, SMPL-H or SMPL-X pose parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pb4u.body.skeleton import PoseSequence, Skeleton
from pb4u.body.smpl import JOINT_NAMES
from pb4u.errors import InputError
from pb4u.geometry.rotation import from_axis_angle, multiply, rotate
from pb4u.motion.correspondences import SMPL
from pb4u.motion.recording import Recording, finite_frames

_FAMILY_OF_WIDTH = {3 * len(names): family for family, names in JOINT_NAMES.items()}
_Z_UP_TO_Y_UP = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])

# A pose file holds no skeleton. This one has the proportions of an average adult in round numbers [m]; it serves to
# scale the travel to other bodies and to tell how limbs rest, in a T-pose with the legs a little apart.
_NOMINAL_OFFSETS = {
    "hip": (0.06, -0.09, 0.0), "knee": (0.04, -0.38, 0.01), "ankle": (-0.015, -0.41, -0.035),
    "foot": (0.04, -0.06, 0.12), "spine1": (0.0, 0.12, -0.03), "spine2": (0.0, 0.14, 0.02),
    "spine3": (0.0, 0.06, 0.0), "neck": (0.0, 0.21, -0.03), "head": (0.0, 0.09, 0.05), "collar": (0.08, 0.12, -0.02),
    "shoulder": (0.1, 0.04, -0.01), "elbow": (0.26, 0.0, -0.02), "wrist": (0.25, 0.0, 0.0), "hand": (0.08, 0.0, 0.0),
}  # fmt: skip
_PARENTS = {
    "hip": "pelvis", "knee": "hip", "ankle": "knee", "foot": "ankle", "spine1": "pelvis", "spine2": "spine1",
    "spine3": "spine2", "neck": "spine3", "head": "neck", "collar": "spine3", "shoulder": "collar",
    "elbow": "shoulder", "wrist": "elbow", "hand": "wrist", "jaw": "head", "eye": "head",
}  # fmt: skip


def smpl_recording(path: Path, poses: np.ndarray, translations: np.ndarray, fps: float, z_up: bool) -> Recording:
    """A recording from pose parameters.

    Args:
        path: the file, for messages.
        poses: (frames, 72, 156 or 165) rotation vectors of the joints, each from its parent [rad].
        translations: (frames, 3) [m].
        fps: frames per second.
        z_up: whether files of this kind have Z up; the other axis is taken where the pelvis plainly stands on it.

    Raises InputError on wrong shapes, no frames or values that are not finite.
    """
    if poses.ndim != 2 or poses.shape[1] not in _FAMILY_OF_WIDTH:
        widths = ", ".join(f"{width} ({family})" for width, family in sorted(_FAMILY_OF_WIDTH.items()))
        raise InputError(f"{path}: poses have the shape {poses.shape}; each frame should hold {widths} numbers.")
    if translations.shape != (len(poses), 3):
        raise InputError(f"{path}: translations have the shape {translations.shape}, not ({len(poses)}, 3).")
    if not len(poses):
        raise InputError(f"{path} holds no frames.")
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(f"{path}: the frame rate is {fps:g}; it should be a positive number of frames per second.")
    skeleton = nominal_skeleton(_FAMILY_OF_WIDTH[poses.shape[1]])
    numbers = np.concatenate([poses, translations], axis=1, dtype=np.float64)
    local = from_axis_angle(finite_frames(numbers, path)[:, :-3].reshape(len(poses), -1, 3))
    world = np.empty_like(local)
    for i, parent in enumerate(skeleton.parents.tolist()):
        world[:, i] = local[:, i] if parent < 0 else multiply(world[:, parent], local[:, i])
    sequence = PoseSequence(world, numbers[:, -3:], fps)
    _, y, z = np.abs(rotate(sequence.rotations[:, 0], np.array([0.0, 1.0, 0.0])).mean(0))
    notes: tuple[str, ...] = ()
    if (z_up and y > 0.7 > z) or (not z_up and z > 0.7 > y):
        z_up = not z_up
        notes = (f"{path.name}: taken as {'Z' if z_up else 'Y'} up, which is where the pelvis points.",)
    if z_up:
        rotations = multiply(_Z_UP_TO_Y_UP, sequence.rotations)
        sequence = PoseSequence(rotations, rotate(_Z_UP_TO_Y_UP, sequence.root_positions), fps)
    return Recording(path.stem, SMPL, skeleton, sequence, notes)


def nominal_skeleton(family: str) -> Skeleton:
    """An average adult with the joints of an SMPL family; fingers lie at the wrists."""
    names = JOINT_NAMES[family]
    parents = np.full(len(names), -1, dtype=np.int64)
    joints = np.zeros((len(names), 3))
    for i, name in enumerate(names[1:], start=1):
        side, _, part = name.partition("_") if name.startswith(("left_", "right_")) else ("", "", name)
        part = part.removesuffix("_smplhf")
        if part not in _PARENTS:
            parents[i] = _finger_parent(names, name)
            joints[i] = joints[parents[i]]
            continue
        parent = _PARENTS[part]
        parents[i] = names.index(f"{side}_{parent}" if f"{side}_{parent}" in names else parent)
        mirror = -1.0 if side == "right" else 1.0
        joints[i] = joints[parents[i]] + np.array(_NOMINAL_OFFSETS.get(part, (0.0, 0.0, 0.0))) * [mirror, 1.0, 1.0]
    return Skeleton(names, parents, joints)


def _finger_parent(names: tuple[str, ...], name: str) -> int:
    """The segment before a finger's, or the wrist before its first."""
    stem, segment = name[:-1], int(name[-1])
    return names.index(f"{stem}{segment - 1}" if segment > 1 else f"{name.split('_')[0]}_wrist")
