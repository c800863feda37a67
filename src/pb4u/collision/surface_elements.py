"""The vertices, edges and faces of a surface: which face answers for each, and the pairs around every vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pb4u.collision.box_tree import with_room
from pb4u.collision.jit import compiled
from pb4u.geometry.topology import Topology


class PairsAround(NamedTuple):
    """Pairs of a vertex and a face, or of two edges, by the vertex that their faces have in common.

    Args:
        corners: (pairs, 4) int32.
        starts: (vertices + 1,) int64 first pair of each vertex, and the total.
    """

    corners: np.ndarray
    starts: np.ndarray


class Elements(NamedTuple):
    """Faces, edges, and what each face answers for: every pair is met once, though faces share corners and sides.

    Args:
        faces: (faces, 3) int64.
        edges: (edges, 2) int64 of the faces.
        own_vertices: (faces, 3) int64 vertices that each face answers for, -1 where another face does.
        own_edges: (faces, 3) int64 edges, likewise.
    """

    faces: np.ndarray
    edges: np.ndarray
    own_vertices: np.ndarray
    own_edges: np.ndarray

    @staticmethod
    def of(faces: np.ndarray, edges: np.ndarray, vertex_count: int) -> Elements:
        """Those of a surface.

        Args:
            faces: (faces, 3) int64.
            edges: (edges, 2) int64 of the faces.
            vertex_count: number of its vertices.
        """
        _, first = np.unique(faces.reshape(-1), return_index=True)
        own = np.full(faces.size, -1, dtype=np.int64)
        own[first] = faces.reshape(-1)[first]
        sides = np.sort(np.stack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]], axis=1).reshape(-1, 2), axis=1)
        keys = sides[:, 0] * vertex_count + sides[:, 1]
        ordered = np.sort(edges, axis=1)
        edge_keys = ordered[:, 0] * vertex_count + ordered[:, 1]
        by_key = np.argsort(edge_keys)
        number = by_key[np.searchsorted(edge_keys[by_key], keys)] if len(keys) else keys
        _, first = np.unique(number, return_index=True)
        own_edges = np.full(len(keys), -1, dtype=np.int64)
        own_edges[first] = number[first]
        return Elements(faces, edges, own.reshape(-1, 3), own_edges.reshape(-1, 3))

    def pairs_around_vertices(self, face_count: int, vertex_count: int) -> tuple[PairsAround, PairsAround]:
        """Pairs of a vertex and a face, and of two edges, without a common vertex, whose faces have one; each once.

        Args:
            face_count: number of the first faces among which they are.
            vertex_count: number of vertices.
        """
        own = Elements(self.faces[:face_count], self.edges, self.own_vertices[:face_count], self.own_edges[:face_count])
        starts, ring = Topology(own.faces, vertex_count).vertex_faces
        near_faces, near_edges = _listed_around(own, ring, starts)
        vertex_faces = np.column_stack([near_faces[:, 0], own.faces[near_faces[:, 1]]])
        sides = np.column_stack([own.edges[near_edges[:, 0]], own.edges[near_edges[:, 1]]])
        around = (vertex_faces, near_faces[:, 2]), (sides, near_edges[:, 2])
        one, other = (_by_vertex(corners, common, vertex_count) for corners, common in around)
        return one, other


def _by_vertex(corners: np.ndarray, common: np.ndarray, vertex_count: int) -> PairsAround:
    """Pairs of the `corners` (pairs, 4) in the order of the vertex (pairs,) that their faces have in common."""
    starts = np.append(0, np.cumsum(np.bincount(common, minlength=vertex_count)))
    return PairsAround(corners[np.argsort(common, kind="stable")].astype(np.int32), starts)


@compiled
def _listed_around(elements: Elements, ring: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `pairs_around_vertices`, the elements by their numbers, and the common vertex (pairs, 3) int64.

    `ring` holds the faces around each vertex, from `starts` (vertices + 1,) of it on.
    """
    faces, edges, own_vertices, own_edges = elements
    near_faces, near_edges = np.empty((1024, 3), dtype=np.int64), np.empty((1024, 3), dtype=np.int64)
    face_count, edge_count = 0, 0
    met = np.full(len(faces), -1)
    for f in range(len(faces)):
        for corner in range(3):
            for place in range(starts[faces[f, corner]], starts[faces[f, corner] + 1]):
                g = ring[place]
                if g == f or met[g] == f:
                    continue
                met[g] = f
                for k in range(3):
                    v = own_vertices[f, k]
                    if v >= 0 and v != faces[g, 0] and v != faces[g, 1] and v != faces[g, 2]:
                        near_faces = with_room(near_faces, face_count)
                        near_faces[face_count, 0], near_faces[face_count, 1] = v, g
                        near_faces[face_count, 2] = faces[f, corner]
                        face_count += 1
                    p = own_edges[f, k]
                    if p < 0 or g < f:
                        continue
                    for m in range(3):
                        q = own_edges[g, m]
                        if q < 0 or edges[p, 0] == edges[q, 0] or edges[p, 0] == edges[q, 1]:
                            continue
                        if edges[p, 1] == edges[q, 0] or edges[p, 1] == edges[q, 1]:
                            continue
                        near_edges = with_room(near_edges, edge_count)
                        near_edges[edge_count, 0], near_edges[edge_count, 1] = p, q
                        near_edges[edge_count, 2] = faces[f, corner]
                        edge_count += 1
    return near_faces[:face_count].copy(), near_edges[:edge_count].copy()


@compiled
def any_corner(elements: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Whether any corner of each of the `elements` (elements, corners) is `among` (vertices,).

    Args:
        elements: (elements, corners) int64.
        among: (vertices,) bool.
    """
    found = np.zeros(len(elements), dtype=np.bool_)
    for element in range(len(elements)):
        for corner in range(elements.shape[1]):
            found[element] = found[element] or among[elements[element, corner]]
    return found


@compiled
def share_a_vertex(faces: np.ndarray, one: int, other: int) -> bool:
    """Whether two of the `faces` (faces, 3) have a vertex in common.

    Args:
        faces: (faces, 3) int64.
        one: row of them.
        other: row of them.
    """
    a, b, c = faces[one, 0], faces[one, 1], faces[one, 2]
    d, e, f = faces[other, 0], faces[other, 1], faces[other, 2]
    first, second, third = (
        (a == d) | (a == e) | (a == f),
        (b == d) | (b == e) | (b == f),
        (c == d) | (c == e) | (c == f),
    )
    return first | second | third
