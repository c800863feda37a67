"""From the pose that garments are fitted to, into the first frame of a motion."""

from __future__ import annotations

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.errors import InputError
from pb4u.geometry.rotation import conjugate, from_axis_angle, multiply, rotate, slerp
from pb4u.motion.arm_clearance import ArmClearance, eased, held_off
from pb4u.motion.curves import ease
from pb4u.motion.retargeting import heading, lowest_heights

# How long the motion is thought to have gone on before its first frame, slowing down backwards in time [s].
_RUN_UP = 0.12


def lead_in(poses: PoseSequence, body: ShapedBody, frames: int) -> PoseSequence:
    """Poses with more frames before them, that lead from the body's rest pose to the first one.

    Frame 0 is the rest pose on the ground, at the position and heading of the first frame of the motion; frame
    `frames` is the first one of the motion. Bones are interpolated by slerp, away from rest without velocity and into
    the motion with the motion's own. No frame is lower than the straight line from rest to the motion would have it.

    Args:
        poses: the motion.
        body: the body that performs it.
        frames: how many frames lead in.

    Raises:
        InputError: `frames` is negative.
    """
    if frames < 0:
        raise InputError(f"A lead-in of {frames} frames is not possible; give 0 or more.")
    if frames == 0:
        return poses
    facing = heading(poses.rotations[0, 0])
    rest_root = rotate(facing, body.skeleton.joints[0] * np.array([0.0, 1.0, 0.0]))
    rest_root = rest_root + poses.root_positions[0] * np.array([1.0, 0.0, 1.0])

    progress = np.arange(frames) / frames
    share = ease(progress)
    target_rotations, target_roots = _run_up(poses, (progress - 1.0) * frames / poses.fps)
    rotations = slerp(np.broadcast_to(facing, target_rotations.shape), target_rotations, share[:, None])
    roots = rest_root + share[:, None] * (target_roots - rest_root)

    # Blended legs reach lower or less low than either end does; the body is moved to where its feet belong.
    start = PoseSequence(np.tile(facing, (1, rotations.shape[1], 1)), rest_root[None], poses.fps)
    first = PoseSequence(poses.rotations[:1], poses.root_positions[:1], poses.fps)
    low, high = float(lowest_heights(body, start)[0]), float(lowest_heights(body, first)[0])
    blended = lowest_heights(body, PoseSequence(rotations, roots, poses.fps))
    roots[:, 1] += low + share * (high - low) - blended
    return PoseSequence(
        np.concatenate([rotations, poses.rotations]), np.concatenate([roots, poses.root_positions]), poses.fps
    )


def arms_held_off(poses: PoseSequence, arms: ArmClearance, frames: int) -> PoseSequence:
    """Poses whose lead-in has its arms swung out of the body, by a turn that fades out within the motion.

    Otherwise a motion that begins with arms already swung out would have arms inside the body during the lead-in.

    Args:
        poses: beginning with a lead-in; after it the arms are clear of the body.
        arms: allowed positions of the arms.
        frames: how many frames lead in.
    """
    turns = arms.turns(PoseSequence(poses.rotations[:frames], poses.root_positions[:frames], poses.fps))
    if not turns.any():
        return poses
    turns = np.concatenate([turns, np.zeros((len(turns), len(poses) - frames, 3))], axis=1)
    return held_off(arms.humanoid, poses, np.stack([eased(turn, poses.fps) for turn in turns]))


def _run_up(poses: PoseSequence, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The motion continued backwards to `times` (frames,) < 0 [s]: with its first velocity, which soon fades out."""
    first, roots = poses.rotations[0], poses.root_positions
    if len(poses) < 2:
        return np.broadcast_to(first, (len(times), *first.shape)), np.broadcast_to(roots[0], (len(times), 3))
    turn = multiply(poses.rotations[1], conjugate(first))
    turn = np.where(turn[..., :1] < 0, -turn, turn)
    length = np.linalg.norm(turn[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, turn[..., :1])
    velocity = poses.fps * angle * turn[..., 1:] / np.maximum(length, 1e-12)
    elapsed = run_up(times)
    rotations = multiply(from_axis_angle(elapsed[:, None, None] * velocity), first)
    return rotations, roots[0] + elapsed[:, None] * poses.fps * (roots[1] - roots[0])


def run_up(times: np.ndarray) -> np.ndarray:
    """Time [s] before its first frame to which a motion is extrapolated at `times` < 0 [s]: it slows down backwards.

    Args:
        times: (frames,) [s].
    """
    return -_RUN_UP * (1.0 - np.exp(times / _RUN_UP))
