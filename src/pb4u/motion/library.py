"""Motions by name or file."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from pb4u.errors import InputError
from pb4u.motion.motion import Motion
from pb4u.motion.procedural import CLIPS, DESCRIPTIONS, ProceduralMotion
from pb4u.motion.recorded_motion import RecordedMotion
from pb4u.motion.recording import Recording
from pb4u.motion.repair import without_false_start, without_flips

SUFFIXES = (".amc", ".bvh", ".npz", ".pkl")


def motion_names() -> tuple[str, ...]:
    """Names of the built-in procedural clips."""
    return tuple(CLIPS)


def motion_descriptions() -> dict[str, str]:
    """Name -> one sentence on each built-in clip."""
    return dict(DESCRIPTIONS)


def load_motion(
    name_or_path: str | Path,
    crop: tuple[int, int] | None = None,
    *,
    seed: int = 0,
    arms_away_degrees: float = 0.0,
) -> Motion:
    """A built-in clip by name, or a recording by path; the suffix decides how it is read.

    Args:
        name_or_path: one of `motion_names()`, or an .amc (with its .asf beside it), .bvh, AMASS .npz or VTO/HOOD .pkl.
        crop: (first, stop) frames to keep, counted at the recording's own rate.
        seed: varies tempo and amplitude of a built-in clip a little.
        arms_away_degrees: swings hanging arms outward by so much, which keeps them clear of loose garments.

    Raises InputError on an unknown name, an unreadable file, or a crop outside the recording.
    """
    name = str(name_or_path)
    if name in CLIPS:
        if crop is not None:
            raise InputError(f'The built-in motion "{name}" has no end to crop; ask for the frames you want.')
        return ProceduralMotion(name, seed=seed, arms_away_degrees=arms_away_degrees)
    path = Path(name)
    if path.suffix.lower() not in SUFFIXES:
        near = get_close_matches(name, CLIPS, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else f"built-in are {', '.join(CLIPS)}."
        raise InputError(f'No motion is called "{name}" and it is not a file ending in {", ".join(SUFFIXES)}; {hint}')
    recording = read_recording(path)
    # The crop comes first: bad frames are often what it is there to leave out.
    recording = without_false_start(recording) if crop is None else recording.cropped(*crop)
    return RecordedMotion(without_flips(recording), arms_away_degrees)


def read_recording(path: Path) -> Recording:
    """Read a recording as it is in its file. Raises InputError when it cannot be read or lacks its skeleton."""
    if not path.is_file():
        raise InputError(f'There is no motion file "{path}".')
    suffix = path.suffix.lower()
    if suffix == ".amc":
        from pb4u.motion.asf_amc import find_asf, read_amc

        return read_amc(path, find_asf(path))
    if suffix == ".bvh":
        from pb4u.motion.bvh import read_bvh

        return read_bvh(path)
    if suffix == ".npz":
        from pb4u.motion.amass import read_amass

        return read_amass(path)
    from pb4u.motion.vto import read_vto

    return read_vto(path)
