"""Axes of the bones of a recording in a T-pose, which forward kinematics of its frames tells whatever pose it rests in.

A bone keeps its direction in its own axes. What turns it about that is less certain: limbs twist little on the whole,
and knees and elbows fold one way.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.body.skeleton import PoseSequence, branch
from pb4u.geometry.rotation import angle_between, between, conjugate, from_axis_angle, from_xyzw, multiply, rotate
from pb4u.motion.correspondences import FORWARD, SEGMENTS
from pb4u.motion.recording import Recording
from pb4u.motion.reference_pose import T_POSE

SHORT = 0.02
"""Segments shorter than this share of a leg have no direction."""
_UP = np.array([0.0, 1.0, 0.0])
_KNEE_FLEXION = (0.0, 0.0, -1.0)
# What folding tells of a twist beside how little limbs are twisted, and the most [rad] by which it may gainsay that.
_FOLD_WEIGHT, _FOLD_TRUST = 4.0, np.deg2rad(60.0)
# The first joint of the spine that is farther from the pelvis' than this share of a leg lies above it.
_WAIST = 0.05
# Cosine between an axis of the file and a direction that is meant to be it.
_NEARLY = np.cos(np.deg2rad(20.0))
# Cosine between a bone at rest and its direction in a T-pose from which on it rests straight. Frames bear out what that
# tells within so much [rad], and of this share of trunk and limbs at least.
_STRAIGHT, _BORNE_OUT, _TRUSTED = np.cos(np.deg2rad(30.0)), np.deg2rad(45.0), 0.6
# Cosine between the upward axis and a bone that leans, from which on it is taken to do so in a T-pose.
_UPRIGHT = np.cos(np.deg2rad(20.0))
# Cosine between bones of one line.
_IN_LINE = 0.97


class Aim(NamedTuple):
    """Where a bone points.

    Args:
        end: bone whose joint marks its end.
        direction: (3,) in a T-pose.
        fold: joint and end of the segment below that bends in one direction only, and this direction (3,); None without
            one.
        leans: whether it may well have another direction in a T-pose, as necks have.
    """

    end: int
    direction: np.ndarray
    fold: tuple[int, int, np.ndarray] | None = None
    leans: bool = False


def unit(v: np.ndarray) -> np.ndarray:
    """Vectors of length 1; 0 stays.

    Args:
        v: (..., 3) in any unit.
    """
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def trunk(recording: Recording) -> list[int]:
    """Bones from the pelvis up to the head.

    Args:
        recording: how its bones play the roles.
    """
    pelvis, bone = (recording.skeleton.index(str(recording.source.roles[role])) for role in ("pelvis", "head"))
    way = [bone]
    while bone != pelvis:
        bone = int(recording.skeleton.parents[bone])
        way.append(bone)
    return way[::-1]


def nearly_axes(axes: np.ndarray) -> np.ndarray:
    """Left, up and front snapped to the axes of the file where they are close, up and front separately.

    Args:
        axes: (3, 3) rows left, up and front, a rotation.
    """
    _, up, front = (_nearly_axis(row) for row in axes)
    left = _nearly_axis(unit(np.cross(up, front)))
    up = unit(up - (up @ left) * left)
    return np.stack([left, up, np.cross(left, up)])


def _nearly_axis(direction: np.ndarray) -> np.ndarray:
    k = int(np.abs(direction).argmax())
    return np.sign(direction[k]) * np.eye(3)[k] if abs(direction[k]) > _NEARLY else direction


def axes_in_t_pose(
    recording: Recording, poses: PoseSequence, joints: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, Recording]:
    """Rotations from the rest pose in which each bone stands in a T-pose.

    Bones that rest straight go with their parents where the frames bear it out. For other rest poses the frames decide:
    a bone gets the twist that is smallest relative to its parent, with knees and elbows bending as in life; a bone
    without a direction gets its mean rotation.

    Args:
        recording: its skeleton.
        poses: some frames of the recording.
        joints: (frames, bones, 3) positions of the joints in these frames.
        up: (3,) the axis of the file that is up.

    Returns:
        (bones, 4) unit quaternions wxyz, and the recording, with elbows that bend forward if only the frames decide.
    """
    if not _rests_in_line(recording):
        axes, share = _axes(recording, poses, joints, up, True)
        if share > _TRUSTED:
            return axes, recording
    recording = replace(recording, source=replace(recording.source, elbow_flexion=FORWARD))
    return _axes(recording, poses, joints, up, False)[0], recording


def _axes(
    recording: Recording, poses: PoseSequence, joints: np.ndarray, up: np.ndarray, by_rest: bool
) -> tuple[np.ndarray, float]:
    """Rotations (bones, 4) from rest to a T-pose, and the share of trunk and limbs of which the rest pose tells it."""
    skeleton, rotations, rest = recording.skeleton, poses.rotations, recording.skeleton.joints
    parents, spine, aims = skeleton.parents.tolist(), trunk(recording), dict(_aims(recording))
    pelvis, chest, head = spine[0], skeleton.index(str(recording.source.roles["spine_upper"])), spine[-1]
    axes = np.tile([1.0, 0.0, 0.0, 0.0], (skeleton.bone_count, 1))
    axes[pelvis] = _pelvis(recording, rotations[:, pelvis], joints, by_rest)
    feet = {recording.joint_index(f"foot.{side}") for side in "LR"}
    checks = []
    for bone in np.flatnonzero(branch(parents, (pelvis,))).tolist():
        if bone == pelvis:
            continue
        # The head is level with the chest rather than with the neck.
        above = chest if bone == head else parents[bone]
        carrier = multiply(rotations[:, above], conjugate(axes[above]))
        relative = multiply(conjugate(carrier), rotations[:, bone])
        taken = axes[parents[bone]]
        aim = aims.get(bone)
        turn, straight = _mean(relative), True
        if bone in feet:
            turn = _sole(rotations[:, bone], relative, up, turn)
        if aim is not None:
            along = unit(_seen(rotations[:, bone], joints[:, aim.end] - joints[:, bone]).mean(axis=0))
            straight = bool(rotate(taken, unit(rest[aim.end] - rest[bone])) @ aim.direction > _STRAIGHT)
        if aim is not None and not (aim.leans and rotate(turn, along) @ aim.direction > _UPRIGHT):
            turn = between(along, aim.direction)
            twist = _twist(aim.direction, multiply(relative, conjugate(turn)))
            if aim.fold is not None:
                twist = _with_fold(aim, twist, rotate(turn, _seen(rotations[:, bone], _along(joints, *aim.fold[:2]))))
            turn = multiply(from_axis_angle(np.angle(twist) * aim.direction), turn)
        borne_out = by_rest and straight and bool(angle_between(taken, turn) < _BORNE_OUT)
        axes[bone] = taken if borne_out else turn
        checks += [borne_out] if aim is not None else []
    return axes, float(np.mean(checks))


def _rests_in_line(recording: Recording) -> bool:
    """Whether the bones rest along one axis, as in files that give each in axes of its own: that tells nothing."""
    rest = recording.skeleton.joints
    along = unit(np.array([rest[aim.end] - rest[bone] for bone, aim in _aims(recording)]))
    return bool(np.median(np.abs(along @ along.T)) > _IN_LINE)


def _pelvis(recording: Recording, rotations: np.ndarray, joints: np.ndarray, by_rest: bool) -> np.ndarray:
    """Rotation (4,) of the pelvis by the places of both hips and of the spine in its axes."""
    left, right = (joints[:, recording.joint_index(f"thigh.{side}")] for side in "LR")
    pelvis, *spine = trunk(recording)
    across = unit(_seen(rotations, left - right).mean(axis=0))
    above = [_seen(rotations, joints[:, bone] - joints[:, pelvis]).mean(axis=0) for bone in spine]
    up = next((way for way in above if np.linalg.norm(way) > _WAIST * recording.leg_length), above[-1])
    up = unit(up - (up @ across) * across)
    axes = np.stack([across, up, np.cross(across, up)])
    nearest = nearly_axes(axes)
    meant = by_rest and np.array_equal(np.abs(nearest).sum(axis=1), np.ones(3))
    return from_xyzw(Rotation.from_matrix(nearest if meant else axes).as_quat())


def _sole(rotations: np.ndarray, relative: np.ndarray, up: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Rotation (4,) of a foot, level as on the floor where it keeps its slope rather than the angle at its ankle.

    Args:
        rotations: (frames, 4) its rotations in the world from rest.
        relative: (frames, 4) those against the shin.
        up: (3,) the world's axis that is up.
        turn: (4,) what it has against the shin on the whole.
    """
    level = _seen(rotations, np.broadcast_to(up, (len(rotations), 3))).mean(axis=0)
    bent = _seen(relative, np.broadcast_to(_UP, (len(relative), 3))).mean(axis=0)
    if np.linalg.norm(level) <= np.linalg.norm(bent):
        return turn
    flat = between(unit(level), _UP)
    return multiply(from_axis_angle(np.angle(_twist(_UP, multiply(relative, conjugate(flat)))) * _UP), flat)


