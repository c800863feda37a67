"""Motion from a video steadied: joints that tremble are smoothed, and feet that stand are kept from sliding.

Two stages, of which the second sees what the first leaves. A Butterworth low-pass, forwards and backwards so that
nothing is delayed, takes out what is faster than people move (6 Hz: Winter, Biomechanics of Human Movement, 2009, 3.4).
Then the body is shifted level by what the feet slide while they stand, and what is left is taken up by hips and knees.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import minimum_filter1d

from pb4u.body.skeleton import joint_positions, local_rotations, world_rotations
from pb4u.geometry.low_pass import is_sampled_enough, low_passed
from pb4u.geometry.rotation import between, multiply
from pb4u.motion.curves import soft_ramp
from pb4u.motion.recording import Recording

CUTOFF = 6.0
"""Frequency [Hz] above which joints and travel are taken to tremble."""
# A ball of a foot stands for certain below the first speed [m/s] and for certain not above the second, and so for its
# height [m] above the lower of both balls within half a second [s] around.
_STANDS, _LIFTED, _AROUND = (0.2, 0.6), (0.03, 0.10), 0.5
_ROUNDS = 4
# A foot is held in no place that is farther [m] from where it is; a knee is never bent straighter than this share.
_FARTHEST, _STRAIGHT = 0.12, 0.9995


def steadied(recording: Recording) -> Recording:
    """The recording without frequencies above `CUTOFF`, and without the sliding of standing feet.

    `Recording.notes` reports what was done.

    Args:
        recording: Y up.
    """
    fps, frames = recording.poses.fps, len(recording.poses)
    if frames < 2:
        return recording
    smooth = _smoothed(recording) if is_sampled_enough(frames, fps, CUTOFF) else recording
    steady = smooth
    for _ in range(_ROUNDS):  # a foot that slides is seen to stand once the body slides no more
        stands, velocity = _standing(steady)
        slide = (stands[..., None] * velocity).sum(axis=1) / np.maximum(stands.sum(axis=1), 1.0)[:, None]
        travel = np.zeros((frames, 3))
        travel[1:, [0, 2]] = -np.cumsum(0.5 * (slide[1:] + slide[:-1]), axis=0) / fps
        roots = steady.poses.root_positions + travel / recording.metres
        steady = replace(steady, poses=replace(steady.poses, root_positions=roots))
    stands, _ = _standing(steady)
    steady = _held(steady, stands)
    before, after = (_sliding(version, stands) for version in (recording, steady))
    note = (
        f"{recording.name}: recorded from a video, so motion faster than {CUTOFF:g} Hz is removed and standing feet "
        f"are fixed: they slid at {100 * before:.0f} cm/s, now at {100 * after:.0f}; --raw-motion switches this off."
    )
    return replace(steady, notes=(*recording.notes, note))


def _smoothed(recording: Recording) -> Recording:
    """Rotations of the joints from their parents, and travel, without what is faster than `CUTOFF`."""
    poses, parents = recording.poses, recording.skeleton.parents
    local = local_rotations(poses.rotations, parents)
    # A quaternion and its negative are one rotation: neighbours in time take the nearer sign.
    signs = np.where(np.sum(local[1:] * local[:-1], axis=-1) < 0.0, -1.0, 1.0)
    local[1:] *= np.cumprod(signs, axis=0)[..., None]
    local = low_passed(local, poses.fps, CUTOFF)
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    roots = low_passed(poses.root_positions, poses.fps, CUTOFF)
    return replace(recording, poses=replace(poses, rotations=world_rotations(local, parents), root_positions=roots))


def _held(recording: Recording, stands: np.ndarray) -> Recording:
    """The recording with each ball of a foot in one place for as long as it stands, by bending hips and knees.

    Args:
        recording: Y up.
        stands: (frames, 2) how far each ball stands, in [0, 1].
    """
    poses = recording.poses
    joints = joint_positions(recording.skeleton, poses)
    rotations = poses.rotations.copy()
    for k, side in enumerate("LR"):
        hip, knee, ankle, ball = (recording.joint_index(f"{role}.{side}") for role in ("thigh", "shin", "foot", "toes"))
        edges = np.flatnonzero(np.diff(np.concatenate([[False], stands[:, k] > 0.5, [False]])))
        if not len(edges):
            continue
        places = np.array([np.median(joints[i:j, ball], axis=0) for i, j in edges.reshape(-1, 2).tolist()])
        middle = edges.reshape(-1, 2).mean(axis=1)
        nearest = np.abs(np.arange(len(poses))[:, None] - middle).argmin(axis=1)
        inside = np.searchsorted(edges, np.arange(len(poses)), side="right")
        nearest = np.where(inside % 2 == 1, inside // 2, nearest)
        offset = places[nearest] - joints[:, ball]
        shift = recording.metres * np.linalg.norm(offset, axis=1)
        share = stands[:, k] * np.minimum(1.0, _FARTHEST / np.maximum(shift, 1e-9))
        target = joints[:, ankle] + share[:, None] * offset
        thigh, shin = _leg_turns(joints[:, hip], joints[:, knee], joints[:, ankle], target)
        rotations[:, hip] = multiply(thigh, rotations[:, hip])
        rotations[:, knee] = multiply(shin, rotations[:, knee])
    return replace(recording, poses=replace(poses, rotations=rotations))


def _leg_turns(hip: np.ndarray, knee: np.ndarray, ankle: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, ...]:
    """World rotations (frames, 4) of thigh and shin that bring the ankle to its target, the knee in its plane."""
    upper, lower = np.linalg.norm(knee - hip, axis=1), np.linalg.norm(ankle - knee, axis=1)
    reach = target - hip
    length = np.linalg.norm(reach, axis=1)
    distance = np.clip(length, np.abs(upper - lower) + 1e-6, _STRAIGHT * (upper + lower))
    along = reach / np.maximum(length, 1e-9)[:, None]
    pole = knee - hip
    pole = _unit(pole - np.sum(pole * along, axis=1, keepdims=True) * along)
    cosine = np.clip((upper**2 + distance**2 - lower**2) / np.maximum(2 * upper * distance, 1e-9), -1.0, 1.0)
    bent = upper[:, None] * (cosine[:, None] * along + np.sqrt(1.0 - cosine**2)[:, None] * pole)
    below = distance[:, None] * along - bent
    return between(_unit(knee - hip), _unit(bent)), between(_unit(ankle - knee), _unit(below))


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def _balls(recording: Recording) -> np.ndarray:
    """Places (frames, 2, 3) [m] of the balls of both feet, of an average adult."""
    joints = joint_positions(recording.skeleton, recording.poses)
    return recording.metres * joints[:, [recording.joint_index(f"toes.{side}") for side in "LR"]]


def _standing(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """How far each ball stands (frames, 2) in [0, 1], and its level velocity (frames, 2, 2) [m/s]."""
    fps = recording.poses.fps
    balls = _balls(recording)
    velocity = np.gradient(balls, axis=0) * fps
    low = minimum_filter1d(balls[..., 1].min(axis=1), 2 * round(_AROUND * fps) + 1, mode="nearest")
    slow = _falling(np.linalg.norm(velocity, axis=-1), _STANDS)
    return slow * _falling(balls[..., 1] - low[:, None], _LIFTED), velocity[..., [0, 2]]


def _falling(values: np.ndarray, between: tuple[float, float]) -> np.ndarray:
    """1 below the first of two values, 0 above the second, smooth in between."""
    return 1.0 - soft_ramp((values - between[0]) / (between[1] - between[0]))


def _sliding(recording: Recording, stands: np.ndarray) -> float:
    """Mean level speed [m/s] of the balls of the feet while they stand."""
    speed = np.linalg.norm((np.gradient(_balls(recording), axis=0) * recording.poses.fps)[..., [0, 2]], axis=-1)
    return float((speed * stands).sum() / max(stands.sum(), 1e-9))
