"""Triangles that pass through one another, by exact predicates: what is counted, and promised, of contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.geometry.topology import Topology


def self_crossings(vertices: np.ndarray, faces: np.ndarray, *, sharing: bool = False) -> np.ndarray:
    """Pairs (pairs, 2) int64 of faces of one surface that cross.

    Args:
        vertices: (vertices, 3) [m], finite.
        faces: (faces, 3) int64.
        sharing: whether pairs that share a vertex, and pass through each other elsewhere, are counted as well.
    """
    from igl.predicates import find_self_intersections

    _, pairs, _ = find_self_intersections(_floats(vertices), _integers(faces))
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    if sharing:
        return pairs
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

    # Most of a body is far from a garment, and the search tree of both is retried for every frame.
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


def segments_through_faces(
    starts: np.ndarray, ends: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Segments that pass through faces.

    Args:
        starts: (segments, 3) [m].
        ends: (segments, 3) [m].
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.

    Returns:
        Pairs (pairs, 2) int64 of a segment and a face, and where they meet (pairs, 3) [m].
    """
    corners = vertices[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    meet = np.ones((len(starts), len(faces)), dtype=bool)
    for axis in range(3):
        first, last = np.minimum(starts[:, axis], ends[:, axis]), np.maximum(starts[:, axis], ends[:, axis])
        meet &= (low[:, axis] <= last[:, None]) & (high[:, axis] >= first[:, None])
    segment, face = np.nonzero(meet)
    start, way = starts[segment], (ends - starts)[segment]
    a, b, c = corners[face].transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    along = np.einsum("ij,ij->i", way, cross)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.einsum("ij,ij->i", a - start, cross) / along
    place = start + share[:, None] * way
    # On the inner side of all three sides of the face.
    inside = np.stack(
        [np.einsum("ij,ij->i", np.cross(q - p, place - p), cross) >= 0.0 for p, q in ((a, b), (b, c), (c, a))]
    ).all(axis=0)
    through = (along != 0.0) & (share >= 0.0) & (share <= 1.0) & inside
    return np.column_stack([segment[through], face[through]]), place[through]


@dataclass(frozen=True, eq=False)
class Piercings:
    """Edges of a surface that pass through faces of it which they share no vertex with.

    Args:
        edges: (piercings,) int64 into the edges of the topology.
        faces: (piercings,) int64.
        shares: (piercings,) part of the edge before the face, 0 to 1.
        barycentric: (piercings, 3) place in the face.
        normals: (piercings, 3) unit normals of the faces.
    """

    edges: np.ndarray
    faces: np.ndarray
    shares: np.ndarray
    barycentric: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.edges)


def piercings(vertices: np.ndarray, topology: Topology, pairs: np.ndarray) -> Piercings:
    """The edges that pass through faces, of pairs of faces known to cross; by edge, then by face.

    Of two faces that share a vertex, the edge across from it passes through the other: these are found as well.

    Args:
        vertices: (vertices, 3) float64 [m].
        topology: connectivity of the surface.
        pairs: (pairs, 2) int64 faces, as `self_crossings` gives them.
    """
    count, faces = max(len(topology.faces), 1), topology.faces
    owners, others = np.concatenate([pairs, pairs[:, ::-1]]).T
    # An edge belongs to two faces, and both may cross a third: each edge through each face once.
    keys = np.unique(topology.face_edges[owners].reshape(-1) * count + np.repeat(others, 3))
    edge, face = np.divmod(keys, count)
    apart = (topology.edges[edge][:, :, None] != faces[face][:, None, :]).all(axis=(1, 2))
    edge, face = edge[apart], face[apart]
    starts, ends = vertices[topology.edges[edge]].transpose(1, 0, 2)
    a, b, c = vertices[faces[face]].transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    before, after = np.einsum("ij,ij->i", starts - a, cross), np.einsum("ij,ij->i", ends - a, cross)
    kept = before * after < 0.0
    edge, face, starts, ends, a, b, c, cross = (x[kept] for x in (edge, face, starts, ends, a, b, c, cross))
    share = before[kept] / (before[kept] - after[kept])
    offset = starts + share[:, None] * (ends - starts) - a
    double = np.einsum("ij,ij->i", cross, cross)
    second = np.einsum("ij,ij->i", np.cross(offset, c - a), cross) / double
    third = np.einsum("ij,ij->i", np.cross(b - a, offset), cross) / double
    barycentric = np.column_stack([1.0 - second - third, second, third])
    inside = (barycentric >= 0.0).all(axis=1)
    return Piercings(
        edge[inside], face[inside], share[inside], barycentric[inside], (cross / np.sqrt(double)[:, None])[inside]
    )


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float64)


def _integers(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.int64)
