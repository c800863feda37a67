"""Motion that GVHMR (Shen et al. 2024) finds in a video: its `hmr4d_results.pt`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.io.reading_limits import names_text
from pb4u.io.restricted_pickle import load_tensors
from pb4u.motion.recording import Recording
from pb4u.motion.smpl_recording import full_poses, shape_note, smpl_recording

# The demo resamples its video to this rate and numbers the frames by it.
_RATE = 30.0
_PARAMETERS = "smpl_params_global"


def read_gvhmr(path: Path) -> Recording:
    """The motion in the world of a `hmr4d_results.pt`: SMPL-X at 30 frames per second, gravity along -Y.

    Only tensors are read (`torch.load(weights_only=True)`), and only those of the motion.

    Args:
        path: the .pt, with `smpl_params_global`: `global_orient` (frames, 3), `body_pose` (frames, 63), `transl`
            (frames, 3) and `betas`.

    Raises:
        InputError: it is of another kind, would run code, lacks a part, or holds values that are not finite.
    """
    content = load_tensors(path)
    parameters = content.get(_PARAMETERS) if isinstance(content, Mapping) else None
    if not isinstance(parameters, Mapping):
        shown = names_text(content) if isinstance(content, Mapping) else f"a {type(content).__name__}"
        raise InputError(
            f"{path} is not a result of GVHMR: it has no {_PARAMETERS} and holds {shown}; give its hmr4d_results.pt, "
            "or "
            "weights as --model."
        )
    arrays = {name: _array(path, name, value) for name, value in parameters.items() if value is not None}
    poses, translations = full_poses(path, arrays)
    recording = smpl_recording(path, poses, translations, _RATE, told_by="its program")
    notes = (*recording.notes, *shape_note(path, arrays.get("betas")))
    return replace(recording, notes=notes, from_video=True)


def _array(path: Path, name: str, value: Any) -> np.ndarray:
    import torch

    if not isinstance(value, torch.Tensor) or value.is_complex() or value.is_sparse or value.is_quantized:
        raise InputError(f'{path}: its "{name}" is not an array of numbers.')
    return value.detach().double().numpy()
