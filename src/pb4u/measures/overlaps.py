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
    import igl

    overlapping = np.zeros(len(faces), dtype=bool)
    overlapping[self_crossings(vertices, faces)] = True
    if not overlapping.any():
        return overlapping
    # What crosses is the border between what lies inside and what does not: one point tells of each piece.
    free = np.flatnonzero(~overlapping)
    piece = Topology(faces[free], len(vertices)).piece_of_vertex[faces[free, 0]]
    pieces = [free[piece == number] for number in np.setdiff1d(piece, np.bincount(piece).argmax())]
    middles = [piece[np.argsort(face_areas(vertices, faces[piece]))[len(piece) // 2]] for piece in pieces]
    # At a corner the faces around it count for nothing; within a face that face would, by half, on either side.
    corners = faces[np.array(middles, dtype=np.int64), 0]
    for face_group, number in zip(pieces, igl.winding_number(vertices, faces, vertices[corners]), strict=True):
        overlapping[face_group] = number > _TWICE
    return overlapping


def buried(mask: np.ndarray, vertices: np.ndarray, faces: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Vertices (vertices,) bool that lie inside another part of a closed surface, where they are not visible.

    Args:
        mask: (vertices,) bool vertices to test.
        vertices: (vertices, 3) [m], finite.
        faces: (faces, 3) int64, counter-clockwise seen from outside.
        folds: (folds, 3) int64 its overlapping faces.
    """
    import igl

    inside = np.zeros(len(vertices), dtype=bool)
    rows = np.intersect1d(np.flatnonzero(mask), folds)
    inside[rows] = igl.winding_number(vertices, faces, vertices[rows]) > _TWICE
    return inside
