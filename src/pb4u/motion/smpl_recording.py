"""Recordings given as SMPL, SMPL-H or SMPL-X pose parameters: files of AMASS, and of the VTO dataset and HOOD."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from pb4u.body.skeleton import PoseSequence, Skeleton, joint_positions, world_rotations
from pb4u.body.smpl import JOINT_NAMES
from pb4u.errors import InputError
from pb4u.geometry.rotation import from_axis_angle, multiply, rotate
from pb4u.io.array_archive import member_names, read_arrays
from pb4u.io.reading_limits import names_text
from pb4u.io.stored_numbers import stored_numbers
from pb4u.motion.correspondences import SMPL
from pb4u.motion.recording import Recording, finite_frames, require_rate
from pb4u.motion.up_axis import floor_misfit

_FAMILY_OF_WIDTH = {3 * len(names): family for family, names in JOINT_NAMES.items()}
ToldBy: TypeAlias = Literal["its program", "its keys", "nothing"]
"""What tells which axis of a file is up: the one program that writes it, what usually has its keys, or nothing."""
_AXES = {"Y": np.array([0.0, 1.0, 0.0]), "Z": np.array([0.0, 0.0, 1.0]), "-Y": np.array([0.0, -1.0, 0.0])}
_TO_Y_UP = {"Z": np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]), "-Y": np.array([0.0, 1.0, 0.0, 0.0])}
# Share of its length that the pelvis' upward axis has along another on average where it plainly points there.
_PLAIN = 0.7
# Places of the pelvis in bodies at rest [m]: not taken in, of SMPL and of SMPL-X.
_PELVES = np.array([[0.0, 0.0, 0.0], [0.0, -0.22, 0.03], [0.0, -0.35, 0.01]])
# A floor fits better by so much [m], and not at all beyond so much. A root that begins so near [m] was put there.
_BETTER, _NO_FLOOR, _AT_ORIGIN = 0.05, 0.5, 0.02
_ARMS = tuple(
    f"{side}_{part}"
    for side in ("left", "right")
    for part in ("elbow", "wrist", "hand", "thumb", "index", "middle", "ring", "pinky")
)

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
_WHOLE_POSE_KEYS = ("poses", "pose", "smpl_poses")
_POSE_KEYS = (*_WHOLE_POSE_KEYS, "body_pose")
_TRANSLATION_KEYS = ("trans", "translation", "transl", "smpl_trans")
# What SMPL-X has after its body, in its order -> numbers a frame.
_SMPLX_PARTS = {"jaw_pose": 3, "leye_pose": 3, "reye_pose": 3, "left_hand_pose": 45, "right_hand_pose": 45}
# The files do not tell their rate; it is that of the released VTO sequences.
_VTO_RATE = 30.0
# That of AIST++ (Li et al. 2021), whose places are in a unit of `smpl_scaling` to the metre.
_AIST_RATE = 60.0
# A recorded shape is reported where a beta exceeds this, else it counts as average; so many betas are reported.
_SLIGHT_BETA, _BETAS_TOLD = 0.05, 4


def read_amass(path: Path) -> Recording:
    """An AMASS recording (Mahmood et al. 2019) of SMPL, SMPL-H or SMPL-X, with Z up as AMASS has it.

    A note reports its `betas` and `gender`: any body may perform the motion.

    Args:
        path: an .npz with `poses` (frames, 72, 156 or 165), `trans` (frames, 3) and a frame rate; the rate is NaN where
            it has none. Under other usual names of these entries Y is up, unless the frames show otherwise.

    Raises:
        InputError: a key is missing, a shape is wrong, or it is no .npz of plain arrays.
    """
    names = set(member_names(path))
    if {"global_orient", "body_pose"} <= names:
        return _joint_by_joint(path, names)
    pose_key, translation_key = (
        next((key for key in (first, *keys) if key in names), first)
        for first, keys in (("poses", _WHOLE_POSE_KEYS), ("trans", _TRANSLATION_KEYS))
    )
    missing = [key for key in (pose_key, translation_key) if key not in names]
    if missing and "faces" in names and {"positions", "vertices"} & names:
        raise InputError(f"{path} is a body that moves, not a recording; give it as --body {path}.")
    rate_key = next((key for key in _RATE_KEYS if key in names), None)
    if {"pose_world", "trans_world", "imgname"} <= names:
        raise InputError(
            f"{path} labels images of BEDLAM: each row of its pose_world and trans_world is one person in one image; "
            "give a file of BEDLAM's motions, which has poses and trans, or save the rows of one person as these."
        )
    if missing:
        shown = names_text(names, ("pose", "trans", "orient"))
        way = "give a motion that lies beside it" if shown == "betas, gender" else "save a motion under these names"
        raise InputError(f"{path} has no {' and no '.join(missing)}; it holds {shown}: {way}.")
    file = read_arrays(path, (pose_key, translation_key, *([] if rate_key is None else [rate_key])))
    poses, translations = file[pose_key], file[translation_key]
    rate = np.array(np.nan) if rate_key is None else file[rate_key]
    betas, gender = (_optional(path, key) for key in ("betas", "gender"))
    if rate.size != 1 or not all(a.dtype.kind in "iuf" for a in (poses, translations, rate)):
        expected = f"{pose_key}, {translation_key} and {rate_key}"
        raise InputError(f"{path}: {expected} should be numbers, the last a single one.")
    of_amass = (pose_key, translation_key) == ("poses", "trans")
    recording = smpl_recording(
        path, poses, translations, float(rate.reshape(-1)[0]), of_amass, "its keys" if of_amass else "nothing"
    )
    return replace(recording, notes=(*recording.notes, *shape_note(path, betas, gender)))


def _joint_by_joint(path: Path, names: set[str]) -> Recording:
    """A recording whose poses are split into root, body and hands, as the programs write them that fit SMPL-X."""
    keys = ("global_orient", "body_pose", *_SMPLX_PARTS, *_TRANSLATION_KEYS, "betas", *_RATE_KEYS)
    file = {key: stored_numbers(value, path, key) for key, value in read_arrays(path, keys).items()}
    poses, translations = full_poses(path, file)
    rate = next((file[key] for key in _RATE_KEYS if key in names), np.array(_VTO_RATE))
    if rate.size != 1:
        raise InputError(f"{path}: its frame rate should be a single number.")
    recording = smpl_recording(path, poses, translations, float(rate.reshape(-1)[0]))
    return replace(recording, notes=(*recording.notes, *shape_note(path, file.get("betas"))))


def _optional(path: Path, key: str) -> np.ndarray | None:
    try:
        return read_arrays(path, (key,)).get(key)
    except InputError:  # a pickled object: a recording is used without
        return None


def shape_note(path: Path, betas: np.ndarray | None, gender: np.ndarray | None = None) -> tuple[str, ...]:
    """Note on the recorded body shape, if the file has one: the body is chosen independently of the motion.

    Args:
        path: the file, for the sentence.
        betas: (..., shape parameters) [1]; of several rows the first is reported.
        gender: text, as files have it.
    """
    if betas is None or betas.dtype.kind != "f" or not betas.size:
        return ()
    values = betas.reshape(-1, betas.shape[-1])[0] if betas.ndim else betas.reshape(1)
    if not np.isfinite(values).all() or np.abs(values).max() <= _SLIGHT_BETA:
        return ()
    first = values[:_BETAS_TOLD]
    shape = ",".join(f"beta{k}={round(value, 2) + 0.0:g}" for k, value in enumerate(first.tolist()))
    rest = f" (the first {len(first)} of {len(values)})" if len(values) > len(first) else ""
    # Older files write it as bytes; "female" holds "male".
    figure = next((f" ({name})" for name in ("female", "male", "neutral") if name in str(gender)), "")
    return (
        f"{path.name}: the shape of the recorded body is not taken over; on an SMPL-family body{figure} it is "
        f"--body-shape {shape}{rest}.",
    )


def vto_recording(path: Path, content: Any) -> Recording:
    """A sequence of the VTO dataset or of HOOD, at 30 fps, or of AIST++, at 60 fps; Y up.

    Args:
        path: the file, for messages.
        content: its entries: `poses` (frames, 72), or `body_pose` (frames, 69) and `global_orient` (frames, 3) as
            HOOD writes them, and `trans` (frames, 3); or `smpl_poses`, `smpl_trans` and `smpl_scaling`.

    Raises:
        InputError: a key is missing or a shape is wrong.
    """
    if not isinstance(content, Mapping):
        raise InputError(
            f"{path} holds a {type(content).__name__}, not the dictionary of a sequence; give the recording itself."
        )
    pose_key = next((key for key in _POSE_KEYS if key in content), None)
    translation_key = next((key for key in _TRANSLATION_KEYS if key in content), None)
    if pose_key is None or translation_key is None:
        expected = "poses" if pose_key is None else "trans"
        shown = names_text(content, ("pose", "trans", "orient"))
        raise InputError(f"{path} has no {expected}; it holds {shown}: save a motion under this name.")
    poses, translations = (stored_numbers(content[key], path, key) for key in (pose_key, translation_key))
    if poses.ndim == 2 and poses.shape[1] == 69 and "global_orient" in content:
        root = stored_numbers(content["global_orient"], path, "global_orient")
        if root.shape != (len(poses), 3):
            raise InputError(f"{path}: global_orient has the shape {root.shape}, not ({len(poses)}, 3).")
        poses = np.concatenate([root, poses], axis=1)
    if "smpl_scaling" not in content:
        return smpl_recording(path, poses, translations, _VTO_RATE, told_by="its keys")
    scaling = stored_numbers(content["smpl_scaling"], path, "smpl_scaling")
    if scaling.size != 1 or not float(scaling.reshape(-1)[0]) > 0.0:
        raise InputError(f"{path}: smpl_scaling should be a single number above 0.")
    return smpl_recording(path, poses, translations / float(scaling.reshape(-1)[0]), _AIST_RATE, told_by="its keys")


def smpl_recording(
    path: Path,
    poses: np.ndarray,
    translations: np.ndarray,
    fps: float,
    z_up: bool = False,
    told_by: ToldBy = "nothing",
) -> Recording:
    """A recording from pose parameters of the SMPL family.

    Args:
        path: the file, for messages.
        poses: (frames, 72, 156 or 165) rotation vectors of the joints, each from its parent [rad].
        translations: (frames, 3) [m].
        fps: frames per second; NaN if the file does not state it.
        z_up: whether files of this kind have Z up instead of Y.
        told_by: source of this convention, for the message. Unless the writing program is known, another axis is used
            if people stand along it and a floor at 0 fits better; if none fits, the pelvis may decide.

    Raises:
        InputError: a shape is wrong, there are no frames or values that are not finite.
    """
    if poses.ndim != 2 or poses.shape[1] not in _FAMILY_OF_WIDTH:
        widths = ", ".join(f"{width} ({family})" for width, family in sorted(_FAMILY_OF_WIDTH.items()))
        raise InputError(f"{path}: poses have the shape {poses.shape}; each frame should hold {widths} numbers.")
    if translations.shape != (len(poses), 3):
        raise InputError(
            f"{path}: translations have the shape {translations.shape}, not ({len(poses)}, 3); save them anew."
        )
    if not len(poses):
        raise InputError(f"{path} holds no frames; export it again.")
    if not np.isnan(fps):
        require_rate(fps, path)
    skeleton = nominal_skeleton(_FAMILY_OF_WIDTH[poses.shape[1]])
    numbers = np.concatenate([poses, translations], axis=1, dtype=np.float64)
    local = from_axis_angle(finite_frames(numbers, path)[:, :-3].reshape(len(poses), -1, 3))
    sequence = PoseSequence(world_rotations(local, skeleton.parents), numbers[:, -3:], fps)
    usual = "Z" if z_up else "Y"
    axis = usual if told_by == "its program" else _up_axis(skeleton, sequence, usual, told_by)
    notes: tuple[str, ...] = ()
    if axis == "-Y":  # the axes of a camera; none have Z down
        notes = (f"{path.name}: turned by 180 degrees about X, since the pelvis points down, as in axes of a camera.",)
    elif axis != usual:
        notes = (f"{path.name}: taken as {axis} up, which is where the pelvis points.",)
    if axis in _TO_Y_UP:
        turn = _TO_Y_UP[axis]
        sequence = PoseSequence(multiply(turn, sequence.rotations), rotate(turn, sequence.root_positions), sequence.fps)
    return Recording(path.stem, SMPL, skeleton, sequence, notes)


def _up_axis(skeleton: Skeleton, sequence: PoseSequence, usual: str, told_by: ToldBy) -> str:
    """The axis that is up: the usual one, or another that the pelvis plainly points along on average.

    That counts where a floor at 0 fits better there. A root that begins at the origin tells no floor. Where none fits,
    the pelvis tells the axes of a camera, unless people are on their hands, and any axis where nothing else tells.
    """
    _, y, z = rotate(sequence.rotations[:, 0], np.array([0.0, 1.0, 0.0])).mean(axis=0)
    if usual == "Z":
        other = ("Y" if y > 0.0 else "-Y") if abs(y) > _PLAIN > abs(z) else None
    else:
        other = "Z" if z > _PLAIN > abs(y) else "-Y" if y < -_PLAIN else None
    if other is None:
        return usual
    joints = joint_positions(skeleton, sequence)

    def misfit(axis: str) -> float:
        direction = _AXES[axis]
        # The root turns about a pelvis that is not at 0, by a height that the file does not tell.
        low = (joints @ direction).min(axis=1)
        return min(floor_misfit(low + direction @ pelvis) for pelvis in _PELVES)

    fits = {axis: misfit(axis) for axis in (usual, other)}
    centred = bool(np.abs(sequence.root_positions[0]).max() < _AT_ORIGIN)
    if not centred and min(fits.values()) <= _NO_FLOOR:
        return other if fits[other] + _BETTER < fits[usual] else usual
    if other != "-Y":
        return other if told_by == "nothing" and not centred else usual
    lowest = (joints @ _AXES[usual]).argmin(axis=1)
    on_hands = np.isin(lowest, [k for k, name in enumerate(skeleton.names) if name.startswith(_ARMS)]).mean() > 0.5
    return usual if on_hands or (centred and usual == "Z") else other


def full_poses(path: Path, parameters: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Poses and translations from separate parameters of SMPL or SMPL-X.

    Args:
        path: the file, for messages.
        parameters: arrays (frames, numbers) [rad] `global_orient` and `body_pose`, of SMPL-X also jaw, eyes and hands
            where there are any, and `transl` or `trans` (frames, 3) [m].

    Returns:
        (frames, 72 or 165) rotation vectors [rad] and (frames, 3) [m].

    Raises:
        InputError: a part is missing or of another shape.
    """
    translation = next((key for key in _TRANSLATION_KEYS if key in parameters), None)
    missing = [key for key in ("global_orient", "body_pose") if key not in parameters]
    if missing or translation is None:
        raise InputError(f"{path} has no {(missing or ['transl'])[0]}; it holds {names_text(parameters)}.")
    body = parameters["body_pose"]
    frames = len(body) if body.ndim else 0
    if not frames:
        raise InputError(f"{path} holds no frames; export it again.")
    body = body.reshape(frames, -1)
    widths = {"global_orient": 3, "body_pose": body.shape[1], **_SMPLX_PARTS}
    if body.shape[1] not in (63, 69):
        raise InputError(f"{path}: body_pose has {body.shape[1]} numbers a frame; SMPL-X has 63 and SMPL 69.")
    if body.shape[1] == 69:
        widths = dict(list(widths.items())[:2])
    parts = []
    for key, width in widths.items():
        part = parameters.get(key, np.zeros((frames, width)))
        if part.size != frames * width:
            if key in _SMPLX_PARTS:  # hands as a few components of a basis that the file does not hold
                part = np.zeros((frames, width))
            else:
                raise InputError(f"{path}: {key} has the shape {part.shape}, not ({frames}, {width}).")
        parts.append(part.reshape(frames, width))
    places = parameters[translation]
    return np.concatenate(parts, axis=1), places.reshape(frames, 3) if places.size == 3 * frames else places


def nominal_skeleton(family: str) -> Skeleton:
    """An average adult with the joints of an SMPL family; fingers are at the wrists.

    Args:
        family: "smpl", "smplh" or "smplx".
    """
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
