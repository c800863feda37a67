"""Recordings given as SMPL, SMPL-H or SMPL-X pose parameters: files of AMASS, and of the VTO dataset and HOOD."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pb4u.body.skeleton import PoseSequence, Skeleton, world_rotations
from pb4u.body.smpl import JOINT_NAMES
from pb4u.errors import InputError
from pb4u.geometry.rotation import from_axis_angle, multiply, rotate
from pb4u.io.array_archive import member_names, read_arrays
from pb4u.io.reading_limits import Allowance, told_names
from pb4u.io.restricted_pickle import load_pickle
from pb4u.io.stored_numbers import stored_numbers
from pb4u.motion.correspondences import SMPL
from pb4u.motion.recording import Recording, finite_frames, require_rate

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


_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps")
_POSE_KEYS = ("poses", "pose", "body_pose")
_TRANSLATION_KEYS = ("trans", "translation", "transl")
# The files do not tell their rate; it is that of the released VTO sequences.
_VTO_RATE = 30.0
# A recorded shape is told where a beta exceeds this, else it counts as average; so many betas are told.
_SLIGHT_BETA, _BETAS_TOLD = 0.05, 4


def read_amass(path: Path) -> Recording:
    """An AMASS recording (Mahmood et al. 2019) of SMPL, SMPL-H or SMPL-X; Z is up.

    Its `betas` and `gender` are told in a note: any body may perform the motion.

    Args:
        path: an .npz with `poses` (frames, 72, 156 or 165), `trans` (frames, 3) and a frame rate.

    Raises:
        InputError: a key is missing, a shape is wrong, or it is no .npz of plain arrays.
    """
    names = set(member_names(path))
    missing = [key for key in ("poses", "trans") if key not in names]
    if missing and "faces" in names and {"positions", "vertices"} & names:
        raise InputError(f"{path} is a body that moves, not a recording; give it as --body {path}.")
    rate_key = next((key for key in _RATE_KEYS if key in names), None)
    if missing or rate_key is None:
        wanted = missing or [" or ".join(_RATE_KEYS[:2])]
        raise InputError(f"{path} has no {' and no '.join(wanted)}; it holds {told_names(names)}.")
    file = read_arrays(path, ("poses", "trans", rate_key))
    poses, translations, rate = file["poses"], file["trans"], file[rate_key]
    betas, gender = (_optional(path, key) for key in ("betas", "gender"))
    if rate.size != 1 or not all(a.dtype.kind in "iuf" for a in (poses, translations, rate)):
        raise InputError(f"{path}: poses, trans and {rate_key} should be numbers, the last a single one.")
    recording = _recording(path, poses, translations, float(rate.reshape(-1)[0]), z_up=True)
    return replace(recording, notes=(*recording.notes, *_shape_note(path, betas, gender)))


def _optional(path: Path, key: str) -> np.ndarray | None:
    try:
        return read_arrays(path, (key,)).get(key)
    except InputError:  # a pickled object: a recording is used without
        return None


def _shape_note(path: Path, betas: np.ndarray | None, gender: np.ndarray | None) -> tuple[str, ...]:
    """Which shape of body was recorded, where the file tells one: the body is chosen apart from the motion."""
    if betas is None or betas.dtype.kind != "f" or not betas.size:
        return ()
    values = betas.reshape(-1, betas.shape[-1])[0] if betas.ndim else betas.reshape(1)
    if not np.isfinite(values).all() or np.abs(values).max() <= _SLIGHT_BETA:
        return ()
    told = values[:_BETAS_TOLD]
    shape = ",".join(f"beta{k}={round(value, 2) + 0.0:g}" for k, value in enumerate(told.tolist()))
    rest = f" (the first {len(told)} of {len(values)})" if len(values) > len(told) else ""
    # Older files write it as bytes; "female" holds "male".
    figure = next((f" ({name})" for name in ("female", "male", "neutral") if name in str(gender)), "")
    return (
        f"{path.name}: the shape of the recorded body is not taken over; on an SMPL-family body{figure} it is "
        f"--body-shape {shape}{rest}.",
    )


def read_vto(path: Path) -> Recording:
    """A pickled sequence of the VTO dataset or of HOOD, at 30 fps with Y up; nothing in it is run.

    Args:
        path: a .pkl with `poses` (frames, 72), or `body_pose` (frames, 69) and `global_orient` (frames, 3) as HOOD
            writes them, and `trans` (frames, 3).

    Raises:
        InputError: a key is missing, a shape is wrong, or the pickle asks for code.
    """
    content = load_pickle(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{path} holds a {type(content).__name__}, not the dictionary of a sequence.")
    pose_key = next((key for key in _POSE_KEYS if key in content), None)
    translation_key = next((key for key in _TRANSLATION_KEYS if key in content), None)
    if pose_key is None or translation_key is None:
        wanted = "poses" if pose_key is None else "trans"
        raise InputError(f"{path} has no {wanted}; it holds {told_names(content)}.")
    poses, translations = (stored_numbers(content[key], path, key) for key in (pose_key, translation_key))
    if poses.ndim == 2 and poses.shape[1] == 69 and "global_orient" in content:
        root = stored_numbers(content["global_orient"], path, "global_orient")
        if root.shape != (len(poses), 3):
            raise InputError(f"{path}: global_orient has the shape {root.shape}, not ({len(poses)}, 3).")
        poses = np.concatenate([root, poses], axis=1)
    return _recording(path, poses, translations, _VTO_RATE, z_up=False)


def _recording(path: Path, poses: np.ndarray, translations: np.ndarray, fps: float, z_up: bool) -> Recording:
    """A recording from pose parameters.

    Args:
        path: the file, for messages.
        poses: (frames, 72, 156 or 165) rotation vectors of the joints, each from its parent [rad].
        translations: (frames, 3) [m].
        fps: frames per second.
        z_up: whether files of this kind have Z up; the other axis is taken where the pelvis plainly stands on it.

    Raises:
        InputError: a shape is wrong, there are no frames or values that are not finite.
    """
    if poses.ndim != 2 or poses.shape[1] not in _FAMILY_OF_WIDTH:
        widths = ", ".join(f"{width} ({family})" for width, family in sorted(_FAMILY_OF_WIDTH.items()))
        raise InputError(f"{path}: poses have the shape {poses.shape}; each frame should hold {widths} numbers.")
    if translations.shape != (len(poses), 3):
        raise InputError(f"{path}: translations have the shape {translations.shape}, not ({len(poses)}, 3).")
    if not len(poses):
        raise InputError(f"{path} holds no frames.")
    require_rate(fps, path)
    Allowance(path).take(32 * poses.size // 3, "rotations of its joints")
    skeleton = nominal_skeleton(_FAMILY_OF_WIDTH[poses.shape[1]])
    numbers = np.concatenate([poses, translations], axis=1, dtype=np.float64)
    local = from_axis_angle(finite_frames(numbers, path)[:, :-3].reshape(len(poses), -1, 3))
    sequence = PoseSequence(world_rotations(local, skeleton.parents), numbers[:, -3:], fps)
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
