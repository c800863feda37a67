"""Rotations as unit quaternions, wxyz. Dtype and device follow the input."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def matrix_from_quaternion(quaternion: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of wxyz quaternions (..., 4), normalised first."""
    w, x, y, z = torch.nn.functional.normalize(quaternion, dim=-1).unbind(-1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(*quaternion.shape[:-1], 3, 3)


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion product a b (..., 4), wxyz: the rotation b followed by a."""
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
    """Inverse (..., 4) of unit quaternions wxyz."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) turned by unit quaternions (..., 4) wxyz."""
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def from_axis_angle(axis_angle: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) wxyz of rotation vectors (..., 3) [rad]."""
    half = 0.5 * np.linalg.norm(axis_angle, axis=-1, keepdims=True)
    # sinc keeps the zero rotation exact.
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * axis_angle], axis=-1)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle (...) [rad] in [0, pi] of the rotation that takes unit quaternions a to b."""
    d = multiply(b, conjugate(a))
    return 2.0 * np.arctan2(np.linalg.norm(d[..., 1:], axis=-1), np.abs(d[..., 0]))


def slerp(a: np.ndarray, b: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Shortest spherical interpolation (..., 4) between unit quaternions a (s = 0) and b (s = 1); s broadcasts."""
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


def about_axis(axis: str, angle: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) wxyz of turns by `angle` (...) [rad] about the axis "x", "y" or "z"."""
    half = 0.5 * np.asarray(angle, dtype=np.float64)
    q = np.zeros((*half.shape, 4))
    q[..., 0] = np.cos(half)
    q[..., 1 + "xyz".index(axis)] = np.sin(half)
    return q


def from_euler(angles: np.ndarray, order: str, degrees: bool = True) -> np.ndarray:
    """Quaternions (..., 4) wxyz of Euler angles, applied about fixed axes one after the other.

    Args:
        angles: (..., axes) in the order of `order`.
        order: axis letters; "xyz" turns about X first, so that R = Rz Ry Rx.
        degrees: whether the angles are in degrees instead of radians.
    """
    turns = np.deg2rad(angles) if degrees else angles
    result = about_axis(order[0].lower(), turns[..., 0])
    for k, axis in enumerate(order[1:].lower(), 1):
        result = multiply(about_axis(axis, turns[..., k]), result)
    return result


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Smallest rotation (..., 4) wxyz that takes unit vectors a (..., 3) to b (..., 3), which must not be opposite."""
    q = np.concatenate([1.0 + np.sum(a * b, axis=-1, keepdims=True), np.cross(a, b)], axis=-1)
    return q / np.linalg.norm(q, axis=-1, keepdims=True)
