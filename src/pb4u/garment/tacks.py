"""Tacks: vertices of a garment sewn together, such as the end of a strap on its panel, or an open front by buttons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from pb4u.errors import InputError
from pb4u.garment.garment import Garment, SourceMap
from pb4u.garment.parts import Parts
from pb4u.garment.source_map import map_to_same
from pb4u.geometry.topology import Topology, connected_labels

FARTHEST = 0.1
"""Distance [m] over which a tack may pull two vertices together; what is farther apart is another place."""

BUTTONS_APART = 0.3
"""Distance [m] from button to button, along the front, beyond which they do not close it."""


def tacked(garment: Garment, tacks: Sequence[tuple[int, int]]) -> Garment:
    """The garment with pairs of vertices merged at their midpoints; its triangles keep their rest shapes.

    Args:
        garment: as simulated.
        tacks: pairs of vertices of the author's mesh, counted from 0.

    Raises:
        InputError: a vertex that does not exist or is sewn to itself, two that are too far apart, or a seam that is not
            possible in cloth.
    """
    if not len(tacks):
        return garment
    pairs, source = np.asarray(tacks, dtype=np.int64), garment.source
    count = len(garment.vertices) if source is None else len(source.source.vertices)
    if bad := [pair for pair in pairs.tolist() if not all(0 <= vertex < count for vertex in pair)]:
        raise InputError(
            f"{garment.name}: the tack {_told(bad[0])} names a vertex that does not exist; the garment has {count}, "
            "numbered from 0."
        )
    if (alike := pairs[pairs[:, 0] == pairs[:, 1]]).size:
        raise InputError(f"{garment.name}: the tack {_told(alike[0])} sews a vertex to itself; give two vertices.")
    ends = pairs
    if source is not None:
        ends = garment.faces[source.triangle[pairs], source.barycentric[pairs].argmax(axis=2)]
    gaps = np.linalg.norm(garment.vertices[ends[:, 0]] - garment.vertices[ends[:, 1]], axis=1)
    if (gaps > FARTHEST).any():
        raise InputError(
            f"{garment.name}: the vertices of the tack {_told(pairs[gaps.argmax()])} lie {100 * gaps.max():.0f} cm "
            f"apart; choose vertices within {100 * FARTHEST:.0f} cm of each other."
        )
    joined = sewn(garment.faces, len(garment.vertices), ends)
    if joined is None:
        raise InputError(
            f"{garment.name}: its tacks would fold a triangle onto itself or sew three edges into one; choose vertices "
            "of borders that lie against each other."
        )
    return _joined(garment, *joined)


def buttoned(garment: Garment, count: int | None) -> Garment:
    """The garment with its open front closed by buttons, each a tack at the nearest vertices.

    Args:
        garment: as worn, with its pins and parts.
        count: number of buttons, from half a distance above the lower end of the front to as much below its upper one;
            None for none.

    Raises:
        InputError: it is not open in front, or its borders there or the buttons are too far apart.
    """
    if count is None:
        return garment
    front, vertices = Parts(garment).open_front, garment.vertices
    if not len(front):
        raise InputError(f"{garment.name} is not open in front, so it has no place for buttons; leave out --buttons.")
    ways = vertices[front[:, 1]] - vertices[front[:, 0]]
    rise = ways[:, 1] / np.linalg.norm(ways, axis=1)
    one, other = np.unique(front[rise > 0.5]), np.unique(front[rise < -0.5])
    gaps, facing = cKDTree(vertices[other]).query(vertices[one])
    order = np.argsort(vertices[one, 1])
    order = order[gaps[order] <= FARTHEST]
    if len(order) < 2:
        raise InputError(
            f"{garment.name}: the borders of its front lie {100 * gaps.min():.0f} cm apart or more; buttons close "
            f"gaps of up to {100 * FARTHEST:.0f} cm."
        )
    pairs = np.column_stack([one[order], other[facing[order]]])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(vertices[pairs[:, 0]], axis=0), axis=1)))
    apart = along[-1] / count
    if count > 1 and apart > BUTTONS_APART:
        raise InputError(
            f"{garment.name}: {count} buttons would be {apart:.2f} m apart on its front of {along[-1]:.2f} m; give "
            f"{math.ceil(along[-1] / BUTTONS_APART)} or more."
        )
    chosen = pairs[np.abs(along[:, None] - apart * (np.arange(count) + 0.5)).argmin(axis=0)]
    joined = sewn(garment.faces, len(vertices), chosen)
    if joined is None or any(len(np.unique(side)) < count for side in chosen.T):
        raise InputError(
            f"{garment.name}: {count} buttons would be closer to each other than the vertices of its front; give "
            "fewer buttons, or more --triangles."
        )
    return replace(_joined(garment, *joined), buttons=joined[1][chosen[:, 0]].astype(np.int64))


def _joined(garment: Garment, faces: np.ndarray, name: np.ndarray) -> Garment:
    """The garment with vertices made one, as `sewn` names them."""
    count = int(name.max()) + 1
    members = np.bincount(name, minlength=count)[:, None]
    vertices = np.stack([np.bincount(name, axis, count) for axis in garment.vertices.T], axis=1) / members
    pinned = np.bincount(name, garment.pinned, count) > 0.0
    first, skinning = np.unique(name, return_index=True)[1], garment.skinning
    if skinning is not None:
        skinning = skinning.at(np.repeat(first[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (count, 1)))
    return replace(
        garment, vertices=vertices, faces=faces, pinned=pinned, source=garment.source or _source_of(garment),
        coarse_edges=(), skinning=skinning, rest_uv=garment.rest_shape, grainless=not garment.has_grain,
    )  # fmt: skip


def sewn(faces: np.ndarray, size: int, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Faces (faces, 3) int64 with merged vertices, and the new index (size,) of each; None if this is not possible in
    cloth.

    Args:
        faces: (faces, 3) int64.
        size: number of vertices.
        pairs: (tacks, 2) int64.
    """
    name = connected_labels(size, *pairs.T)
    joined = name[faces].astype(np.int64)
    sides = np.sort(joined, axis=1)
    if (np.diff(sides, axis=1) == 0).any() or len(Topology(joined, int(name.max()) + 1).non_manifold_edges):
        return None
    return joined, name


def _told(pair: Sequence[int]) -> str:
    return f"{pair[0]}:{pair[1]}"


def _source_of(garment: Garment) -> SourceMap:
    """Map to the garment's own mesh as it was before its tacks; triangles keep their numbers."""
    every = np.arange(len(garment.vertices))
    return map_to_same(garment.mesh, every, garment.vertices, garment.faces)
