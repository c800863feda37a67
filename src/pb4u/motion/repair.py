"""Faults of recordings that show in the motion alone, mended and counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pb4u.body.skeleton import local_rotations, world_rotations
from pb4u.errors import InputError
from pb4u.geometry.rotation import angle_between, rotate, slerp
from pb4u.motion.curves import soft_ramp
from pb4u.motion.recording import Recording
from pb4u.motion.reference_pose import ReferencePose

# A joint that turns by more than this between two frames has not moved: its Euler angles have jumped.
_JUMP_ANGLE, _JUMP_SPEED = np.deg2rad(60.0), np.deg2rad(3600.0)
# Nor can a joint turn by so much, or a limb twist about itself by so much, in so short a time [s].
_TURN_ANGLE, _TWIST_ANGLE, _SHORT_TIME = np.deg2rad(100.0), np.deg2rad(60.0), 0.05
# A repaired joint is led over its flip no faster than this.
_REPAIR_SPEED = np.deg2rad(600.0)
# Flips closer to each other than this are one: there and back again [s].
_SAME_FLIP = 0.25
_FLIPPING = ("upper_arm", "forearm", "forearm_end", "hand", "thigh", "shin", "foot", "toes")
# Nobody travels faster than this [m/s]; less than that distance [m] in a frame is a tremble of slow recordings. Lengths
# are for the leg of an average adult [m], since files have units of their own.
_FASTEST, _LEAST_LEAP = 15.0, 0.3
# Of so many frames one at least must be there.
_MOST_MISSING = 20
# A recording may begin with a calibration pose, from which everything leaps into the performance.
_START_FRAMES, _START_SPEED = 6, np.deg2rad(3000.0)


def without_flips(recording: Recording) -> Recording:
    """The recording with flips repaired: where joints jump, or turn faster than a limb can, slerp bridges these frames.

    Repairs are counted in `Recording.notes`.

    Args:
        recording: the recording.
    """
    fps = recording.poses.fps
    local = local_rotations(recording.poses.rotations, recording.skeleton.parents)
    directions = ReferencePose.of_joints(recording.joint, recording.source.elbow_flexion).directions
    counts: dict[str, int] = {}
    for role in (f"{r}.{side}" for r in _FLIPPING for side in "LR"):
        bone = recording.joint_index(role)
        if recording.skeleton.names[bone] in counts:
            continue
        flips = _flips(local[:, bone], directions.get(role), fps)
        if flips:
            local[:, bone] = _led_over(local[:, bone], flips, fps)
            counts[recording.skeleton.names[bone]] = len(flips)
    if not counts:
        return recording
    mended = world_rotations(local, recording.skeleton.parents)
    joints = ", ".join(f"{name} {count}" for name, count in counts.items())
    note = f"{recording.name}: {sum(counts.values())} sudden joint flip(s) replaced by a smooth turn ({joints})."
    return replace(recording, poses=replace(recording.poses, rotations=mended), notes=(*recording.notes, note))


def without_false_start(recording: Recording) -> Recording:
    """The recording without leading frames from which several joints at once leap into what follows.

    Args:
        recording: the recording.
    """
    head = min(_START_FRAMES, len(recording.poses) - 2)
    if head < 1:
        return recording
    local = local_rotations(recording.poses.rotations[: head + 1], recording.skeleton.parents)
    bones = sorted({recording.joint_index(f"{role}.{side}") for role in _FLIPPING[:-1] for side in "LR"})
    limit = _START_SPEED / recording.poses.fps
    leaps = angle_between(local[:-1], local[1:]) > limit
    bad = leaps[:, 0] | (leaps[:, bones].sum(axis=1) >= 2)
    if not bad.any():
        return recording
    first = int(np.flatnonzero(bad)[-1]) + 1
    note = (
        f"{recording.name}: the first {first} frame(s) are left out: the joints leap between them and the "
        "following frames."
    )
    return replace(recording.cropped(first, len(recording.poses)), notes=(*recording.notes, note))


def with_leap_notes(recording: Recording) -> Recording:
    """The recording with a note where the whole body leaps farther in a frame than a person can; nothing is repaired.

    Args:
        recording: the recording.
    """
    roots = recording.poses.root_positions
    far = recording.metres * np.linalg.norm(np.diff(roots, axis=0), axis=1)
    leaps = np.flatnonzero(far > max(_FASTEST / recording.poses.fps, _LEAST_LEAP))
    if not len(leaps):
        return recording
    worst = int(leaps[np.argmax(far[leaps])])
    note = (
        f"{recording.name}: the body leaps {len(leaps)} time(s), farthest by {far[worst]:.1f} m from frame {worst} to "
        f"{worst + 1}; cloth cannot follow, so cut the recording there with --crop."
    )
    return replace(recording, notes=(*recording.notes, note))


def without_gaps(recording: Recording, numbers: np.ndarray) -> Recording:
    """The recording with missing frames interpolated between their neighbours, by slerp; its notes report it.

    Args:
        recording: the frames that there are.
        numbers: (frames,) whole number of each in the video.

    Raises:
        InputError: the numbers do not rise, or most frames are missing.
    """
    numbers = np.asarray(numbers).reshape(-1)
    frames = len(recording.poses)
    if len(numbers) != frames or numbers.dtype.kind not in "iu" or (np.diff(numbers) <= 0).any():
        raise InputError(f"{recording.name}: its frames are not numbered in rising order, one number for each.")
    span = int(numbers[-1]) - int(numbers[0]) + 1
    if span == frames:
        return recording
    if span > _MOST_MISSING * frames:
        raise InputError(f"{recording.name}: only {frames:,} of {span:,} frames exist, too few for a motion.")
    times = (numbers - numbers[0]).astype(np.float64)
    grid = np.arange(span, dtype=np.float64)
    upper = np.clip(np.searchsorted(times, grid), 1, frames - 1)
    share = (grid - times[upper - 1]) / (times[upper] - times[upper - 1])
    rotations, roots = recording.poses.rotations, recording.poses.root_positions
    poses = replace(
        recording.poses,
        rotations=slerp(rotations[upper - 1], rotations[upper], share[:, None]),
        root_positions=roots[upper - 1] + share[:, None] * (roots[upper] - roots[upper - 1]),
    )
    gaps = np.flatnonzero(np.diff(numbers) > 1)
    spans = ", ".join(f"{numbers[k] - numbers[0] + 1} to {numbers[k + 1] - numbers[0] - 1}" for k in gaps[:5])
    note = (
        f"{recording.name}: {span - frames} frame(s) in which the person was not seen are interpolated "
        f"({spans}{' and others' if len(gaps) > 5 else ''}); cut long ones out with --crop."
    )
    return replace(recording, poses=poses, notes=(*recording.notes, note))


def _flips(rotations: np.ndarray, along: np.ndarray | None, fps: float) -> list[tuple[int, int]]:
    """(last good frame before, first good frame after) of each flip of a joint (frames, 4)."""
    last = len(rotations) - 1
    limit = max(_JUMP_ANGLE, _JUMP_SPEED / fps)
    spans = [(i, i + 1) for i in np.flatnonzero(angle_between(rotations[:-1], rotations[1:]) > limit).tolist()]
    window = round(_SHORT_TIME * fps)
    if 1 < window < last:
        before, after = rotations[:-window], rotations[window:]
        angle = angle_between(before, after)
        impossible = angle > _TURN_ANGLE
        if along is not None:
            dot = np.sum(rotate(before, along) * rotate(after, along), axis=-1)
            swing = np.arccos(np.clip(dot, -1.0, 1.0))
            impossible |= angle - swing > _TWIST_ANGLE
        spans += [(i, i + window) for i in np.flatnonzero(impossible).tolist()]
    merged: list[tuple[int, int]] = []
    for start, stop in sorted(spans):
        if merged and start - merged[-1][1] <= _SAME_FLIP * fps:
            merged[-1] = (merged[-1][0], max(stop, merged[-1][1]))
        else:
            merged.append((start, stop))
    return merged


def _led_over(rotations: np.ndarray, flips: list[tuple[int, int]], fps: float) -> np.ndarray:
    """Rotations (frames, 4) with slerp over each flip, taking as long as it must to stay slow."""
    result, last = rotations.copy(), len(rotations) - 1
    for start, stop in flips:
        while start > 0 or stop < last:
            needed = float(angle_between(result[start], result[stop])) / _REPAIR_SPEED * fps
            if stop - start >= needed:
                break
            start, stop = max(start - 1, 0), min(stop + 1, last)
        share = soft_ramp(np.linspace(0.0, 1.0, stop - start + 1))
        result[start : stop + 1] = slerp(result[start][None], result[stop][None], share)
    return result
