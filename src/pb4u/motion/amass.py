"""AMASS recordings (.npz) of SMPL, SMPL-H and SMPL-X (Mahmood et al. 2019)."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from pb4u.errors import InputError
from pb4u.motion.recording import Recording
from pb4u.motion.smpl_recording import smpl_recording

_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps")
_SLIGHT_BETA, _BETAS_TOLD = 0.05, 4


def read_amass(path: Path) -> Recording:
    """Read an AMASS .npz: `poses` (frames, 156 or 165), `trans` (frames, 3) and its frame rate; Z is up.

    Its `betas` and `gender` are told in a note: any body may perform the motion.
    Raises InputError on missing keys, wrong shapes, or a file that is no .npz of plain arrays.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            missing = [key for key in ("poses", "trans") if key not in file]
            if missing and "faces" in file and {"positions", "vertices"} & set(file):
                raise InputError(f"{path} is a body that moves, not a recording; give it as --body {path}.")
            rate_key = next((key for key in _RATE_KEYS if key in file), None)
            if missing or rate_key is None:
                wanted = missing or [" or ".join(_RATE_KEYS[:2])]
                raise InputError(f"{path} has no {' and no '.join(wanted)}; it holds {', '.join(sorted(file)[:10])}.")
            poses, translations, rate = file["poses"], file["trans"], file[rate_key]
            betas, gender = (_optional(file, key) for key in ("betas", "gender"))
    except InputError:
        raise
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise InputError(f"{path} cannot be read as an .npz of plain arrays ({error}).") from None
    if rate.size != 1 or not all(np.issubdtype(a.dtype, np.number) for a in (poses, translations, rate)):
        raise InputError(f"{path}: poses, trans and {rate_key} should be numbers, the last a single one.")
    recording = smpl_recording(path, poses, translations, float(rate.reshape(-1)[0]), z_up=True)
    return replace(recording, notes=(*recording.notes, *_shape_note(path, betas, gender)))


def _optional(file: np.lib.npyio.NpzFile, key: str) -> np.ndarray | None:
    try:
        return np.asarray(file[key])
    except (KeyError, ValueError):  # absent, or a pickled object: a recording is used without
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