def _twist(direction: np.ndarray, rotations: np.ndarray) -> complex:
    """Mean twist about a direction (3,) of rotations (frames, 4) of a bone against its parent.

    As a complex number of that angle, which is short where the bone points the other way and has hardly a twist.
    """
    return complex(((rotations[:, 0] + 1j * (rotations[:, 1:] @ direction)) ** 2).mean())


def _with_fold(aim: Aim, twist: complex, lower: np.ndarray) -> complex:
    """The twist of a bone with what the directions (frames, 3) of the segment below tell of it, which folds one way."""
    assert aim.fold is not None
    lower = lower - (lower @ aim.direction)[:, None] * aim.direction
    turns = lower @ aim.fold[2] + 1j * (np.cross(lower, aim.fold[2]) @ aim.direction)
    fold = complex((np.linalg.norm(lower, axis=1) * turns).mean())
    return twist + _FOLD_WEIGHT * fold if abs(np.angle(fold * twist.conjugate())) < _FOLD_TRUST else twist


def _aims(recording: Recording) -> Iterator[tuple[int, Aim]]:
    """The bones of trunk and limbs that point somewhere, and where."""
    rest, parents, spine = recording.skeleton.joints, recording.skeleton.parents, trunk(recording)
    least = SHORT * recording.leg_length
    chest = spine.index(recording.skeleton.index(str(recording.source.roles["spine_upper"])))
    for k, bone in enumerate(spine[1:-1], 1):
        for n, end in enumerate(spine[k + 1 :], k + 1):
            if np.linalg.norm(rest[end] - rest[bone]) > least:
                yield bone, Aim(end, _UP, leans=n > chest + 1)
                break
    for upper, lower in SEGMENTS.items():
        first, end = recording.joint_index(upper), recording.joint_index(lower)
        fold = None
        if lower in SEGMENTS:
            folded = _KNEE_FLEXION if upper.startswith("thigh") else recording.source.elbow_flexion
            sign = 1.0 if upper.endswith("L") else -1.0
            fold = (end, recording.joint_index(SEGMENTS[lower]), np.array(folded) * [sign, 1.0, 1.0])
        while end != first:  # the bones between the two joints, where a limb has several
            bone = int(parents[end])
            yield bone, Aim(end, T_POSE.directions[upper], fold)
            end = bone


def _along(joints: np.ndarray, first: int, second: int) -> np.ndarray:
    """Directions (frames, 3) from one joint to another of joints (frames, bones, 3)."""
    return unit(joints[:, second] - joints[:, first])


def _seen(rotations: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (frames, 3) of the world in the axes of a bone with rotations (frames, 4)."""
    return rotate(conjugate(rotations), vectors)


def _mean(rotations: np.ndarray) -> np.ndarray:
    """The rotation (4,) that is nearest to some (frames, 4): the first eigenvector (Markley et al. 2007)."""
    return np.linalg.eigh(rotations.T @ rotations)[1][:, -1]
