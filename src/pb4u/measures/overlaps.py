"""Where a closed surface passes through itself, as a body does in an armpit or between the thighs of a squat."""

from __future__ import annotations

import numpy as np

from pb4u.collision.crossings import self_crossings
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import face_areas

_TWICE = 1.0
"""Winding number above which a point of the surface lies inside another part of it: there it is 1.5, elsewhere 0.5."""


def overlapping_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces (faces,) bool that cross another face, or lie inside another part of the surface.

    Args:
        vertices: (vertices, 3) [m], finite.
        faces: (faces, 3) int64 of a closed surface.
    """
    overlapping = np.zeros(len(faces), dtype=bool)
    overlapping[self_crossings(vertices, faces)] = True
    if not overlapping.any():
        return overlapping
    # What crosses is the border between what lies inside and what does not: one point tells of each piece.
    free = np.flatnonzero(~overlapping)
    piece = Topology(faces[free], len(vertices)).piece_of_vertex[faces[free, 0]]
    for number in np.setdiff1d(piece, np.bincount(piece).argmax()):
        own = free[piece == number]
        middle = own[np.argsort(face_areas(vertices, faces[own]))[len(own) // 2]]
        # At a corner the faces around it count for nothing; within a face that face would, by half, on either side.
        overlapping[own] = winding_number(vertices[faces[middle, 0]], vertices, faces) > _TWICE
    return overlapping


def buried(asked: np.ndarray, vertices: np.ndarray, faces: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Vertices (vertices,) bool that lie inside another part of a closed surface, where no one sees them.

    Args:
        asked: (vertices,) bool vertices to look at; no other is found.
        vertices: (vertices, 3) [m], finite.
        faces: (faces, 3) int64, counter-clockwise seen from outside.
        folds: (folds, 3) int64 its overlapping faces.
    """
    inside = np.zeros(len(vertices), dtype=bool)
    for row in np.intersect1d(np.flatnonzero(asked), folds):
        inside[row] = winding_number(vertices[row], vertices, faces) > _TWICE
    return inside


def winding_number(point: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> float:
    """How often a closed surface goes around a point: 1 inside, 0 outside, 0.5 on it, more where it overlaps itself.

    Args:
        point: (3,) [m].
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64, counter-clockwise seen from outside.

    Source: the solid angle of a triangle, van Oosterom and Strackee 1983.
    """
    a, b, c = (vertices[faces] - point).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a))]
    # Of a face that has the point as its corner both are zero: no angle, but for a zero that is negative.
    angles = 2.0 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb + 0.0)
    return float(angles.sum() / (4.0 * np.pi))
