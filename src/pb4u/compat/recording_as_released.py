"""SMPL recordings played as they are: at their own place and height, with their own shape (the released code's way)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence, world_rotations
from pb4u.body.smpl import BETA_RANGE, JOINT_NAMES
from pb4u.errors import InputError, warn
from pb4u.geometry.rotation import about_axis, from_axis_angle, multiply, slerp
from pb4u.io.array_archive import member_names, read_arrays
from pb4u.io.reading_limits import names_text
from pb4u.io.restricted_pickle import load_pickle
from pb4u.io.stored_numbers import stored_numbers
from pb4u.motion.library import AS_RECORDED
from pb4u.motion.motion import MotionAsRecorded, Performed
from pb4u.motion.recording import finite_frames

FPS = 30.0
"""Frames per second at which all recordings of the released code are played [1/s]."""
_SAME_SPEED = 0.005
"""Share by which a recording may be played slower without a word."""
_JOINTS = len(JOINT_NAMES["smpl"])
_HANDS = JOINT_NAMES["smpl"].index("left_hand")
_LEFT_SHOULDER, _RIGHT_SHOULDER = (JOINT_NAMES["smpl"].index(f"{side}_shoulder") for side in ("left", "right"))


@dataclass(frozen=True, eq=False)
class SmplSequence:
    """Pose parameters of SMPL, as the released code has them after reading.

    Args:
        poses: (frames, 24, 3) rotation vectors of the joints from their parents [rad].
        translations: (frames, 3) [m].
        betas: (shape parameters,) [1].
    """

    poses: np.ndarray
    translations: np.ndarray
    betas: np.ndarray


class RecordingAsItIs(MotionAsRecorded):
    """A recording of SMPL without any change: not rotated, not moved, not placed on the ground, not resampled.

    Hands are held flat, as the released code does on loading. `arms_away` turns the shoulders about z by that angle.

    Args:
        path: pickle of `body_pose`, `global_orient`, `transl`, `betas`, or of `pose`, `translation`, `shape` (VTO), or
            an .npz of AMASS.
        crop: (first, stop) frames to keep, counted at the recording's own rate.
        arms_away_degrees: by which both shoulders are turned outward; 20 in the released code's `separate_arms`.

    Raises:
        InputError: the file is no such recording, or the crop is not inside it.
    """

    def __init__(self, path: Path, crop: tuple[int, int] | None = None, arms_away_degrees: float | None = None) -> None:
        sequence = read_smpl_sequence(path, crop)
        super().__init__(path.stem, (len(sequence.poses) - 1) / FPS)
        self.path = path
        self.betas = sequence.betas
        self._translations = sequence.translations
        self._local = from_axis_angle(sequence.poses)
        self._local[:, _HANDS:] = [1.0, 0.0, 0.0, 0.0]
        for joint, sign in ((_LEFT_SHOULDER, 1.0), (_RIGHT_SHOULDER, -1.0)):
            turn = about_axis("z", np.deg2rad(sign * (arms_away_degrees or 0.0)))
            self._local[:, joint] = multiply(turn, self._local[:, joint])

    @property
    def shape(self) -> dict[str, float]:
        """Shape parameters of the recorded body by the names that SMPL bodies give them."""
        return {f"beta{k}": float(value) for k, value in enumerate(self.betas)}

    def led_in(self, body: ShapedBody, fps: float, frames: int) -> PoseSequence:
        """The whole recording after lead-in frames from the zero pose, with the heading of its first frame.

        Args:
            body: the body that performs it.
            fps: frames per second, which is the recording's own [1/s].
            frames: number of lead-in frames; the released code's N interpolated ones are N + 1 here.

        Raises:
            InputError: another frame rate, or a body that is not of SMPL.
        """
        self._require_rate(fps)
        count = len(self._local)
        local = np.empty((frames + count, _JOINTS, 4))
        local[frames:] = self._local
        zero = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (_JOINTS, 4)).copy()
        zero[0] = self._local[0, 0]
        share = np.arange(frames)[:, None] / max(frames, 1)
        local[:frames] = slerp(np.broadcast_to(zero, (frames, _JOINTS, 4)), self._local[:1], share)
        translations = np.concatenate([np.repeat(self._translations[:1], frames, axis=0), self._translations])
        return self._poses(body, local, translations)

    def _perform(self, body: ShapedBody, fps: float, frames: np.ndarray) -> Performed:
        self._require_rate(fps)
        return Performed(self._poses(body, self._local[frames], self._translations[frames]))

    def _require_rate(self, fps: float) -> None:
        if abs(fps - FPS) > 1e-6 * FPS:
            raise InputError(f"{self.name} is played as recorded, at {FPS:g} frames per second and not at {fps:g}.")

    def _poses(self, body: ShapedBody, local: np.ndarray, translations: np.ndarray) -> PoseSequence:
        if body.family != "smpl":
            raise InputError(
                f"{self.path} is a recording of SMPL, which only an SMPL body can play as recorded; {body.name} has "
                f"{body.skeleton.bone_count} bones of another skeleton. Leave --as-recorded out to retarget it."
            )
        root = body.skeleton.joints[0] - np.array([0.0, body.lift, 0.0])
        return PoseSequence(world_rotations(local, body.skeleton.parents), translations + root, FPS)


AS_RECORDED.update(dict.fromkeys((".pkl", ".npz"), RecordingAsItIs))


def read_smpl_sequence(path: Path, crop: tuple[int, int] | None = None) -> SmplSequence:
    """Pose parameters in a file of the released code, of VTO or of AMASS, at 30 frames per second with Y up.

    Args:
        path: the .pkl or .npz.
        crop: (first, stop) frames to keep, counted at the recording's own rate.

    Raises:
        InputError: it is not such a file, has another skeleton or values that are not finite, or the crop is not
            inside.
    """
    if not path.is_file():
        raise InputError(f'There is no motion file "{path}".')
    sequence, step = _read_amass(path) if path.suffix.lower() == ".npz" else (_read_pickle(path), 1)
    poses, translations, betas = sequence.poses, sequence.translations, sequence.betas
    if poses.shape[1:] != (_JOINTS, 3) or translations.shape != (len(poses), 3) or not len(poses) or betas.ndim != 1:
        raise InputError(
            f"{path}: poses {poses.shape}, translations {translations.shape} and shape {betas.shape} do not belong to "
            f"frames of {_JOINTS} joints."
        )
    finite_frames(np.concatenate([poses.reshape(len(poses), -1), translations], axis=1), path)
    low, _, high = BETA_RANGE
    if not ((betas >= low) & (betas <= high)).all():
        raise InputError(f"{path}: its shape has numbers outside {low:g} to {high:g}; save one within them.")
    first, stop = crop or (0, len(poses))
    if not 0 <= first < stop <= len(poses):
        raise InputError(f"{path}: the crop {first}:{stop} is not inside the recording of {len(poses)} frames.")
    return SmplSequence(poses[first:stop:step], translations[first:stop:step], betas)


def _read_pickle(path: Path) -> SmplSequence:
    content = load_pickle(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{path} holds a {type(content).__name__}, not the dictionary of a recording.")
    if "pose" in content:
        poses, translations, shape = (_numbers(path, content, key) for key in ("pose", "translation", "shape"))
        if poses.ndim != 2 or poses.shape[1] != 3 * _JOINTS or shape.ndim != 2:
            raise _of_another_skeleton(path, poses)
        return SmplSequence(poses.reshape(-1, _JOINTS, 3), translations, shape[0])
    body, root, translations, betas = (
        _numbers(path, content, key) for key in ("body_pose", "global_orient", "transl", "betas")
    )
    if body.ndim != 2 or body.shape[1] != 3 * (_JOINTS - 1) or root.shape != (len(body), 3):
        raise _of_another_skeleton(path, body)
    return SmplSequence(np.concatenate([root, body], axis=1).reshape(-1, _JOINTS, 3), translations, betas.reshape(-1))


def _read_amass(path: Path) -> tuple[SmplSequence, int]:
    """All frames at their own rate, and how many of these the released code counts as one at its rate."""
    names = ("poses", "trans", "betas", "mocap_framerate")
    file = read_arrays(path, names)
    if missing := [name for name in names if name not in file]:
        raise InputError(f"{path} has no {' and no '.join(missing)}; it holds {names_text(member_names(path))}.")
    poses, translations, betas, rate = (_numbers(path, file, name) for name in names)
    if poses.ndim != 2 or poses.shape[1] < 3 * _JOINTS or translations.shape != (len(poses), 3):
        raise _of_another_skeleton(path, poses)
    if rate.size != 1 or not FPS <= float(rate) < 1e4:
        raise InputError(f"{path} was recorded at {rate} frames per second; {FPS:g} or more are needed.")
    step = int(float(rate) / FPS)
    speed = step * FPS / float(rate)
    if abs(speed - 1.0) > _SAME_SPEED:
        warn(
            f"{path.name}: recorded at {float(rate):g} frames per second; as in the released code, one frame of every "
            f"{step} is played, at {FPS:g} frames per second: {speed:.2f} times the recorded speed."
        )
    x, y, z = translations.T
    joints = _turned_upright(poses[:, : 3 * _JOINTS].reshape(-1, _JOINTS, 3))
    return SmplSequence(joints, np.stack([x, z, -y], axis=1), betas.reshape(-1)[:10]), step


def _turned_upright(joints: np.ndarray) -> np.ndarray:
    """Joints (frames, 24, 3) with the root turned by -90 degrees about x; the pelvis is not moved with it."""
    upright = joints.copy()
    turned = multiply(about_axis("x", np.deg2rad(-90.0)), from_axis_angle(joints[:, 0]))
    length = np.linalg.norm(turned[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(length, turned[:, 0])
    upright[:, 0] = turned[:, 1:] * (angle / np.maximum(length, 1e-12))[:, None]
    return upright


def _numbers(path: Path, content: Mapping, key: str) -> np.ndarray:
    if key not in content:
        raise InputError(f"{path} has no {key}; it holds {names_text(content)}.")
    return stored_numbers(content[key], path, key).astype(np.float64, copy=False)


def _of_another_skeleton(path: Path, poses: np.ndarray) -> InputError:
    return InputError(
        f"{path} is a recording of another skeleton than SMPL's {_JOINTS} joints: its poses have the shape "
        f"{poses.shape}; leave out --as-recorded to retarget it."
    )
