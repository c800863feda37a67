"""Motions by name or file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import cast

from pb4u.errors import InputError, unknown_name, unread_kind
from pb4u.io.restricted_pickle import load_pickle
from pb4u.motion.ground import on_level_ground
from pb4u.motion.motion import Motion, MotionAsRecorded
from pb4u.motion.procedural import CLIPS, ProceduralMotion
from pb4u.motion.recording import Recording
from pb4u.motion.repair import with_leap_notes, without_false_start, without_flips
from pb4u.motion.retargeting import RecordedMotion
from pb4u.motion.smpl_recording import vto_recording
from pb4u.motion.steadying import steadied
from pb4u.motion.wham import holds_people, wham_recording
from pb4u.registry import Registry

READERS = {
    ".amc": "pb4u.motion.asf_amc:read_amc",
    ".bvh": "pb4u.motion.bvh:read_bvh",
    ".npz": "pb4u.motion.smpl_recording:read_amass",
    ".npy": "pb4u.motion.tram:read_tram",
    ".pkl": "pb4u.motion.library:read_pickled_motion",
    ".pt": "pb4u.motion.gvhmr:read_gvhmr",
}
"""Suffix -> function of a path that gives its `Recording`; another format is one more line here."""
SUFFIXES = tuple(READERS)
AS_RECORDED: Registry[Callable[[Path, tuple[int, int] | None, float | None], MotionAsRecorded]] = Registry(
    "recording as recorded"
)
"""Suffix -> function of a path, a crop and degrees (see `load_motion`) that gives the recording, otherwise as it is."""
_OF_SEVERAL = (".pkl",)
"""Suffixes whose reader also takes the person, as files of them may hold several."""


def motion_names() -> tuple[str, ...]:
    """Names of the built-in procedural clips."""
    return tuple(CLIPS)


def recording_file(name: str | Path) -> tuple[Path, str | None]:
    """The file that FILE or FILE:PERSON names, and the person where one is named.

    Args:
        name: value of --motion.
    """
    head, colon, person = str(name).rpartition(":")
    if colon and Path(head).suffix.lower() in SUFFIXES:
        return Path(head), person
    return Path(name), None


def load_motion(
    name_or_path: str | Path,
    crop: tuple[int, int] | None = None,
    *,
    seed: int = 0,
    arms_away_degrees: float | None = None,
    raw: bool = False,
    recorded_fps: float | None = None,
) -> Motion:
    """A built-in clip by name, or a recording by path; the suffix decides how it is read.

    Args:
        name_or_path: one of `motion_names()`, or an .amc (with its .asf beside it), .bvh, AMASS .npz, VTO/HOOD .pkl, or
            what GVHMR (.pt), WHAM (.pkl) or TRAM (.npy) finds in a video; of several people one, as FILE:PERSON.
        crop: (first, stop) frames to keep, counted at the recording's own rate.
        seed: varies tempo and amplitude of a built-in clip a little.
        arms_away_degrees: see `Motion`.
        raw: whether to leave motion from a video unfiltered.
        recorded_fps: frames per second of the recording; overrides the rate stated or assumed for its file.

    Raises:
        InputError: the name is unknown, the file unreadable, or the crop not inside the recording.
    """
    name = str(name_or_path)
    if name in CLIPS:
        if crop is not None:
            raise InputError(f'The built-in motion "{name}" has no end to crop; set --frames instead.')
        if recorded_fps is not None:
            raise InputError(f'The built-in motion "{name}" was not recorded; leave out recorded_fps.')
        return ProceduralMotion(name, seed=seed, arms_away_degrees=arms_away_degrees)
    path, person = recording_file(name)
    if path.suffix.lower() == ".asf":
        raise InputError(f"{path} holds only the skeleton; give the .amc file beside it, which holds the motion.")
    if path.suffix and path.suffix.lower() not in SUFFIXES:
        raise unread_kind(path, "motion", SUFFIXES)
    if path.suffix.lower() not in SUFFIXES:
        raise unknown_name("motion", name, CLIPS)
    recording = read_recording(path, person, recorded_fps)
    # The crop comes first: bad frames are often what it is there to leave out.
    recording = without_false_start(recording) if crop is None else recording.cropped(*crop)
    recording = with_leap_notes(without_flips(recording))
    if recording.from_video and not raw:
        recording = steadied(recording)
    return RecordedMotion(on_level_ground(recording), arms_away_degrees)


def read_recording(path: Path, person: str | None = None, recorded_fps: float | None = None) -> Recording:
    """A recording as stored in its file.

    Args:
        path: the file; its suffix, one of `READERS`, says how it is read.
        person: the person to read from a file of several.
        recorded_fps: frames per second; overrides the rate stated or assumed for the file.

    Raises:
        InputError: it cannot be read, lacks its skeleton or a required frame rate, or has no such person.
    """
    if not path.is_file():
        raise InputError(f'There is no motion file "{path}".')
    reader = resolve_name(READERS[path.suffix.lower()])
    if path.suffix.lower() in _OF_SEVERAL:
        recording = cast(Recording, reader(path, person))
    elif person is not None:
        raise InputError(f'{path} holds one person; give it without ":{person}".')
    else:
        recording = cast(Recording, reader(path))
    if recorded_fps is not None:
        return replace(recording, poses=replace(recording.poses, fps=recorded_fps))
    if math.isnan(recording.poses.fps):
        raise InputError(f"{path} does not state its frame rate; give it with --recorded-fps.")
    return recording


def read_pickled_motion(path: Path, person: str | None = None) -> Recording:
    """A recording in a pickle, read without running its code: of VTO or HOOD, or one person of WHAM.

    Args:
        path: the .pkl.
        person: the person to read from a file of several.

    Raises:
        InputError: it is neither, or a part is missing or does not fit.
    """
    content = load_pickle(path)
    if holds_people(content):
        return wham_recording(path, content, person)
    if person is not None:
        raise InputError(f'{path} holds one person; give it without ":{person}".')
    return vto_recording(path, content)
