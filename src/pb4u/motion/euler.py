"""Rotations from the Euler angles of motion files."""

from __future__ import annotations

import numpy as np

from pb4u.geometry.rotation import multiply


def euler_quaternions(angles: np.ndarray, order: str, degrees: bool = True) -> np.ndarray:
    """Quaternions (..., 4) wxyz of angles (..., axes), applied about fixed axes one after the other.

    Args:
        angles: angles in the order of `order`.
        order: axis letters; "xyz" turns about X first, so that R = Rz Ry Rx.
        degrees: whether the angles are in degrees.
    """
    half = 0.5 * (np.deg2rad(angles) if degrees else np.asarray(angles, dtype=np.float64))
    result: np.ndarray | None = None
    for k, axis in enumerate(order.lower()):
        q = np.zeros((*half.shape[:-1], 4))
        q[..., 0] = np.cos(half[..., k])
        q[..., 1 + "xyz".index(axis)] = np.sin(half[..., k])
        result = q if result is None else multiply(q, result)
    assert result is not None
    return result
