"""AMASS recordings (.npz) of SMPL, SMPL-H and SMPL-X (Mahmood et al. 2019)."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from pb4u.errors import InputError
from pb4u.motion.recording import Recording
from pb4u.motion.smpl_recording import smpl_recording

_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps")


def read_amass(path: Path) -> Recording:
    """Read an AMASS .npz: `poses` (frames, 156 or 165), `trans` (frames, 3) and its frame rate; Z is up.

    Raises InputError on missing keys, wrong shapes, or a file that is no .npz of plain arrays.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            missing = [key for key in ("poses", "trans") if key not in file]
            rate_key = next((key for key in _RATE_KEYS if key in file), None)
            if missing or rate_key is None:
                wanted = missing or [" or ".join(_RATE_KEYS[:2])]
                raise InputError(f"{path} has no {' and no '.join(wanted)}; it holds {', '.join(sorted(file)[:10])}.")
            poses, translations, rate = file["poses"], file["trans"], file[rate_key]
    except InputError:
        raise
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise InputError(f"{path} cannot be read as an .npz of plain arrays ({error}).") from None
    if rate.size != 1 or not all(np.issubdtype(a.dtype, np.number) for a in (poses, translations, rate)):
        raise InputError(f"{path}: poses, trans and {rate_key} should be numbers, the last a single one.")
    return smpl_recording(path, poses, translations, float(rate.reshape(-1)[0]), z_up=True)
