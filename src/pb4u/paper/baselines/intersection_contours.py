"""Where a surface passes through itself: crossings of edges and faces, joined to contours.

Intersection contours: Volino and Magnenat-Thalmann 2006; as ContourCraft uses them: reference 6.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.collision.crossing_search import CrossingSearch
from pb4u.collision.crossings import piercings
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.geometry.topology import Topology, connected_labels

_MOST = 10_000_000
"""Pairs of leaves, of two faces each, beyond which cloth has collapsed: the search would take minutes and gigabytes.
Noise of 1 cm on every vertex of 48,000 triangles, with 238,000 crossings, has a tenth of that."""


@dataclass(frozen=True, eq=False)
class Contours:
    """All contours of one surface at one instant.

    Args:
        edges: (crossings,) int64 number of the edge at each crossing.
        faces: (crossings,) int64 face it passes through.
        segments: (segments, 2) int64 crossings at both ends of the line in which two triangles intersect.
        contour: (crossings,) int64 contour that each belongs to.
        count: number of contours.
    """

    edges: np.ndarray
    faces: np.ndarray
    segments: np.ndarray
    contour: np.ndarray
    count: int


class ContourFinder:
    """Finds the contours of a moving surface.

    Args:
        tree: of the surface.
    """

    def __init__(self, tree: SurfaceTree) -> None:
        self.topology = Topology(tree.faces, len(tree.rest))
        self._search = CrossingSearch(tree, _MOST)

    def find(self, vertices: np.ndarray) -> Contours:
        """The contours at one instant; faces that are not finite or have collapsed are ignored.

        Args:
            vertices: (vertices, 3) [m].
        """
        vertices = vertices.astype(np.float64, copy=False)
        pierced = piercings(vertices, self.topology, self._search.pairs(vertices, sharing=True))
        segments = self._segments(pierced.edges, pierced.faces)
        contour = connected_labels(len(pierced), *segments.T).astype(np.int64)
        return Contours(pierced.edges, pierced.faces, segments, contour, int(contour.max(initial=-1)) + 1)

    def _segments(self, edges: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """(segments, 2) the two crossings of every pair of triangles that has exactly two."""
        crossing, other = self.topology.faces_at(edges)
        key = np.minimum(faces[crossing], other) * len(self.topology.faces) + np.maximum(faces[crossing], other)
        order = np.argsort(key, kind="stable")
        _, first, count = np.unique(key[order], return_index=True, return_counts=True)
        first = first[count == 2]
        return np.column_stack([crossing[order[first]], crossing[order[first + 1]]])
