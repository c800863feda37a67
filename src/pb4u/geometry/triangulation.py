"""Polygons cut into triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def triangulate(vertices: np.ndarray, polygons: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons, in the polygons' order and orientation.

    A quad is cut along its shorter diagonal, an n-gon by clipping ears in its mean plane.

    Args:
        vertices: (vertices, 3) [m].
        polygons: (corners,) int64 vertex indices of each polygon, 3 or more.

    Returns:
        corners: (triangles, 3) int64 into the polygons' corners laid end to end.
        polygon: (triangles,) int64 the polygon that each triangle was cut from.
    """
    sizes = np.array([len(p) for p in polygons], dtype=np.int64)
    flat = np.concatenate(polygons) if len(polygons) else np.zeros(0, dtype=np.int64)
    starts = np.cumsum(sizes) - sizes
    three, four, more = (np.flatnonzero(k) for k in (sizes == 3, sizes == 4, sizes > 4))
    quad = starts[four, None] + np.arange(4)
    p = vertices[flat[quad]]
    across = np.linalg.norm(p[:, 0] - p[:, 2], axis=1) <= np.linalg.norm(p[:, 1] - p[:, 3], axis=1)
    cuts = np.where(across[:, None], [[0, 1, 2, 0, 2, 3]], [[0, 1, 3, 1, 2, 3]])
    corners = [starts[three, None] + np.arange(3), np.take_along_axis(quad, cuts, axis=1).reshape(-1, 3)]
    owners = [three, np.repeat(four, 2)]
    for polygon in more.tolist():
        ears = _clip_ears(vertices[polygons[polygon]])
        corners.append(starts[polygon] + ears)
        owners.append(np.full(len(ears), polygon))
    owner = np.concatenate(owners).astype(np.int64)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(corners)[order].astype(np.int64), owner[order]


def _clip_ears(points: np.ndarray) -> np.ndarray:
    """(n - 2, 3) local corner indices of a simple polygon (n, 3), seen along its Newell normal."""
    following = np.roll(points, -1, axis=0)
    normal = np.cross(points, following).sum(axis=0)
    normal /= np.linalg.norm(normal) or 1.0
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(axis, normal)
    flat = np.stack([points @ u, points @ np.cross(normal, u)], axis=1)
    left = list(range(len(points)))
    ears: list[tuple[int, int, int]] = []
    while len(left) > 3:
        best = max(range(len(left)), key=lambda k: _ear_quality(flat, left, k))
        ears.append((left[best - 1], left[best], left[(best + 1) % len(left)]))
        del left[best]
    ears.append((left[0], left[1], left[2]))
    return np.array(ears, dtype=np.int64)


def _ear_quality(flat: np.ndarray, left: list[int], k: int) -> float:
    """Signed area of the ear at place k over its squared perimeter; -1 when another corner lies in it."""
    a, b, c = flat[left[k - 1]], flat[left[k]], flat[left[(k + 1) % len(left)]]
    sides = np.array([b - a, c - b, a - c])
    area = float(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0])
    others = flat[[i for n, i in enumerate(left) if n not in (k, (k - 1) % len(left), (k + 1) % len(left))]]
    offsets = others[:, None] - np.array([a, b, c])
    crosses = sides[:, 0] * offsets[..., 1] - sides[:, 1] * offsets[..., 0]
    if area <= 0.0 or bool((crosses > 0.0).all(axis=1).any()):
        return -1.0
    return area / float(np.linalg.norm(sides, axis=1).sum() ** 2)
