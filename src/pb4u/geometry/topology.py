"""Connectivity of a triangle mesh: edges, hinges, boundary loops, pieces. Indices only, no positions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Topology:
    """Connectivity of one triangle mesh, derived from its faces on first use.

    Args:
        faces: (faces, 3) int64 vertex indices, counter-clockwise seen from outside.
        vertex_count: number of vertices; may exceed the largest index (isolated vertices).
    """

    faces: np.ndarray
    vertex_count: int

    @cached_property
    def _half_edges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Unique edges, edge of each half-edge, number of half-edges per edge, half-edges (3 F, 2) corner-major."""
        half_edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        edges, edge_of, counts = np.unique(np.sort(half_edges, axis=1), axis=0, return_inverse=True, return_counts=True)
        return edges, edge_of.reshape(-1), counts, half_edges

    @property
    def edges(self) -> np.ndarray:
        """(edges, 2) int64 undirected edges, each once, lower index first, in lexicographic order."""
        return self._half_edges[0]

    @property
    def face_edges(self) -> np.ndarray:
        """(faces, 3) int64 edge index of corners 01, 12 and 20 of each face."""
        return self._half_edges[1].reshape(3, -1).T

    @property
    def edge_face_counts(self) -> np.ndarray:
        """(edges,) number of faces that meet at each edge: 1 on a border, 2 inside, more where not manifold."""
        return self._half_edges[2]

    @cached_property
    def hinges(self) -> np.ndarray:
        """(hinges, 4) int64 edge (v0, v1) and opposite vertices (v2 of the face that runs v0->v1, v3 of the other).

        Border edges have no hinge; an edge with more than two faces keeps its first two.
        """
        _, edge_of, counts, half_edges = self._half_edges
        opposite = np.concatenate([self.faces[:, 2], self.faces[:, 0], self.faces[:, 1]])
        order = np.argsort(edge_of, kind="stable")
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        shared = counts >= 2
        first, second = order[starts[shared]], order[starts[shared] + 1]
        return np.column_stack([half_edges[first], opposite[first], opposite[second]])

    @cached_property
    def hinge_faces(self) -> np.ndarray:
        """(hinges, 2) int64 the two faces of each row of `hinges`."""
        _, edge_of, counts, _ = self._half_edges
        order = np.argsort(edge_of, kind="stable")
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        shared = counts >= 2
        half_edge = np.column_stack([order[starts[shared]], order[starts[shared] + 1]])
        return half_edge % len(self.faces)

    @cached_property
    def boundary_edges(self) -> np.ndarray:
        """(borders, 2) int64 directed half-edges that only one face uses, in that face's direction."""
        _, edge_of, counts, half_edges = self._half_edges
        return half_edges[counts[edge_of] == 1]

    @cached_property
    def boundary_loops(self) -> tuple[np.ndarray, ...]:
        """Closed vertex loops along the border, longest first; the mesh lies to the left of each."""
        following: dict[int, list[int]] = {}
        for a, b in self.boundary_edges.tolist():
            following.setdefault(a, []).append(b)
        loops = []
        while following:
            start = next(iter(following))
            loop, vertex = [start], start
            while True:
                nexts = following.get(vertex)
                if not nexts:
                    break
                step = nexts.pop()
                if not nexts:
                    del following[vertex]
                if step == start:
                    break
                loop.append(step)
                vertex = step
            loops.append(np.asarray(loop, dtype=np.int64))
        return tuple(sorted(loops, key=len, reverse=True))

    @cached_property
    def piece_of_vertex(self) -> np.ndarray:
        """(vertices,) int32 label of the connected piece; an isolated vertex is a piece of its own."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        a, b = self.edges[:, 0], self.edges[:, 1]
        graph = coo_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(self.vertex_count, self.vertex_count))
        return connected_components(graph, directed=False)[1]

    @property
    def isolated_vertices(self) -> np.ndarray:
        """Indices of vertices that no face uses."""
        return np.flatnonzero(np.bincount(self.faces.reshape(-1), minlength=self.vertex_count) == 0)

    @property
    def non_manifold_edges(self) -> np.ndarray:
        """(n, 2) edges shared by three or more faces."""
        return self.edges[self.edge_face_counts > 2]

    @property
    def is_consistently_oriented(self) -> bool:
        """Whether no two faces run along a shared edge in the same direction."""
        half_edges = self._half_edges[3]
        return len(np.unique(half_edges, axis=0)) == len(half_edges)

    @property
    def is_closed(self) -> bool:
        """Whether every edge has exactly two faces."""
        return bool((self.edge_face_counts == 2).all())
