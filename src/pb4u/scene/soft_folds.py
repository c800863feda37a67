"""Flesh that gives way where a body passes through itself, so that cloth between two of its parts has room.

A body that is posed by its bones passes through itself in a crouch, in the crook of an arm, or where who was recorded
is slimmer. Flesh would be pressed flat. Here skin that lies inside another part is moved inward, and so is the skin of
that part, until both are some millimetres apart: what is between them stays between them, and is on its own side when
they part again. Contact alone knows of it; what is written and drawn is the body as it was posed.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.body.animated_body import AnimatedBody
from pb4u.collision.jit import compiled
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.collision.winding_numbers import winding_numbers
from pb4u.geometry.topology import connected_labels

_SPACING = 0.03
"""Distance [m] between the places of the skin that are looked at."""

_REACH = 0.2
"""Distance [m] up to which places are taken to face each other."""

_FACING = -0.3
"""Cosine between the normals of two skins below which they face each other."""

_ASIDE = 0.04
"""Distance [m] across their common normal from which on two places do not face each other."""

_NEAR = 0.02
"""The same [m] of vertices, which lie closer together, to find the rim of a fold."""

_CLOSER = 0.7
"""Share of their distance at rest within which two places have met; the two sides of one limb keep theirs."""

_LEAST = 0.04
"""Depth [m] up to which a fold is left as it is; one twice as deep is opened whole."""

_ROOM = 0.006
"""Distance [m] between the skins of a fold that was opened."""

_THINNER = 0.4
"""Share of the way to the other side of its own limb that skin is moved inward at most."""

_OUTSIDE = 5e-4
"""Height [m] over the skin at which its own part is not around a place, but another may be."""

_ROUNDS = 8
"""Times that places are moved on and their depths found again."""

_NEIGHBOURS = 8
"""Places around a vertex that it moves with."""


class SoftFolds:
    """A moving body whose skin folds open.

    Args:
        body: the posed body; regions left out of contact neither press nor move.
    """

    def __init__(self, body: AnimatedBody) -> None:
        self._body = body
        self._touched = np.flatnonzero(body.contact)
        rest = np.asarray(body.rest_vertices, dtype=np.float64)[self._touched]
        cells = np.floor(rest / _SPACING).astype(np.int64)
        self._rows = np.sort(np.unique(cells, axis=0, return_index=True)[1])
        self._vertices, self._places, self._rest = rest, self._touched[self._rows], rest[self._rows]

    def positions(self, start: int, stop: int) -> Tensor:
        """Vertices of consecutive frames, as `AnimatedBody.positions` gives them, with deep folds opened.

        Args:
            start: first frame.
            stop: frame after the last.

        Returns:
            (stop - start, vertices, 3) float32 [m].
        """
        posed = self._body.positions(start, stop)
        if not self._body.is_closed or not len(self._places):
            return posed
        return torch.stack([torch.from_numpy(self.opened(frame)) for frame in posed.numpy()])

    def opened(self, positions: np.ndarray) -> np.ndarray:
        """The vertices (vertices, 3) of one frame with the folds opened; the same array if there are none.

        Args:
            positions: (vertices, 3) [m].
        """
        x = np.ascontiguousarray(positions, dtype=np.float64)
        every = _normals(x, self._body.faces)
        points, normals = x[self._places], every[self._places]
        pairs = _met(points, normals, self._rest)
        if not len(pairs):
            return positions
        inside = self._inside(x, every, pairs)
        is_inside = inside[self._rows]
        pairs = pairs[is_inside[pairs].all(axis=1)]
        if not len(pairs):
            return positions
        smooth, spread = self._smoothing, self._spread
        normals = smooth @ (smooth @ normals)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(min=1e-12)
        depth = _depth(points, normals, pairs, _ASIDE)
        room, share = depth.clip(0.0, _ROOM), _opened_share(depth, pairs)
        inward, around = np.zeros(len(points)), (smooth @ is_inside.astype(np.float64)).clip(min=1e-12)
        for _ in range(_ROUNDS):
            inward += 0.5 * np.maximum(depth + room, 0.0)
            inward = np.where(is_inside, (smooth @ inward) / around, 0.0).clip(max=self._most)
            depth = _depth(points - inward[:, None] * normals, normals, pairs, _ASIDE)
        rows = self._touched[inside]
        way = (spread @ ((share * inward)[:, None] * normals))[inside]
        # At the rim of a fold, where skins meet, nothing moves.
        rim = _depth(x[rows], every[rows], _met(x[rows], every[rows], self._vertices[inside]), _NEAR)
        most = np.where(rim > -_REACH, 2.0 * rim.clip(min=0.0), np.inf)
        way *= np.minimum(1.0, most / np.linalg.norm(way, axis=1).clip(min=1e-12))[:, None]
        opened = x.copy()
        opened[rows] -= way
        return opened.astype(positions.dtype)

    def _inside(self, x: np.ndarray, normals: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Which of the touched vertices (touched,) bool, of those around the pairs, lie inside another part."""
        is_paired = np.zeros(len(self._places))
        is_paired[pairs] = 1.0
        rows = np.flatnonzero(self._spread @ is_paired > 0.0)
        vertices = self._touched[rows]
        around = winding_numbers(self._surface.at(x).searched, x[vertices] + _OUTSIDE * normals[vertices])
        inside = np.zeros(len(self._touched), dtype=bool)
        inside[rows] = around > 0
        return inside

    @cached_property
    def _surface(self) -> TriangleSurface:
        return TriangleSurface(self._body.faces, len(self._body.contact), self._body.contact, capped=True)

    @cached_property
    def _spread(self) -> Any:
        """What each touched vertex takes of the places around it, rows of a sparse matrix that sum to one."""
        from scipy.sparse import csr_array
        from scipy.spatial import cKDTree

        normals = self._rest_normals
        count = min(_NEIGHBOURS, len(self._places))
        distances, near = cKDTree(self._rest).query(self._vertices, k=np.arange(1, count + 1))
        alike = np.einsum("vi,vki->vk", normals, normals[self._rows][near])
        # Skin that faces another way, as that of the other thigh, moves another way.
        shares = alike.clip(min=1e-3) * np.exp(-((distances / _SPACING) ** 2)) + 1e-9
        shares /= shares.sum(axis=1, keepdims=True)
        starts = np.arange(len(near) + 1) * count
        return csr_array((shares.ravel(), near.ravel(), starts), shape=(len(near), len(self._places)))

    @cached_property
    def _smoothing(self) -> Any:
        return self._spread[self._rows]

    @cached_property
    def _most(self) -> np.ndarray:
        """How far [m] each place may be moved inward."""
        return _THINNER * _thickness(self._rest, self._rest_normals[self._rows])

    @cached_property
    def _rest_normals(self) -> np.ndarray:
        rest = np.asarray(self._body.rest_vertices, dtype=np.float64)
        return _normals(rest, self._body.faces)[self._touched]


