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
