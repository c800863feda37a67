"""Where a mesh passes through itself: crossings of edges and faces, joined to contours, and the side they enclose.

Intersection contours: Volino and Magnenat-Thalmann 2006; as ContourCraft uses them: reference 6.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pb4u.geometry.proximity.near_pairs import near_pairs
from pb4u.geometry.proximity.triangle_frames import TriangleFrames
from pb4u.geometry.topology import Topology

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


@dataclass(frozen=True, eq=False)
class Contours:
    """All contours of one mesh at one instant.

    Args:
        edges: (crossings, 2) int64 ends of the edge at each crossing.
        faces: (crossings,) int64 face it passes through.
        segments: (segments, 2) int64 crossings at both ends of the line in which two triangles intersect.
        contour: (crossings,) int64 contour that each belongs to.
        count: number of contours.
        enclosed: (vertices, contours) bool, vertices on the smaller side of a contour that cuts the mesh apart.
        touched: (faces, contours) bool, faces that a contour runs through or that have an enclosed corner.
    """

    edges: np.ndarray
    faces: np.ndarray
    segments: np.ndarray
    contour: np.ndarray
    count: int
    enclosed: csr_matrix
    touched: csr_matrix


class ContourFinder:
    """Finds the contours of a mesh.

    Args:
        faces: (faces, 3) int64.
        vertex_count: number of vertices.
    """

    def __init__(self, faces: np.ndarray, vertex_count: int) -> None:
        self.topology = Topology(faces, vertex_count)
        edges, faces_of = self.topology.edges, self.topology.face_edges.reshape(-1)
        order = np.argsort(faces_of, kind="stable")
        self._faces_at_edge = order // 3
        self._first_face = np.searchsorted(faces_of[order], np.arange(len(edges) + 1))

    def find(self, vertices: np.ndarray) -> Contours:
        """The contours at `vertices` (vertices, 3) [m]; what is not finite crosses nothing."""
        edge, face = self.crossings(vertices)
        segments = self._segments(edge, face)
        count, contour = _pieces(segments, len(edge))
        enclosed = self._enclosed(edge, contour, count)
        return Contours(
            self.topology.edges[edge],
            face,
            segments,
            contour.astype(np.int64),
            count,
            enclosed,
            self._touched(edge, face, contour, count, enclosed),
        )

    def crossings(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Edge and face, (crossings,) int64 each, of all edges through faces that they share no vertex with.

        Args:
            vertices: (vertices, 3) [m].
        """
        faces, all_edges = self.topology.faces, self.topology.edges
        finite = np.isfinite(vertices).all(axis=1)
        vertices = np.where(finite[:, None], vertices, 0.0).astype(np.float64)
        frames = TriangleFrames.of(vertices, faces)
        starts, ends = vertices[all_edges[:, 0]], vertices[all_edges[:, 1]]
        usable_edges = np.flatnonzero(finite[all_edges].all(axis=1))
        usable_faces = np.flatnonzero(finite[faces].all(axis=1))
        halves = 0.5 * np.linalg.norm(ends - starts, axis=1)
        pieces = [(np.zeros(0, dtype=np.int64),) * 2]
        for e, f in near_pairs(
            0.5 * (starts + ends)[usable_edges],
            halves[usable_edges],
            frames.centres[usable_faces],
            frames.radii[usable_faces],
        ):
            edge, face = usable_edges[e], usable_faces[f]
            above, below = frames.heights(face, starts[edge]), frames.heights(face, ends[edge])
            kept = np.flatnonzero(above * below < 0.0)
            edge, face, above, below = edge[kept], face[kept], above[kept], below[kept]
            apart = (all_edges[edge][:, :, None] != faces[face][:, None, :]).all(axis=(1, 2))
            edge, face, share = edge[apart], face[apart], (above / (above - below))[apart]
            points = starts[edge] + share[:, None] * (ends[edge] - starts[edge])
            inside = frames.contains_foot(face, points)
            pieces.append((edge[inside], face[inside]))
        edge, face = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
        order = np.lexsort((face, edge))
        return edge[order], face[order]

    def _segments(self, edge: np.ndarray, face: np.ndarray) -> np.ndarray:
        """(segments, 2) the two crossings of every pair of triangles that has exactly two."""
        crossing, other = self._expand(edge)
        key = np.minimum(face[crossing], other) * len(self.topology.faces) + np.maximum(face[crossing], other)
        order = np.argsort(key, kind="stable")
        _, first, count = np.unique(key[order], return_index=True, return_counts=True)
        first = first[count == 2]
        return np.column_stack([crossing[order[first]], crossing[order[first + 1]]])

    def _expand(self, edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For every crossing and every face at its edge: the crossing and the face."""
        first, count = self._first_face[edge], np.diff(self._first_face)[edge]
        crossing = np.repeat(np.arange(len(edge)), count)
        within = np.arange(len(crossing)) - np.repeat(np.cumsum(count) - count, count)
        return crossing, self._faces_at_edge[np.repeat(first, count) + within]

    def _enclosed(self, edge: np.ndarray, contour: np.ndarray, count: int) -> csr_matrix:
        """Vertices on the smaller side of each contour: where the mesh, its crossed edges cut, falls apart."""
        edges, vertex_count = self.topology.edges, self.topology.vertex_count
        whole = np.ones(len(edges), dtype=bool)
        whole[edge] = False
        _, part = _pieces(edges[whole], vertex_count)
        size = np.bincount(part)
        a, b = part[edges[edge, 0]], part[edges[edge, 1]]
        parts = np.concatenate([a[size[a] < size[b]], b[size[b] < size[a]]])
        contours = np.concatenate([contour[size[a] < size[b]], contour[size[b] < size[a]]])
        inside = _table(parts, contours, (len(size), count))
        return _table(np.arange(vertex_count), part, (vertex_count, len(size))) @ inside

    def _touched(
        self, edge: np.ndarray, face: np.ndarray, contour: np.ndarray, count: int, enclosed: csr_matrix
    ) -> csr_matrix:
        faces = self.topology.faces
        crossing, at_edge = self._expand(edge)
        run_through = _table(
            np.concatenate([face, at_edge]), np.concatenate([contour, contour[crossing]]), (len(faces), count)
        )
        corners = _table(
            np.repeat(np.arange(len(faces)), 3), faces.reshape(-1), (len(faces), self.topology.vertex_count)
        )
        return run_through + corners @ enclosed


def _pieces(pairs: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """Number of connected pieces of `count` things joined by `pairs` (pairs, 2), and the piece of each."""
    from scipy.sparse.csgraph import connected_components

    return connected_components(_table(pairs[:, 0], pairs[:, 1], (count, count)), directed=False)


def _table(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> csr_matrix:
    """A matrix of booleans, True at the given places."""
    from scipy.sparse import csr_matrix

    return csr_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=shape)
