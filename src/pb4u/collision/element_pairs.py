"""Pairs of near elements of a surface, a vertex and a face or two edges: how far apart they are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pb4u.collision.element_distance import gather, nearest
from pb4u.collision.jit import compiled
from pb4u.collision.lasting_pairs import Neighbourhood


@dataclass(frozen=True, eq=False)
class ElementPairs:
    """Pairs of a vertex and a face, then pairs of two edges, that come near one another and share no vertex.

    Args:
        corners: (pairs, 4) int64 the vertex and the face's corners, or the ends of both edges.
        vertex_faces: number of pairs of the first kind, which come first.
        rest_distance: (pairs,) [m] between them in the rest shape; infinite between two parts.
        neighbourhood: by which they were found, or None.
    """

    corners: np.ndarray
    vertex_faces: int
    rest_distance: np.ndarray
    neighbourhood: Neighbourhood | None = None

    def __len__(self) -> int:
        return len(self.corners)

    def nearest(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (pairs,) [m], weights (pairs, 4) of the corners and unit normals (pairs, 3).

        The vector between the nearest points, the normal times the distance, is the sum of the weighted corners.

        Args:
            vertices: (vertices, 3) float64 [m].
        """
        return _all_nearest(np.ascontiguousarray(vertices), self.corners, self.vertex_faces)

    def chosen(self, rows: np.ndarray) -> ElementPairs:
        """The pairs where `rows` (pairs,) bool holds.

        Args:
            rows: (pairs,) bool.
        """
        return replace(
            self,
            corners=self.corners[rows],
            vertex_faces=int(rows[: self.vertex_faces].sum()),
            rest_distance=self.rest_distance[rows],
        )


@compiled
def rest_distances(rest: np.ndarray, part: np.ndarray, corners: np.ndarray, vertex_faces: int) -> np.ndarray:
    """Distances (pairs,) [m] at rest of pairs of one part, infinite between two.

    Args:
        rest: (vertices, 3) [m] at rest.
        part: (vertices,) int64 connected part of each vertex.
        corners: (pairs, 4) int64 vertices of the pairs.
        vertex_faces: number of leading pairs that are of a vertex and a face.
    """
    count = len(corners)
    distances = np.full(count, np.inf)
    points, weights, between = np.empty((4, 3)), np.empty(4), np.empty(3)
    for pair in range(count):
        if part[corners[pair, 0]] == part[corners[pair, 2]]:
            gather(rest, corners[pair], points)
            distances[pair] = nearest(points, pair < vertex_faces, weights, between)
    return distances


@compiled
def _all_nearest(
    vertices: np.ndarray, corners: np.ndarray, vertex_faces: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (pairs,), weights (pairs, 4) and unit normals (pairs, 3) of pairs."""
    count = len(corners)
    distances, weights, normals = np.empty(count), np.empty((count, 4)), np.empty((count, 3))
    points = np.empty((4, 3))
    for pair in range(count):
        gather(vertices, corners[pair], points)
        distances[pair] = nearest(points, pair < vertex_faces, weights[pair], normals[pair])
        for axis in range(3):
            normals[pair, axis] /= max(distances[pair], 1e-300)
    return distances, weights, normals
