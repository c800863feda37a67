"""Motion that WHAM (Shin et al. 2024) finds in a video: its `wham_output.pkl`, which `joblib.dump` writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.io.reading_limits import names_text
from pb4u.io.stored_numbers import stored_numbers
from pb4u.motion.recording import Recording
from pb4u.motion.repair import without_gaps
from pb4u.motion.smpl_recording import shape_note, smpl_recording

# The file does not tell the rate of its video.
_RATE = 30.0


def holds_people(content: Any) -> bool:
    """Whether a pickle is a result of WHAM: people by number, or an empty dictionary where it found nobody.

    Args:
        content: content of the pickle.
    """
    return isinstance(content, Mapping) and all(isinstance(person, Mapping) for person in content.values())


def wham_recording(path: Path, content: Mapping[Any, Any], person: str | None) -> Recording:
    """The motion in the world of one person, an SMPL recording with Y up; frames that are missing are interpolated.

    Args:
        path: the file, for messages.
        content: its entries: `pose_world` (frames, 72), `trans_world` (frames, 3), `betas` and `frame_ids` of each.
        person: key of the person; optional if there is only one.

    Raises:
        InputError: it has no person, not the given one, or several without a choice, or a part does not fit.
    """
    people = {str(number): entry for number, entry in content.items()}
    if not people:
        raise InputError(f"{path} holds nobody: no person was followed for long enough; try another video.")
    if person not in people:
        names = ", ".join(f"{name} ({_length(entry)} frames)" for name, entry in list(people.items())[:10])
        if person is not None:
            raise InputError(f"{path} has no person {person[:40]}; it has {names}; choose one of these.")
        if len(people) > 1:
            raise InputError(f"{path} holds {len(people)} people, {names}; choose one as {path}:{next(iter(people))}.")
        person = next(iter(people))
    entry = people[person]
    if "pose_world" not in entry or "trans_world" not in entry:
        raise InputError(
            f"{path}: person {person} has no pose_world and trans_world, but {names_text(entry)}; motion relative to "
            "a camera, as VIBE and PHALP write it, is not read: give a file that WHAM, TRAM or GVHMR writes."
        )
    poses, translations = (stored_numbers(entry[key], path, key) for key in ("pose_world", "trans_world"))
    recording = smpl_recording(path, poses, translations, _RATE, told_by="its program")
    recording = replace(recording, name=path.stem if len(people) == 1 else f"{path.stem}_{person}", from_video=True)
    if "frame_ids" in entry:
        recording = without_gaps(recording, stored_numbers(entry["frame_ids"], path, "frame_ids"))
    note = shape_note(path, stored_numbers(entry["betas"], path, "betas")) if "betas" in entry else ()
    return replace(recording, notes=(*recording.notes, *note))


def _length(entry: Mapping[str, Any]) -> int:
    return len(entry["pose_world"]) if isinstance(entry.get("pose_world"), np.ndarray) else 0
