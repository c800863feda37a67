"""Polygons cut into triangles; docs/design/programs.md has other ways."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_FLAT = 1e-6
"""Share of a quad below which a triangle of it has no area."""


def triangulate(vertices: np.ndarray, polygons: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons, in the polygons' order and orientation.

    A quad is divided along its shorter diagonal that is inside it; an n-gon by ear clipping in its mean plane.

    Args:
        vertices: (vertices, 3) [m].
        polygons: (corners,) int64 vertex indices of each polygon, 3 or more.

    Returns:
        corners: (triangles, 3) int64 into the concatenated polygon corners.
        polygon: (triangles,) int64 the polygon that each triangle was cut from.
    """
    sizes = np.array([len(p) for p in polygons], dtype=np.int64)
    flat = np.concatenate(polygons) if len(polygons) else np.zeros(0, dtype=np.int64)
    starts = np.cumsum(sizes) - sizes
    three, four, more = (np.flatnonzero(k) for k in (sizes == 3, sizes == 4, sizes > 4))
    quad = starts[four, None] + np.arange(4)
    p = vertices[flat[quad]]
    first, second = _least_turned(p, (0, 1, 2, 3)), _least_turned(p, (1, 2, 3, 0))
    shorter = np.linalg.norm(p[:, 0] - p[:, 2], axis=1) <= np.linalg.norm(p[:, 1] - p[:, 3], axis=1)
    across = np.where((first > _FLAT) == (second > _FLAT), shorter, first > _FLAT)
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


def _least_turned(quads: np.ndarray, order: tuple[int, int, int, int]) -> np.ndarray:
    """The smaller of the two triangles that a diagonal makes of each quad (quads, 4, 3), as a share of the quad.

    Not positive where the diagonal lies outside: from the first to the third corner in that order.
    """
    a, b, c, d = (quads[:, corner] for corner in order)
    normals = np.cross(c - a, d - b)
    areas = np.stack(
        [np.einsum("qi,qi->q", np.cross(b - a, c - a), normals), np.einsum("qi,qi->q", np.cross(c - a, d - a), normals)]
    )
    area = np.einsum("qi,qi->q", normals, normals)
    return areas.min(axis=0) / np.where(area > 0.0, area, 1.0)


def _clip_ears(points: np.ndarray) -> np.ndarray:
    """(n - 2, 3) local corner indices of a simple polygon (n, 3), seen along its Newell normal."""
    following = np.roll(points, -1, axis=0)
    normal = np.cross(points, following).sum(axis=0)
    normal /= np.linalg.norm(normal) or 1.0
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(axis, normal)
    flat = np.stack([points @ u, points @ np.cross(normal, u)], axis=1)
    count = len(points)
    before, after, is_left = np.roll(np.arange(count), 1), np.roll(np.arange(count), -1), np.ones(count, dtype=bool)
    quality = np.array([_ear_quality(flat, is_left, before[k], k, after[k]) for k in range(count)])
    ears: list[tuple[int, int, int]] = []
    while len(ears) < count - 3:
        best = int(quality.argmax())
        if quality[best] <= 0.0:
            # Only a polygon that crosses itself has no ear; what is clipped then is as good as anything.
            rest = np.flatnonzero(is_left).tolist()
            quality[rest] = [_ear_quality(flat, is_left, before[k], k, after[k]) for k in rest]
            best = int(np.where(is_left, quality, -np.inf).argmax())
        a, c = int(before[best]), int(after[best])
        ears.append((a, best, c))
        is_left[best], quality[best] = False, -np.inf
        after[a], before[c] = c, a
        # A clipped corner is convex, and alone keeps no other from being an ear: only the two beside it change.
        for k in (a, c):
            quality[k] = _ear_quality(flat, is_left, before[k], k, after[k])
    a, b, c = np.flatnonzero(is_left).tolist()
    ears.append((a, b, c))
    return np.array(ears, dtype=np.int64)


def _ear_quality(flat: np.ndarray, is_left: np.ndarray, before: int, at: int, after: int) -> float:
    """Signed area of the ear at a corner over its squared perimeter; -1 when another corner that is left lies in it."""
    a, b, c = corners = flat[[before, at, after]]
    sides = np.array([b - a, c - b, a - c])
    area = float(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0])
    if area <= 0.0:
        return -1.0
    others = is_left.copy()
    others[[before, at, after]] = False
    offsets = flat[others][:, None] - corners
    crosses = sides[:, 0] * offsets[..., 1] - sides[:, 1] * offsets[..., 0]
    if bool((crosses > 0.0).all(axis=1).any()):
        return -1.0
    return area / float(np.linalg.norm(sides, axis=1).sum() ** 2)
