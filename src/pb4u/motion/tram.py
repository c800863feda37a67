"""Motion that TRAM (Wang et al. 2024) finds in a video: `hps/hps_track_0.npy`, one file a person, and `camera.npy`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.body.skeleton import joint_positions
from pb4u.errors import InputError
from pb4u.io.reading_limits import names_text
from pb4u.io.restricted_pickle import load_object_array
from pb4u.io.stored_numbers import stored_numbers
from pb4u.motion.recording import Recording
from pb4u.motion.repair import without_gaps
from pb4u.motion.smpl_recording import shape_note, smpl_recording

_WANTED = (
    "Give the hps_track_0.npy of TRAM; places of joints without rotations, as of HumanML3D and MDM, are not read: "
    "export BVH."
)
# The files do not tell the rate of their video.
_RATE = 30.0
# The pelvis of the average SMPL body at rest [m], about which its root turns; the file of the body is not needed.
_PELVIS = np.array([0.0, -0.22, 0.03])
# Images have Y down and Z away from the camera.
_UPRIGHT = np.diag([1.0, -1.0, -1.0])
# A camera that is held askew by so much [deg] is levelled by where the feet stand.
_ASKEW = 12.0
# Someone stands whose neck is this share of its height at rest away from the feet, on average, and upward within 45
# degrees for the camera.
_STANDS, _UPRIGHT_CAMERA = 0.8, np.sqrt(0.5)


def read_tram(path: Path) -> Recording:
    """The motion of one person in the world of a camera that moves, an SMPL recording.

    If the camera's file has no gravity, up is the direction in which the person stands.

    Args:
        path: the .npy, with `pred_rotmat` (frames, 24, 3, 3), `pred_trans` (frames, 1, 3), `pred_shape` and `frame`;
            `camera.npy` must be beside it or one folder up.

    Raises:
        InputError: a file or a part of it is missing or does not fit, or would run code.
    """
    person = _dictionary(path, ("pred_rotmat", "pred_trans", "frame"))
    beside = [folder / "camera.npy" for folder in (path.parent, path.absolute().parent.parent)]
    camera_file = next((file for file in beside if file.is_file()), None)
    if camera_file is None:
        raise InputError(f"{path} needs the camera.npy that TRAM writes with it; put it into {path.parent}.")
    in_world = "world_cam_R" in load_object_array(camera_file)
    keys = ("world_cam_R", "world_cam_T") if in_world else ("pred_cam_R", "pred_cam_T")
    camera = _dictionary(camera_file, keys)
    frames = person["frame"].reshape(-1)
    turns, places = (camera[key].astype(np.float64) for key in keys)
    matrices, shifts = person["pred_rotmat"].astype(np.float64), person["pred_trans"].reshape(-1, 3).astype(np.float64)
    if matrices.ndim != 4 or matrices.shape[1:] != (24, 3, 3) or not len(matrices) == len(shifts) == len(frames):
        raise InputError(f"{path}: pred_rotmat has the shape {matrices.shape}, not ({len(frames)}, 24, 3, 3).")
    if turns.shape != (len(places), 3, 3) or frames.dtype.kind not in "iu" or frames.size == 0:
        raise InputError(
            f"{camera_file}: {keys[0]} has the shape {turns.shape}; it must hold one rotation a frame; run TRAM again."
        )
    if frames.min() < 0 or frames.max() >= len(turns):
        raise InputError(
            f"{path} has frame {frames.max()}, and {camera_file} has {len(turns)}; the two come from different "
            "videos: put its own camera.npy beside it."
        )
    if not (np.isfinite(matrices).all() and np.isfinite(turns).all() and (np.linalg.det(matrices) > 0.1).all()):
        raise InputError(f"{path}: pred_rotmat holds values that are not finite or not a rotation; run TRAM again.")
    flip = np.eye(3) if in_world else _UPRIGHT
    world, origin = flip @ turns[frames], places[frames] @ flip.T
    matrices[:, 0] = world @ matrices[:, 0]
    roots = np.einsum("fij,fj->fi", world, shifts + _PELVIS) + origin - _PELVIS
    poses = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_rotvec().reshape(len(frames), 72)
    recording = smpl_recording(path, poses, roots, _RATE, told_by="its program")
    recording = replace(recording, from_video=True, askew=_ASKEW)
    recording = without_gaps(recording if in_world else _stood_up(recording), frames)
    note = shape_note(path, stored_numbers(person["pred_shape"], path, "pred_shape")) if "pred_shape" in person else ()
    return replace(recording, notes=(*recording.notes, *note))


def _dictionary(path: Path, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
    try:
        content = load_object_array(path)
    except InputError as error:
        raise InputError(f"{error} {_WANTED}") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{path} holds a {type(content).__name__}, not the dictionary that TRAM writes. {_WANTED}")
    if missing := [key for key in keys if key not in content]:
        raise InputError(f"{path} has no {missing[0]}; it holds {names_text(content)}. {_WANTED}")
    return {key: stored_numbers(content[key], path, key) for key in (*keys, "pred_shape") if key in content}


def _stood_up(recording: Recording) -> Recording:
    """The recording turned so that someone who stands does so along Y, on average from the feet to the neck.

    The camera says it of others, who sit, lie or crawl, as cameras are held nearly upright.
    """
    joints = joint_positions(recording.skeleton, recording.poses)
    feet = 0.5 * (joints[:, recording.joint_index("foot.L")] + joints[:, recording.joint_index("foot.R")])
    up = (joints[:, recording.joint_index("neck_lower")] - feet).mean(axis=0)
    length = float(np.linalg.norm(up))
    rest = recording.skeleton.joints
    height = rest[recording.joint_index("neck_lower"), 1] - rest[recording.joint_index("foot.L"), 1]
    upright = length > _STANDS * height and up[1] > _UPRIGHT_CAMERA * length
    return recording.stood_up(up / length) if upright else recording
