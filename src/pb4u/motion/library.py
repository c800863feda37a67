"""Motions by name or file."""

from __future__ import annotations

from pathlib import Path
from pkgutil import resolve_name

from pb4u.errors import InputError, unknown_name
from pb4u.motion.ground import on_level_ground
from pb4u.motion.motion import Motion
from pb4u.motion.procedural import CLIPS, ProceduralMotion
from pb4u.motion.recording import Recording
from pb4u.motion.repair import told_of_leaps, without_false_start, without_flips
from pb4u.motion.retargeting import RecordedMotion

READERS = {
    ".amc": "pb4u.motion.asf_amc:read_amc",
    ".bvh": "pb4u.motion.bvh:read_bvh",
    ".npz": "pb4u.motion.smpl_recording:read_amass",
    ".pkl": "pb4u.motion.smpl_recording:read_vto",
}
"""Suffix -> function of a path that gives its `Recording`; another format is one more line here."""
SUFFIXES = tuple(READERS)


def motion_names() -> tuple[str, ...]:
    """Names of the built-in procedural clips."""
    return tuple(CLIPS)


def load_motion(
    name_or_path: str | Path,
    crop: tuple[int, int] | None = None,
    *,
    seed: int = 0,
    arms_away_degrees: float | None = None,
) -> Motion:
    """A built-in clip by name, or a recording by path; the suffix decides how it is read.

    Args:
        name_or_path: one of `motion_names()`, or an .amc (with its .asf beside it), .bvh, AMASS .npz or VTO/HOOD .pkl.
        crop: (first, stop) frames to keep, counted at the recording's own rate.
        seed: varies tempo and amplitude of a built-in clip a little.
        arms_away_degrees: see `Motion`.

    Raises:
        InputError: the name is unknown, the file unreadable, or the crop not inside the recording.
    """
    name = str(name_or_path)
    if name in CLIPS:
        if crop is not None:
            raise InputError(f'The built-in motion "{name}" has no end to crop; ask for the frames you want.')
        return ProceduralMotion(name, seed=seed, arms_away_degrees=arms_away_degrees)
    path = Path(name)
    if path.suffix.lower() == ".asf":
        raise InputError(f"{path} holds the skeleton alone; give the .amc file beside it, which holds the motion.")
    if path.is_file() and path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path} is of no kind of motion file that is read; those end in {', '.join(SUFFIXES)}.")
    if path.suffix.lower() not in SUFFIXES:
        raise unknown_name("motion", name, CLIPS)
    recording = read_recording(path)
    # The crop comes first: bad frames are often what it is there to leave out.
    recording = without_false_start(recording) if crop is None else recording.cropped(*crop)
    return RecordedMotion(on_level_ground(told_of_leaps(without_flips(recording))), arms_away_degrees)


def read_recording(path: Path) -> Recording:
    """A recording as it is in its file.

    Args:
        path: the file; its suffix, one of `READERS`, says how it is read.

    Raises:
        InputError: it cannot be read, or lacks its skeleton.
    """
    if not path.is_file():
        raise InputError(f'There is no motion file "{path}".')
    recording: Recording = resolve_name(READERS[path.suffix.lower()])(path)
    return recording
