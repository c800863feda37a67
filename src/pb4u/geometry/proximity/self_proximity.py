"""Vertices of a mesh close over or under its own faces, and which of them have passed through (reference 6.1, 6.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.geometry.proximity.intersection_contours import ContourFinder
from pb4u.geometry.proximity.near_pairs import near_pairs
from pb4u.geometry.proximity.triangle_frames import TriangleFrames

_POINT_RADIUS = 1e-9
"""Vertices searched as balls of this radius [m]: far below any edge, and above 0, which `near_pairs` needs."""


@dataclass(frozen=True, eq=False)
class FacingPairs:
    """Vertices whose foot lies in a face that they are no corner of.

    Args:
        vertices: (pairs,) int64.
        faces: (pairs,) int64.
        heights: (pairs,) over the face's plane [m], positive outside.
        passed: (pairs,) bool, whether the vertex has passed through the face.
    """

    vertices: np.ndarray
    faces: np.ndarray
    heights: np.ndarray
    passed: np.ndarray


def facing_pairs(vertices: np.ndarray, faces: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertex, face and height [m], (pairs,) each, of all pairs whose foot is in the face; by vertex, then by face.

    Faces that have the vertex as a corner are left out, and so is what is not finite.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        radius: largest height on either side [m].
    """
    finite = np.isfinite(vertices).all(axis=1)
    vertices = np.where(finite[:, None], vertices, 0.0).astype(np.float64)
    frames = TriangleFrames.of(vertices, faces)
    usable, usable_faces = np.flatnonzero(finite), np.flatnonzero(finite[faces].all(axis=1))
    reach = np.hypot(radius, frames.radii[usable_faces])
    pieces = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
    balls = np.full(len(usable), _POINT_RADIUS)
    for v, f in near_pairs(vertices[usable], balls, frames.centres[usable_faces], reach):
        vertex, face = usable[v], usable_faces[f]
        kept = np.flatnonzero(frames.contains_foot(face, vertices[vertex]))
        vertex, face = vertex[kept], face[kept]
        height = frames.heights(face, vertices[vertex])
        kept = (faces[face] != vertex[:, None]).all(axis=1) & (np.abs(height) <= radius)
        pieces.append((vertex[kept], face[kept], height[kept]))
    vertex, face, height = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    order = np.lexsort((face, vertex))
    return vertex[order], face[order], height[order]


class SelfProximity:
    """Finds where one mesh is close to itself; what depends on its faces alone is prepared once.

    Args:
        faces: (faces, 3) int64.
        vertex_count: number of vertices.
    """

    def __init__(self, faces: np.ndarray, vertex_count: int) -> None:
        self.faces = faces
        self.contours = ContourFinder(faces, vertex_count)

    def find(self, vertices: np.ndarray, radius: float) -> FacingPairs:
        """The pairs that are close at one instant.

        A vertex that a contour encloses has passed through the faces of that contour; its other pairs are left out.

        Args:
            vertices: (vertices, 3) [m].
            radius: largest height on either side of a face [m].
        """
        vertex, face, height = facing_pairs(vertices, self.faces, radius)
        contours = self.contours.find(vertices)
        passed = contours.enclosed.getnnz(axis=1)[vertex] > 0
        matching = contours.enclosed[vertex].multiply(contours.touched[face]).getnnz(axis=1) > 0
        kept = ~passed | matching
        return FacingPairs(vertex[kept], face[kept], height[kept], passed[kept])
