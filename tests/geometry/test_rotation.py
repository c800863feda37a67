"""Quaternions against their definition and against scipy."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pb4u.geometry import rotation

RNG = np.random.default_rng(3)


def random_quaternions(count: int) -> np.ndarray:
    q = RNG.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def as_scipy(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(rotation.to_xyzw(q))


def test_product_rotation_and_matrix_agree_with_scipy() -> None:
    a, b, v = random_quaternions(50), random_quaternions(50), RNG.normal(size=(50, 3))
    expected = (as_scipy(a) * as_scipy(b)).as_matrix()
    product = rotation.multiply(a, b)
    np.testing.assert_allclose(as_scipy(product).as_matrix(), expected, atol=1e-12)
    np.testing.assert_allclose(rotation.rotate(a, v), as_scipy(a).apply(v), atol=1e-12)
    np.testing.assert_allclose(
        rotation.matrix_from_quaternion(torch.from_numpy(a)), as_scipy(a).as_matrix(), atol=1e-12
    )


def test_real_parts_go_last_for_scipy_and_back_to_the_front() -> None:
    q = random_quaternions(5)
    assert np.array_equal(rotation.to_xyzw(q)[:, 3], q[:, 0])
    assert np.array_equal(rotation.from_xyzw(rotation.to_xyzw(q)), q)


def test_axis_angle_is_exact_near_zero_and_at_half_turns() -> None:
    vectors = np.concatenate([RNG.normal(size=(20, 3)), np.zeros((1, 3)), 1e-9 * np.eye(3), np.pi * np.eye(3)])
    expected = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(as_scipy(rotation.from_axis_angle(vectors)).as_matrix(), expected, atol=1e-12)


def test_slerp_takes_the_short_way_at_constant_speed() -> None:
    a, b = random_quaternions(30), random_quaternions(30)
    whole = rotation.angle_between(a, b)
    assert (whole <= np.pi + 1e-12).all()
    for s in (0.0, 0.25, 1.0):
        at = rotation.slerp(a, b, np.full(30, s))
        np.testing.assert_allclose(rotation.angle_between(a, at), s * whole, atol=1e-7)
    np.testing.assert_allclose(rotation.slerp(a, -a, np.full(30, 0.5)) @ np.zeros(4), 0.0)
    np.testing.assert_allclose(rotation.angle_between(rotation.slerp(a, -a, np.full(30, 0.5)), a), 0.0, atol=1e-7)


def test_a_spline_of_rotations_passes_through_all_without_a_jump_of_velocity() -> None:
    random = np.random.default_rng(1)
    turns = np.cumsum(0.2 * random.normal(size=(8, 3, 3)), axis=0)
    samples = rotation.from_axis_angle(turns)
    np.testing.assert_allclose(np.abs((rotation.spline(samples, np.arange(8.0)) * samples).sum(-1)), 1.0, atol=1e-12)
    h, inside = 1e-5, np.arange(1.0, 7.0)
    before = rotation.angle_between(rotation.spline(samples, inside - h), rotation.spline(samples, inside)) / h
    after = rotation.angle_between(rotation.spline(samples, inside), rotation.spline(samples, inside + h)) / h
    np.testing.assert_allclose(before, after, atol=1e-3)
    by_lines = np.abs(
        rotation.angle_between(samples[:-2], samples[1:-1]) - rotation.angle_between(samples[1:-1], samples[2:])
    )
    assert by_lines.max() > 0.1


def test_a_spline_of_rotations_turns_evenly_where_they_do_and_past_none_that_stays() -> None:
    angles = np.array([0.0, 0.3, 0.6, 0.9, 0.9, 0.9, 0.0])
    place = np.linspace(0.0, 6.0, 61)
    found = rotation.spline(rotation.about_axis("y", angles), place)
    turned = 2.0 * np.arctan2(found[:, 2], found[:, 0])
    np.testing.assert_allclose(turned[10:21], 0.03 * np.arange(10, 21), atol=1e-12)
    np.testing.assert_allclose(turned[30:51], 0.9, atol=1e-12)
    assert turned.max() < 0.9 + 1e-12
    assert turned.min() > -1e-12
