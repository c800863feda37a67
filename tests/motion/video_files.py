"""Files of motion from videos, in the layout of the programs that write them, from poses of an SMPL skeleton.

Read for it: GVHMR `tools/demo/demo.py` and `gvhmr_pl_demo.py`, WHAM `demo.py`, TRAM `scripts/estimate_humans.py` and
`scripts/estimate_camera.py`.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.geometry.rotation import conjugate, multiply
from pb4u.motion.library import load_motion

TRIALS = ("07/07_02", "16/16_11")


def trial(test_data: Path, name: str, body: ShapedBody) -> PoseSequence:
    """A CMU trial performed by a body at 30 frames per second."""
    motion = load_motion(test_data / f"motions/cmu_asfamc/{name}.amc", arms_away_degrees=0.0)
    return motion.poses(body, 30.0, motion.available_frames(30.0) or 1)


def rotation_vectors(poses: PoseSequence, body: ShapedBody) -> np.ndarray:
    """(frames, joints, 3) [rad], each from its parent."""
    local = poses.rotations.copy()
    for bone, parent in enumerate(body.skeleton.parents.tolist()):
        if parent >= 0:
            local[:, bone] = multiply(conjugate(poses.rotations[:, parent]), poses.rotations[:, bone])
    flat = Rotation.from_quat(local[..., [1, 2, 3, 0]].reshape(-1, 4)).as_rotvec()
    return flat.reshape(*local.shape[:2], 3)


def write_gvhmr(path: Path, poses: PoseSequence, body: ShapedBody) -> Path:
    """A `hmr4d_results.pt`, of a body of SMPL-X."""
    vectors = rotation_vectors(poses, body)
    frames = len(vectors)
    parameters = {
        "body_pose": _tensor(vectors[:, 1:22].reshape(frames, 63)),
        "betas": torch.full((frames, 10), 0.5),
        "global_orient": _tensor(vectors[:, 0]),
        "transl": _tensor(poses.root_positions),
    }
    outputs = {"model_output": {"pred_x": torch.zeros(1, frames, 151)}, "pred_smpl_params_global": parameters}
    incam = {**parameters, "transl": parameters["transl"] + 3.0}
    intrinsics = torch.eye(3).repeat(frames, 1, 1)
    torch.save(
        {
            "smpl_params_global": parameters,
            "smpl_params_incam": incam,
            "K_fullimg": intrinsics,
            "net_outputs": outputs,
        },
        path,
    )
    return path


def wham_people(
    performed: dict[int, PoseSequence], body: ShapedBody, kept: dict[int, np.ndarray] | None = None
) -> dict[int, dict[str, np.ndarray]]:
    """What WHAM keeps of each person, of a body of SMPL; `kept` are the frames in which a person is seen."""
    people: dict[int, dict[str, np.ndarray]] = defaultdict(dict)
    for number, poses in performed.items():
        rows = (kept or {}).get(number, np.arange(len(poses)))
        pose = rotation_vectors(poses, body).reshape(len(poses), 72).astype(np.float32)[rows]
        translation = poses.root_positions.astype(np.float32)[rows]
        people[np.int64(number)] = {
            "pose": pose,
            "trans": translation + np.float32(2.0),
            "pose_world": pose,
            "trans_world": translation,
            "betas": np.zeros((len(rows), 10), dtype=np.float32),
            "verts": np.zeros((len(rows), 60, 3), dtype=np.float32),
            "frame_ids": rows + 7,
        }
    return people


def write_tram(folder: Path, poses: PoseSequence, body: ShapedBody, tilt: np.ndarray) -> Path:
    """`hps/hps_track_0.npy` and `camera.npy` of a camera that moves, turns and is tilted by `tilt` (3,) [rad]."""
    vectors = rotation_vectors(poses, body)
    frames = len(vectors)
    time = np.arange(frames) / 30.0
    turns = Rotation.from_rotvec(np.stack([0.1 * np.sin(time), 0.2 * time, 0.0 * time], axis=1)).as_matrix()
    places = np.stack([0.4 * time, 0.0 * time, 0.2 * time], axis=1)
    # Images have Y down and Z away from the camera.
    to_camera = Rotation.from_rotvec(tilt).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    matrices = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(frames, 24, 3, 3)
    matrices[:, 0] = np.einsum("fji,jk,fkl->fil", turns, to_camera, matrices[:, 0])
    pelvis = np.array([0.0, -0.22, 0.03])
    shifts = np.einsum("fji,fj->fi", turns, (poses.root_positions + pelvis) @ to_camera.T - places) - pelvis
    (folder / "hps").mkdir()
    found = {
        "pred_cam": torch.zeros(frames, 3),
        "pred_pose": torch.zeros(frames, 144),
        "pred_shape": torch.zeros(frames, 10),
        "pred_rotmat": _tensor(matrices),
        "pred_trans": _tensor(shifts)[:, None],
        "frame": torch.arange(frames),
    }
    np.save(folder / "hps/hps_track_0.npy", found)  # type: ignore[arg-type]
    camera = {
        "pred_cam_R": turns.astype(np.float32),
        "pred_cam_T": places.astype(np.float32),
        "img_focal": np.float64(1000.0),
        "img_center": np.array([640.0, 360.0]),
    }
    np.save(folder / "camera.npy", camera)  # type: ignore[arg-type]
    return folder / "hps/hps_track_0.npy"


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
