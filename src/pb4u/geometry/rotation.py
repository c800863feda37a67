"""Rotations as unit quaternions, wxyz. Dtype and device follow the input."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

_OPPOSITE = 3e-8
"""Angle [rad] below half a turn at which rounding hides the axis between two directions."""


def matrix_from_quaternion(quaternion: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of wxyz quaternions (..., 4), normalised first.

    Args:
        quaternion: (..., 4) wxyz, of any length but 0.
    """
    w, x, y, z = torch.nn.functional.normalize(quaternion, dim=-1).unbind(-1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(*quaternion.shape[:-1], 3, 3)


def from_xyzw(q: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) wxyz from the order xyzw of scipy and glTF.

    Args:
        q: (..., 4) xyzw.
    """
    return q[..., [3, 0, 1, 2]]


def to_xyzw(q: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) xyzw as scipy and glTF have them.

    Args:
        q: (..., 4) wxyz.
    """
    return q[..., [1, 2, 3, 0]]


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion product a b: the rotation b followed by a.

    Args:
        a: (..., 4) unit quaternions wxyz.
        b: (..., 4) unit quaternions wxyz.

    Returns:
        (..., 4) unit quaternions wxyz.
    """
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: np.ndarray) -> np.ndarray:
    """Inverse rotations (..., 4) of unit quaternions (..., 4) wxyz.

    Args:
        q: (..., 4) unit quaternions wxyz.
    """
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors turned by rotations.

    Args:
        q: (..., 4) unit quaternions wxyz.
        v: (..., 3) vectors in any unit.

    Returns:
        (..., 3) in the same unit.
    """
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def from_axis_angle(axis_angle: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) wxyz of rotation vectors (..., 3) [rad].

    Args:
        axis_angle: (..., 3) [rad].
    """
    half = 0.5 * np.linalg.norm(axis_angle, axis=-1, keepdims=True)
    # sinc keeps the zero rotation exact.
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * axis_angle], axis=-1)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle of the rotation that takes one orientation to another.

    Args:
        a: (..., 4) unit quaternions wxyz.
        b: (..., 4) unit quaternions wxyz.

    Returns:
        (...) in [0, pi] [rad].
    """
    d = multiply(b, conjugate(a))
    return 2.0 * np.arctan2(np.linalg.norm(d[..., 1:], axis=-1), np.abs(d[..., 0]))


def slerp(a: np.ndarray, b: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Shortest spherical interpolation between rotations.

    Args:
        a: (..., 4) unit quaternions wxyz, at s = 0.
        b: (..., 4) unit quaternions wxyz, at s = 1.
        s: (...) interpolation parameter from 0 to 1, broadcast.

    Returns:
        (..., 4) unit quaternions wxyz.
    """
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(cosine < 0, -b, b)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    s = np.asarray(s)[..., None]
    near = angle < 1e-6
    sine = np.where(near, 1.0, np.sin(angle))
    wa = np.where(near, 1.0 - s, np.sin((1.0 - s) * angle) / sine)
    wb = np.where(near, s, np.sin(s * angle) / sine)
    q = wa * a + wb * b
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def spline(samples: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Rotations that interpolate the samples with a continuous angular velocity, without overshoot.

    Between two samples a cubic Bezier curve on the sphere (Shoemake 1985), at whose ends the angular velocity is the
    mean over both neighbours, and at most 1.5 times the slower of the two.

    Args:
        samples: (samples, ..., 4) unit quaternions wxyz, two at least.
        place: (n,) position in samples, from 0 to the last.

    Returns:
        (n, ..., 4) unit quaternions wxyz.
    """
    turns = _axis_angles(multiply(samples[1:], conjugate(samples[:-1])))
    before, after = np.concatenate([turns[:1], turns]), np.concatenate([turns, turns[-1:]])
    slower = np.minimum(np.linalg.norm(before, axis=-1), np.linalg.norm(after, axis=-1))[..., None]
    mean = 0.5 * (before + after)
    speed = np.linalg.norm(mean, axis=-1, keepdims=True)
    mean *= np.minimum(1.0, 1.5 * slower / np.maximum(speed, 1e-12))
    lower = np.minimum(np.floor(place).astype(np.int64), max(len(samples) - 2, 0))
    upper = np.minimum(lower + 1, len(samples) - 1)
    s = (place - lower).reshape(-1, *[1] * (samples.ndim - 2))
    points = [
        samples[lower],
        multiply(from_axis_angle(mean[lower] / 3.0), samples[lower]),
        multiply(from_axis_angle(-mean[upper] / 3.0), samples[upper]),
        samples[upper],
    ]
    while len(points) > 1:
        points = [slerp(first, second, s) for first, second in pairwise(points)]
    return points[0]


def _axis_angles(q: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] of unit quaternions, the short way round."""
    q = np.where(q[..., :1] < 0.0, -q, q)
    size = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(size, q[..., :1])
    return q[..., 1:] * np.where(size < 1e-12, 2.0, angle / np.maximum(size, 1e-12))


def about_axis(axis: str, angle: np.ndarray) -> np.ndarray:
    """Rotations about a coordinate axis.

    Args:
        axis: "x", "y" or "z".
        angle: (...) [rad].

    Returns:
        (..., 4) unit quaternions wxyz.
    """
    half = 0.5 * np.asarray(angle, dtype=np.float64)
    q = np.zeros((*half.shape, 4))
    q[..., 0] = np.cos(half)
    q[..., 1 + "xyz".index(axis)] = np.sin(half)
    return q


def from_euler(angles: np.ndarray, order: str, degrees: bool = True) -> np.ndarray:
    """Rotations of Euler angles, applied about fixed axes one after the other.

    Args:
        angles: (..., axes) in the order of `order` [deg] or [rad].
        order: axis letters; "xyz" turns about X first, so that R = Rz Ry Rx.
        degrees: whether the angles are in degrees instead of radians.

    Returns:
        (..., 4) unit quaternions wxyz.
    """
    turns = np.deg2rad(angles) if degrees else angles
    result = about_axis(order[0].lower(), turns[..., 0])
    for k, axis in enumerate(order[1:].lower(), 1):
        result = multiply(about_axis(axis, turns[..., k]), result)
    return result


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Smallest rotation that takes one direction to another; for opposite ones, any half turn.

    Args:
        a: (..., 3) unit vectors.
        b: (..., 3) unit vectors.

    Returns:
        (..., 4) unit quaternions wxyz.
    """
    q = np.concatenate([1.0 + np.sum(a * b, axis=-1, keepdims=True), np.cross(a, b)], axis=-1)
    size = np.linalg.norm(q, axis=-1, keepdims=True)
    across = np.cross(a, np.eye(3)[np.abs(a).argmin(axis=-1)])
    half = np.concatenate([np.zeros_like(across[..., :1]), across], axis=-1)
    opposite = size < _OPPOSITE
    q = np.where(opposite, half, q)
    return q / np.where(opposite, np.linalg.norm(half, axis=-1, keepdims=True), size)
