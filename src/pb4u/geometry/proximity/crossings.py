"""Triangles that pass through one another, by exact predicates: what is counted, and promised, of contact."""

from __future__ import annotations

import numpy as np


def self_crossings(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Pairs (pairs, 2) int64 of faces of one surface that cross and share no vertex.

    Args:
        vertices: (vertices, 3) [m], finite.
        faces: (faces, 3) int64.
    """
    from igl.predicates import find_self_intersections

    _, pairs, _ = find_self_intersections(_floats(vertices), _integers(faces))
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    apart = (faces[pairs[:, 0]][:, :, None] != faces[pairs[:, 1]][:, None, :]).all(axis=(1, 2))
    return pairs[apart]


def crossings(
    vertices: np.ndarray, faces: np.ndarray, other_vertices: np.ndarray, other_faces: np.ndarray
) -> np.ndarray:
    """Pairs (pairs, 2) int64 of a face of one surface and a face of another that cross.

    Args:
        vertices: (vertices, 3) [m], finite.
        faces: (faces, 3) int64.
        other_vertices: (other vertices, 3) [m], finite.
        other_faces: (other faces, 3) int64.
    """
    from igl.predicates import find_intersections

    # Most of a body is far from a garment, and the search tree of both is made anew for every frame.
    corners = other_vertices[other_faces]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    near = np.flatnonzero(((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1))
    if not len(near):
        return np.zeros((0, 2), dtype=np.int64)
    _, pairs, _ = find_intersections(
        _floats(vertices), _integers(faces), _floats(other_vertices), _integers(other_faces[near])
    )
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    return np.column_stack([pairs[:, 0], near[pairs[:, 1]]])


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float64)


def _integers(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.int64)
