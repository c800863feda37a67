"""Sequences of the VTO dataset and of HOOD (.pkl): SMPL poses, 72 numbers a frame."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pb4u.errors import InputError
from pb4u.motion.recording import Recording
from pb4u.motion.smpl_recording import smpl_recording
from pb4u.restricted_pickle import load_pickle

FRAME_RATE = 30.0
_POSE_KEYS = ("poses", "pose", "body_pose")
_TRANSLATION_KEYS = ("trans", "translation", "transl")


def read_vto(path: Path) -> Recording:
    """Read a pickled sequence, `poses` (frames, 72) and `trans` (frames, 3), at 30 fps with Y up; nothing in it is run.

    `body_pose` (frames, 69) with `global_orient` (frames, 3), as HOOD writes them, is joined to 72.
    Raises InputError on missing keys, wrong shapes, or a pickle that asks for code.
    """
    content = load_pickle(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{path} holds a {type(content).__name__}, not the dictionary of a sequence.")
    pose_key = next((key for key in _POSE_KEYS if key in content), None)
    translation_key = next((key for key in _TRANSLATION_KEYS if key in content), None)
    if pose_key is None or translation_key is None:
        wanted = "poses" if pose_key is None else "trans"
        raise InputError(f"{path} has no {wanted}; it holds {', '.join(sorted(map(str, content))[:10])}.")
    poses, translations = _numbers(path, content[pose_key], pose_key), _numbers(path, content[translation_key], "trans")
    if poses.ndim == 2 and poses.shape[1] == 69 and "global_orient" in content:
        root = _numbers(path, content["global_orient"], "global_orient")
        if root.shape != (len(poses), 3):
            raise InputError(f"{path}: global_orient has the shape {root.shape}, not ({len(poses)}, 3).")
        poses = np.concatenate([root, poses], axis=1)
    return smpl_recording(path, poses, translations, FRAME_RATE, z_up=False)


def _numbers(path: Path, value: object, key: str) -> np.ndarray:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f'{path}: "{key}" is not an array of numbers.') from None
