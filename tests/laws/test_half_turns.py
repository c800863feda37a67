"""The law that rotations are rotations at half a turn too, where the smallest one between two directions is not one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from pb4u.body.skeleton import PoseSequence
from pb4u.geometry.rotation import angle_between, between, from_axis_angle, multiply, rotate, slerp, spline
from pb4u.motion.correspondences import SMPL
from pb4u.motion.performance import level_heading
from pb4u.motion.recording import Recording
from pb4u.motion.reference_pose import T_POSE, alignment
from pb4u.motion.smpl_recording import nominal_skeleton

COUNT = 64
SHORT_OF_A_HALF = st.sampled_from([0.0, 1e-17, 1e-12, 1e-9, 1e-8, 2e-8, 1e-6, 1e-3])
SEEDS = st.integers(0, 2**32 - 1)


def directions(seed: int, count: int = COUNT) -> np.ndarray:
    """Directions (count, 3), the axes and those in their planes among them."""
    rng = np.random.default_rng(seed)
    drawn = rng.normal(size=(count, 3)) * (rng.random((count, 3)) < 0.7)
    drawn[~drawn.any(axis=1)] = [0.0, -1.0, 0.0]
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def nearly_opposite(a: np.ndarray, short: float, seed: int) -> np.ndarray:
    """Directions that differ from the opposite ones by an angle [rad]."""
    across = np.cross(a, directions(seed + 1, len(a)))
    size = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(size > 1e-6, across / np.maximum(size, 1e-6), 0.0)
    return rotate(from_axis_angle(short * across), -a)


@settings(max_examples=60)
@given(seed=SEEDS, short=SHORT_OF_A_HALF)
def test_directions_are_brought_to_each_other(seed: int, short: float) -> None:
    a = directions(seed)
    b = nearly_opposite(a, short, seed)
    turn = between(a, b)
    np.testing.assert_allclose(np.linalg.norm(turn, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(rotate(turn, a), b, atol=2e-7)
    half = from_axis_angle(np.pi * directions(seed))
    np.testing.assert_allclose(angle_between(turn, turn), 0.0, atol=1e-7)
    for share in (0.0, 0.3, 1.0):
        assert np.isfinite(slerp(half, turn, np.full(COUNT, share))).all()
    assert np.isfinite(spline(np.stack([half, turn, half]), np.array([0.0, 0.5, 1.7]))).all()
    np.testing.assert_allclose(np.linalg.norm(level_heading(half), axis=1), 1.0, atol=1e-9)


@settings(max_examples=60)
@given(seed=SEEDS, short=SHORT_OF_A_HALF)
@example(seed=0, short=0.0)
def test_limbs_at_rest_are_brought_to_opposite_ones(seed: int, short: float) -> None:
    names = list(T_POSE.directions)
    wanted = directions(seed, len(names))
    source = replace(T_POSE, directions=dict(zip(names, wanted, strict=True)))
    target = replace(T_POSE, directions=dict(zip(names, nearly_opposite(wanted, short, seed), strict=True)))
    turns = alignment(source, target)
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1.0, atol=1e-9)


@settings(max_examples=60)
@given(seed=SEEDS)
@example(seed=0)
def test_a_recording_is_stood_up_from_any_axis(seed: int) -> None:
    skeleton = nominal_skeleton("smpl")
    for up in (*directions(seed, 4), np.array([0.0, -1.0, 0.0])):
        lying = between(np.array([0.0, 1.0, 0.0]), up)
        rotations = np.tile(lying, (2, skeleton.bone_count, 1))
        poses = PoseSequence(rotations, rotate(lying, np.array([[0.0, 0.9, 0.0], [0.1, 0.9, 0.2]])), 30.0)
        stands = Recording("clip", SMPL, skeleton, poses).stood_up(up)
        found = rotate(stands.poses.rotations, np.array([0.0, 1.0, 0.0]))
        np.testing.assert_allclose(found, np.broadcast_to([0.0, 1.0, 0.0], found.shape), atol=1e-7)
        np.testing.assert_allclose(stands.poses.root_positions[:, 1], 0.9, atol=1e-7)


def test_half_a_turn_about_every_axis_is_one() -> None:
    turn = between(np.eye(3), -np.eye(3))
    assert 2.0 * np.arccos(np.abs(turn[:, 0])) == pytest.approx(np.pi)
    np.testing.assert_allclose(multiply(turn, turn)[:, 0], -1.0)