def _opened_share(depth: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Share (places,) of its opening that each place takes, by the depth of the fold that it lies in."""
    fold = connected_labels(len(depth), *pairs.T)
    deepest = np.zeros(len(depth))
    np.maximum.at(deepest, fold, depth)
    return (deepest[fold] / _LEAST - 1.0).clip(0.0, 1.0)


@compiled
def _met(points: np.ndarray, normals: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Pairs (pairs, 2) of places that face each other and came together; none where no two lie behind one another."""
    pairs = [(0, 0) for _ in range(0)]
    behind = False
    across, near = np.ascontiguousarray(points.T), np.empty(len(points), dtype=np.bool_)
    for i in range(len(points)):
        x, y, z = points[i]
        nx, ny, nz = normals[i]
        _within_reach(across[0], across[1], across[2], i, near)
        for j in range(i):
            if not near[j]:
                continue
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            squared = dx * dx + dy * dy + dz * dz
            if nx * normals[j, 0] + ny * normals[j, 1] + nz * normals[j, 2] > _FACING:
                continue
            rx, ry, rz = rest[j, 0] - rest[i, 0], rest[j, 1] - rest[i, 1], rest[j, 2] - rest[i, 2]
            if squared > _CLOSER * _CLOSER * (rx * rx + ry * ry + rz * rz):
                continue
            pairs.append((i, j))
            depth = -(dx * nx + dy * ny + dz * nz)
            # Each lies straight behind the other.
            behind |= (
                depth > _LEAST
                and dx * normals[j, 0] + dy * normals[j, 1] + dz * normals[j, 2] > _LEAST
                and squared - depth * depth < _ASIDE * _ASIDE
            )
    if not behind:
        return np.zeros((0, 2), dtype=np.int64)
    return np.array(pairs, dtype=np.int64)


@compiled
def _within_reach(x: np.ndarray, y: np.ndarray, z: np.ndarray, place: int, near: np.ndarray) -> None:
    """Fill `near` with whether those before a `place` lie within `_REACH` of it: a plain loop, eight at once."""
    for j in range(place):
        dx, dy, dz = x[j] - x[place], y[j] - y[place], z[j] - z[place]
        near[j] = dx * dx + dy * dy + dz * dz <= _REACH * _REACH


@compiled
def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals (vertices, 3) weighted by area, those of `area_weighted_normals`; 0 where no face is."""
    normals, cross = np.zeros(vertices.shape), np.empty(3)
    for face in range(len(faces)):
        a, b, c = faces[face]
        for axis in range(3):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            cross[axis] = (vertices[b, i] - vertices[a, i]) * (vertices[c, j] - vertices[a, j])
            cross[axis] -= (vertices[b, j] - vertices[a, j]) * (vertices[c, i] - vertices[a, i])
        for corner in (a, b, c):
            for axis in range(3):
                normals[corner, axis] += cross[axis]
    for row in range(len(normals)):
        length = np.sqrt(normals[row, 0] ** 2 + normals[row, 1] ** 2 + normals[row, 2] ** 2)
        for axis in range(3):
            normals[row, axis] /= max(length, 1e-30)
    return normals


@compiled
def _depth(points: np.ndarray, normals: np.ndarray, pairs: np.ndarray, aside: float) -> np.ndarray:
    """Depth (places,) [m] of places in what faces them, up to `aside` [m] across their common normal; -`_REACH` of one
    that nothing faces."""
    total, weights = np.zeros(len(points)), np.zeros(len(points))
    for i, j in pairs:
        ax, ay, az = normals[i, 0] - normals[j, 0], normals[i, 1] - normals[j, 1], normals[i, 2] - normals[j, 2]
        dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
        depth = (dx * ax + dy * ay + dz * az) / math.sqrt(ax * ax + ay * ay + az * az)
        weight = 1.0 - (dx * dx + dy * dy + dz * dz - depth * depth) / (aside * aside)
        if weight > 0.0:
            for place in (i, j):
                total[place] += weight * weight * depth
                weights[place] += weight * weight
    for place in range(len(points)):
        total[place] = total[place] / weights[place] if weights[place] > 0.0 else -_REACH
    return total


@compiled
def _thickness(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Distance (places,) [m] from each place inward to the other side of its limb; infinite where there is none."""
    found = np.full(len(points), np.inf)
    for i in range(len(points)):
        x, y, z = points[i]
        nx, ny, nz = normals[i]
        for j in range(len(points)):
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            depth = -(dx * nx + dy * ny + dz * nz)
            if depth <= 0.0 or depth >= found[i]:
                continue
            facing = nx * normals[j, 0] + ny * normals[j, 1] + nz * normals[j, 2] < _FACING
            if facing and dx * dx + dy * dy + dz * dz - depth * depth < _ASIDE * _ASIDE:
                found[i] = depth
    return found
