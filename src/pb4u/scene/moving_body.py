"""The body of a run in motion: loaded, led into what it performs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import ShapedBody
from pb4u.body.character import Character, PosedCharacter
from pb4u.body.library import load_body
from pb4u.body.smpl import read_contact
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.errors import InputError, InputNote, warn
from pb4u.motion.character_lead_in import character_lead_in
from pb4u.motion.lead_in import arms_held_off, lead_in as prepend_lead_in
from pb4u.motion.library import AS_RECORDED, load_motion
from pb4u.motion.motion import Motion, MotionAsRecorded
from pb4u.motion.steadying import CUTOFF
from pb4u.options import NONE, described
from pb4u.run import BODY, RESEARCH, Run

DEFAULT_FRAMES = 60
"""Frames written of a motion without end by default: two seconds at 30 frames per second."""

DEFAULT_MOTION = "walk"


@dataclass(frozen=True, eq=False)
class Performance:
    """A body in motion.

    Args:
        body: the moving body, lead-in included; None where the scene has none.
        frames: frames that are there to write.
        motion: name of the motion.
        notes: plain sentences on changed or ignored inputs.
    """

    body: AnimatedBody | None
    frames: int
    motion: str
    notes: tuple[str, ...] = ()


def perform(run: Run) -> tuple[ShapedBody | VertexSequence | None, Performance]:
    """The body of a run in the pose for fitting garments, and in motion, or none; warns of inputs that do not fit.

    Args:
        run: gives the body, its shape and its motion.

    Raises:
        InputError: body or motion cannot be used, or not together.
    """
    if run.body is None:
        return None, _nobody(run)
    recording = _recording(run) if run.as_recorded else None
    body = _load_body(run, recording)
    if not isinstance(body, ShapedBody):
        return body, _play(body, run)
    return body, _perform(body, run) if recording is None else _replay(body, recording, run)


def _nobody(run: Run) -> Performance:
    """A scene without a body, of which nothing of a body can be asked."""
    for name, entry in described(Run).items():
        if entry.flag.panel in (BODY, RESEARCH) and name != "body" and getattr(run, name) not in (entry.default, {}, 0):
            raise InputError(f"{name.replace('_', '-')} needs a body, but --body {NONE} gives none; leave it out.")
    return Performance(None, run.frames or DEFAULT_FRAMES, NONE)


def _recording(run: Run) -> MotionAsRecorded:
    motion = run.motion
    if not isinstance(motion, str | Path) or Path(motion).suffix.lower() not in AS_RECORDED:
        raise InputError("To play a recording as recorded, give its .pkl or .npz file of SMPL as the motion.")
    if run.recorded_fps is not None:
        raise InputError("A recording as recorded has the frame rate of its file; leave out --recorded-fps.")
    return AS_RECORDED[Path(motion).suffix.lower()](Path(motion), run.crop, run.arms_away)


def _load_body(run: Run, recording: MotionAsRecorded | None) -> ShapedBody | VertexSequence:
    body = _shaped_body(run, {} if recording is None else recording.shape)
    if run.omitted is None:
        return body
    return body.with_contact(read_contact(Path(run.omitted), len(body.contact)))


def load_body_of(
    body: str,
    clip: str | None,
    body_parts: str | None,
    body_units: str | None = None,
    shape: Mapping[str, float] | None = None,
) -> ShapedBody | VertexSequence:
    """The body of a run.

    Args:
        body: `Run.body`, a name or a file.
        clip: `Run.clip`.
        body_parts: `Run.body_parts`.
        body_units: `Run.body_units`.
        shape: shape parameters by name.

    Raises:
        InputError: it cannot be read, or has no such clip or parts.
    """
    parts = None if body_parts is None else [part.strip() for part in body_parts.split(",")]
    return load_body(body, shape, clip=clip, parts=parts, units=body_units)


def _shaped_body(run: Run, shape: Mapping[str, float]) -> ShapedBody | VertexSequence:
    """The body with the `shape` that its recording says, and over it that of the run."""
    body = run.body
    if shape and not (isinstance(body, str | Path) and Path(body).suffix):
        raise InputError(f"--as-recorded needs a model file of the SMPL family as --body; {body} has another skeleton.")
    if isinstance(body, str | Path):
        return load_body_of(str(body), run.clip, run.body_parts, run.body_units, {**shape, **run.body_shape})
    if not isinstance(body, ShapedBody | VertexSequence):
        raise InputError("A moving body must be a shaped body or a vertex sequence.")
    if run.body_shape:
        raise InputError(f"{body.name} is already loaded with its shape; give body_shape to load_body instead.")
    return body


def _perform(body: ShapedBody, run: Run) -> Performance:
    """A body with bones performs a motion; a character its own clip, where no motion is given."""
    if isinstance(body, Character):
        for note in body.notes:
            warn(note, InputNote)
        if run.motion is None and (body.clip is not None or not body.is_human):
            return _perform_clip(body, run)
        if not body.is_human:
            raise InputError(
                f"{body.name} can perform only its own clips, because its bones are not a human's; leave out --motion."
            )
    if isinstance(body, Character) and run.clip is not None:
        raise InputError(f"{body.name} can perform either its clip {run.clip} or --motion; leave one out.")
    clip, name = _load_motion(run)
    frames = _frames(run, name, clip.available_frames(run.fps))
    poses, more = clip.perform(body, run.fps, frames)
    notes = (*clip.notes, *more)
    for note in notes:
        warn(note, InputNote)
    led = prepend_lead_in(poses, body, run.led_frames)
    if (arms := clip.arm_clearance(body)) is not None:
        led = arms_held_off(led, arms, run.led_frames)
    return Performance(body.posed(led), frames, name, notes)


def _perform_clip(body: Character, run: Run) -> Performance:
    """A character performs its own clip; one that has none stands."""
    _refuse_changes(run, f"{body.name} performs its own clip", "change the clip in its file")
    name = "stand" if body.clip is None else body.clip.name
    if run.clip is None and len(body.clip_names) > 1:
        warn(f"{body.name} performs {name}, the first of its clips {', '.join(body.clip_names[:10])}; --clip chooses.")
    available = run.frames or DEFAULT_FRAMES if body.clip is None else body.available_frames(run.fps)
    poses = character_lead_in(body, body.clip_poses(run.fps, available), run.fps, run.led_frames)
    return Performance(PosedCharacter(body, poses, run.fps), _frames(run, name, available), name, body.notes)


def _replay(body: ShapedBody, recording: MotionAsRecorded, run: Run) -> Performance:
    """A body with bones plays its recording, nothing changed."""
    poses = recording.led_in(body, run.fps, run.led_frames)
    frames = _frames(run, recording.name, recording.available_frames(run.fps))
    return Performance(body.posed(poses), frames, str(run.motion))


def _load_motion(run: Run) -> tuple[Motion, str]:
    motion = DEFAULT_MOTION if run.motion is None else run.motion
    if isinstance(motion, str | Path):
        away, seed = run.arms_away, run.seed
        clip = load_motion(
            motion, run.crop, seed=seed, arms_away_degrees=away, raw=run.raw_motion, recorded_fps=run.recorded_fps
        )
        return clip, str(motion)
    if not isinstance(motion, Motion):
        raise InputError(f"The motion must be a name, a path or a Motion, not {motion!r}.")
    _refuse_changes(run, f"{motion.name} is a motion already loaded", "give it to load_motion")
    return motion, motion.name


def _play(body: VertexSequence, run: Run) -> Performance:
    """A sequence moves by itself; it starts in the pose that garments are fitted to: neither cut nor posed."""
    stands = len(body.vertices) == 1
    motion, by_itself = run.motion, f"{body.name} is a sequence of vertices that moves by itself"
    if stands:
        by_itself = f"{body.name} is a mesh without bones, which does not move"
    _refuse_changes(run, by_itself, "change the sequence in the program it comes from", ("crop", "arms_away"))
    if run.recorded_fps is not None:
        body = body.recorded_at(run.recorded_fps)
    if motion is not None:
        ignored = motion if isinstance(motion, str | Path) else motion.name
        warn(f"{by_itself}; the motion {ignored} is not used.")
    elif stands:
        warn(
            f"{by_itself}; give a rigged character, or a .pc2 or .mdd beside an .obj, for a body that moves.", InputNote
        )
    if body.from_video and not run.raw_motion:
        warn(
            f"{body.name}: recorded from a video, so motion faster than {CUTOFF:g} Hz is smoothed out; --raw-motion "
            "keeps it."
        )
        body = body.smoothed(CUTOFF)
    # A body that never moves has no end: it stands for as long as wanted.
    standing = (run.frames or DEFAULT_FRAMES) - 1 if body.frame_count == 1 else 0
    played = body.resampled(run.fps).with_held_start(run.led_frames + standing)
    return Performance(played, _frames(run, body.name, played.frame_count - run.led_frames), body.name)


def _refuse_changes(
    run: Run, why: str, mend: str, options: tuple[str, ...] = ("crop", "arms_away", "recorded_fps")
) -> None:
    """Refuse options that change a motion where none is loaded from a file."""
    for option in options:
        if getattr(run, option) is not None:
            raise InputError(f"{why}, so --{option.replace('_', '-')} cannot be applied; {mend}.")


def _frames(run: Run, name: str, available: int | None) -> int:
    """Frames to write; warns where there are fewer than wanted."""
    if run.frames is None:
        return available or DEFAULT_FRAMES
    if available is not None and run.frames > available:
        there = f"{run.frames} are requested, {available} exist"
        warn(f"{name} ends after {available} frames at {run.fps:g} fps; {there}.")
        return available
    return run.frames
