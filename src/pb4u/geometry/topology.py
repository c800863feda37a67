"""Connectivity of a triangle mesh: edges, hinges, boundary loops, pieces, orientation. Indices only, no positions."""

from __future__ import annotations

from collections.abc import Sequence, Sized
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


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
    def _half_edges(self) -> np.ndarray:
        """(3 faces, 2) int64 directed edges of all faces: corners 01 of every face, then 12, then 20."""
        faces = self.faces.astype(np.int64, copy=False)
        return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])

    @cached_property
    def _half_edges_by_edge(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Half-edges in the order of their edges, where each edge begins in that order, and its key."""
        a, b = self._half_edges.T
        keys = np.minimum(a, b) * self.vertex_count + np.maximum(a, b)
        order = np.argsort(keys, kind="stable")
        ordered = keys[order]
        starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])[: len(ordered)])
        return order, starts, ordered[starts]

    @property
    def edge_keys(self) -> np.ndarray:
        """Keys (edges,) int64 of the edges, increasing: lower index x vertex count + higher index."""
        return self._half_edges_by_edge[2]

    @cached_property
    def edges(self) -> np.ndarray:
        """Vertices (edges, 2) int64 of the undirected edges, each once, lower index first, in lexicographic order."""
        return np.column_stack(np.divmod(self.edge_keys, max(self.vertex_count, 1)))

    @cached_property
    def face_edges(self) -> np.ndarray:
        """Indices (faces, 3) int64 of the edges at corners 01, 12 and 20 of each face."""
        edge_of = np.empty(3 * len(self.faces), dtype=np.int64)
        edge_of[self._half_edges_by_edge[0]] = np.repeat(np.arange(len(self.edge_keys)), self.edge_face_counts)
        return edge_of.reshape(3, -1).T

    @cached_property
    def edge_face_counts(self) -> np.ndarray:
        """Number (edges,) int64 of faces that meet at each edge: 1 on a border, 2 inside, more where not manifold."""
        order, starts, _ = self._half_edges_by_edge
        return np.diff(np.append(starts, len(order)))

    def faces_at(self, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row of `edges` and face, (pairs,) int64 each, of every face at each edge, row by row.

        Args:
            edges: (rows,) int64 numbers of edges.
        """
        order, starts, _ = self._half_edges_by_edge
        counts = self.edge_face_counts[edges]
        row = np.repeat(np.arange(len(edges)), counts)
        return row, order[ranges(starts[edges], counts)] % max(len(self.faces), 1)

    @cached_property
    def _edge_half_edges(self) -> np.ndarray:
        """(edges, 2) int64 the first two half-edges of each edge, the second one -1 on a border."""
        order, starts, _ = self._half_edges_by_edge
        second = order[np.minimum(starts + 1, max(len(order) - 1, 0))]
        return np.column_stack([order[starts], np.where(self.edge_face_counts > 1, second, -1)])

    @cached_property
    def edge_faces(self) -> np.ndarray:
        """Indices (edges, 2) int64 of the first two faces at each edge, the second one -1 on a border."""
        half_edges = self._edge_half_edges
        return np.where(half_edges >= 0, half_edges % max(len(self.faces), 1), -1)

    @cached_property
    def edge_opposites(self) -> np.ndarray:
        """Third vertices (edges, 2) int64 of the faces in `edge_faces`, the second one -1 on a border."""
        thirds = self.faces[:, [2, 0, 1]].T.reshape(-1)
        return np.where(self._edge_half_edges >= 0, thirds[self._edge_half_edges], -1)

    @cached_property
    def hinges(self) -> np.ndarray:
        """Vertices (hinges, 4) int64 of the two faces at each inner edge: the edge v0, v1, then their third vertices.

        The first face runs v0->v1. Border edges have no hinge; an edge with more than two faces keeps its first two.
        """
        inner = self.edge_face_counts >= 2
        return np.column_stack([self._half_edges[self._edge_half_edges[inner, 0]], self.edge_opposites[inner]])

    @cached_property
    def hinge_faces(self) -> np.ndarray:
        """Indices (hinges, 2) int64 of the two faces of each row of `hinges`."""
        return self.edge_faces[self.edge_face_counts >= 2]

    @cached_property
    def border_vertices(self) -> np.ndarray:
        """Mask (vertices,) bool of the vertices at an edge that only one face uses."""
        on_border = np.zeros(self.vertex_count, dtype=bool)
        on_border[self.edges[self.edge_face_counts == 1]] = True
        return on_border

    @cached_property
    def vertex_faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Offsets (vertices + 1,) of the faces around each vertex, and these faces, all int64."""
        corners = self.faces.reshape(-1)
        by_vertex = np.argsort(corners, kind="stable")
        return np.searchsorted(corners[by_vertex], np.arange(self.vertex_count + 1)), by_vertex // 3

    @cached_property
    def boundary_edges(self) -> np.ndarray:
        """Directed half-edges (borders, 2) int64 that only one face uses, in that face's direction."""
        return self._half_edges[self.edge_face_counts[self.face_edges.T.reshape(-1)] == 1]

    @cached_property
    def boundary_loops(self) -> tuple[np.ndarray, ...]:
        """Closed loops of vertices along the border, (n,) int64 each, longest first; the mesh lies to their left."""
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
        """Label (vertices,) int32 of each vertex's connected piece; an isolated vertex is a piece of its own."""
        return connected_labels(self.vertex_count, *self.edges.T)

    @property
    def isolated_vertices(self) -> np.ndarray:
        """Indices (n,) int64 of vertices that no face uses."""
        return np.flatnonzero(np.bincount(self.faces.reshape(-1), minlength=self.vertex_count) == 0)

    @property
    def non_manifold_edges(self) -> np.ndarray:
        """Edges (n, 2) int64 shared by three or more faces."""
        return self.edges[self.edge_face_counts > 2]

    @property
    def is_consistently_oriented(self) -> bool:
        """Whether no two faces run along a shared edge in the same direction."""
        keys = self._half_edges @ np.array([self.vertex_count, 1])
        return len(np.unique(keys)) == len(keys)

    @property
    def is_closed(self) -> bool:
        """Whether every edge has exactly two faces."""
        return bool((self.edge_face_counts == 2).all())


def offsets(parts: Sequence[Sized]) -> list[int]:
    """Index of the first row of each part when the parts are concatenated, and the total.

    Args:
        parts: parts with a length.
    """
    return [0, *np.cumsum([len(part) for part in parts]).tolist()]


def joined_indices(parts: Sequence[np.ndarray], starts: Sequence[int]) -> np.ndarray:
    """Concatenated index arrays (sum of rows, ...), `starts[k]` added to the indices of part k.

    Args:
        parts: (rows, ...) int64 indices of each part.
        starts: numbers to add; may be longer than `parts`.
    """
    return np.concatenate([part + start for part, start in zip(parts, starts, strict=False)])


def ranges(starts: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Numbers (sum of counts,) int64 of the ranges that begin at each start, concatenated.

    Args:
        starts: (ranges,) int64 first number of each.
        counts: (ranges,) int64 how many numbers each has.
    """
    return np.arange(int(counts.sum())) + np.repeat(starts - (np.cumsum(counts) - counts), counts)


def connected_labels(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Labels of the connected components of an undirected graph.

    Args:
        count: number of nodes.
        a: (links,) int64 one end of each link.
        b: (links,) int64 the other end.

    Returns:
        (count,) int32 from 0; a node without links is a component of its own.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def faces_to_flip(topology: Topology) -> tuple[np.ndarray, bool]:
    """Faces to turn over so that neighbours agree, and whether that is possible.

    In each piece the fewer faces are turned. Not possible means a one-sided surface (a Moebius strip): its faces are
    then left alone.

    Args:
        topology: the mesh; each edge shared by two faces at most.

    Returns:
        flip: (faces,) bool.
        orientable: whether every piece has two sides.
    """
    faces, pairs = topology.faces, topology.hinge_faces
    count = len(faces)
    start, end = topology.hinges[:, 0], topology.hinges[:, 1]
    second = faces[pairs[:, 1]]
    agree = ~((second == start[:, None]) & (np.roll(second, -1, axis=1) == end[:, None])).any(axis=1)
    # Two copies of every face, as it is and turned over; an edge joins the copies that agree across it.
    a, b = pairs.T
    rows = np.concatenate([a, a + count])
    columns = np.concatenate([np.where(agree, b, b + count), np.where(agree, b + count, b)])
    labels = connected_labels(2 * count, rows, columns)
    as_is, turned = labels[:count], labels[count:]
    orientable = as_is != turned
    size = np.bincount(as_is, minlength=labels.max(initial=0) + 1)
    # The side with more faces as they are wins; on a tie the copy with the lower label does, on both its faces.
    more = (size[turned] > size[as_is]) | ((size[turned] == size[as_is]) & (turned < as_is))
    return more & orientable, bool(orientable.all())


def neighbour_mean(topology: Topology) -> csr_matrix:
    """Matrix (vertices, vertices) of the mean over a vertex's neighbours; the vertex itself if it has none.

    Args:
        topology: the mesh.
    """
    from scipy.sparse import csr_matrix, diags

    count = topology.vertex_count
    rows, columns = np.concatenate([topology.edges, topology.edges[:, ::-1]]).T
    adjacency = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    degree = np.asarray(adjacency.sum(axis=1)).reshape(-1)
    return diags(1.0 / np.maximum(degree, 1.0)) @ adjacency + diags((degree == 0).astype(np.float64))


def uv_islands(uv_faces: np.ndarray) -> np.ndarray:
    """Island (faces,) int64 of each face (faces, 3) of UV points, numbered in the order of their first points.

    Args:
        uv_faces: (faces, 3) int64.
    """
    points, corners = np.unique(uv_faces, return_inverse=True)
    corners = corners.reshape(-1, 3)
    island = connected_labels(len(points), *np.concatenate([corners[:, :2], corners[:, 1:]]).T)
    first = np.unique(island, return_index=True)[1]
    return np.asarray(np.argsort(np.argsort(first))[island][corners[:, 0]], dtype=np.int64)
