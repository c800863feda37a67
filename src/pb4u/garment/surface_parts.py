"""Parts of an author's mesh that lie on each other: layers of a shell, what is sewn on, pieces beside each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pb4u.garment.source_surface import SourceSurface
from pb4u.geometry.topology import Topology, connected_labels
from pb4u.geometry.triangle_mesh import face_areas, face_cross_products

# Cosine of the angle between two faces from which on the surface goes on smoothly: the rim of a shell stands across.
_SMOOTH = 0.3
# Share of a part's area that has to lie against another for the two to be layers of one cloth.
_LAYERED = 0.5
# Share of the faces that what is sewn on has at most, and edges at which it hangs at least.
_SEWN_ON, _LEAST_EDGES = 0.25, 2
# Distance [m] up to which borders of two pieces lie along each other, vertices that do at least, and most pieces that
# are compared.
_ALONG, _LEAST_ALONG, _MOST_PIECES = 0.02, 3, 64


def inner_layer(surface: SourceSurface, heights: np.ndarray | None = None) -> np.ndarray:
    """Mask (faces,) bool of the kept triangles to remove so that only the outer layer of double cloth remains.

    They are the inner layer and the rim between the two. The outer one is farther from the body or, without a body, the
    larger.

    Args:
        surface: the mesh.
        heights: (vertices,) signed distances to the body [m].
    """
    faces, vertices = surface.faces, surface.source.vertices
    area: np.ndarray = face_areas(vertices, faces)
    part = _smooth_parts(surface)
    count = int(part.max(initial=-1)) + 1
    areas: np.ndarray = np.bincount(part, area, count)
    outerness = areas
    if heights is not None:
        outerness = np.bincount(part, area * heights[faces].mean(axis=1), count) / np.maximum(areas, 1e-30)
    double = surface.opposite >= 0
    against = np.zeros((count, count))
    np.add.at(against, (part[double], part[surface.opposite[double]]), area[double])
    facing, inner = against.argmax(axis=1), np.zeros(count, dtype=bool)
    for k in range(count):
        other = int(facing[k])
        if other != k and against[k, other] > _LAYERED * areas[k]:
            inner[k] = outerness[k] < outerness[other]
    gone = inner[part]
    if not gone.any():
        return gone
    is_gone = np.zeros(len(vertices), dtype=bool)
    is_gone[faces[gone]] = True
    # The rim: what hangs on vertices of the inner layer, and no part that is layered itself.
    layered = against.sum(axis=1) > _LAYERED * areas
    return gone | (is_gone[faces].any(axis=1) & ~layered[part])


def _smooth_parts(surface: SourceSurface) -> np.ndarray:
    """Number (faces,) of the part of each kept triangle; parts end at borders, sharp edges and where three meet."""
    normals = face_cross_products(surface.source.vertices, surface.faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    topology = surface.topology
    pairs = topology.edge_faces[topology.edge_face_counts == 2]
    smooth = np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) > _SMOOTH
    labels = connected_labels(len(surface.faces), *pairs[smooth].T)
    return np.unique(labels, return_inverse=True)[1]


def sewn_on(surface: SourceSurface) -> np.ndarray:
    """Mask (faces,) bool of the kept triangles of small parts attached at edges of two other faces, such as pockets.

    Empty if the rest would still have such edges.

    Args:
        surface: the mesh.
    """
    topology, count = surface.topology, len(surface.faces)
    none = np.zeros(count, dtype=bool)
    edges = np.flatnonzero(topology.edge_face_counts > 2)
    if len(edges) < _LEAST_EDGES:
        return none
    part = connected_labels(count, *topology.edge_faces[topology.edge_face_counts == 2].T)
    size = np.bincount(part, minlength=count)
    row, face = topology.faces_at(edges)
    order = np.lexsort((-size[part[face]], row))
    place = np.arange(len(row)) - np.searchsorted(row[order], row[order])
    small = np.unique(part[face[order][place >= 2]])
    on: np.ndarray = np.isin(part, small)
    rest = Topology(surface.faces[~on], len(surface.source.vertices))
    if on.sum() > _SEWN_ON * count or len(rest.non_manifold_edges):
        return none
    return on


class Gap(NamedTuple):
    """How near the pieces of a garment come to each other.

    Args:
        nearest: distance [m] of the nearest vertices of two pieces' borders.
        along: mean distance [m] of borders that run side by side; 0 without any.
        pairs: pairs of vertices at which they do.
    """

    nearest: float
    along: float
    pairs: int


def gap_between(surface: SourceSurface) -> Gap | None:
    """Distance between the borders of the pieces after welding open seams; None for one piece or many.

    Args:
        surface: the mesh.
    """
    target, vertices = surface.weld_target, surface.source.vertices
    topology = Topology(target[surface.faces], len(target))
    border = np.flatnonzero(topology.border_vertices)
    piece = topology.piece_of_vertex[border]
    numbers = np.unique(piece)
    if not 2 <= len(numbers) <= _MOST_PIECES:
        return None
    nearest = np.full(len(vertices), -1)
    distance = np.full(len(vertices), np.inf)
    for number in numbers:
        piece_border, others = border[piece == number], border[piece != number]
        distance[piece_border], at = cKDTree(vertices[others]).query(vertices[piece_border])
        nearest[piece_border] = others[at]
    mutual = border[(nearest[nearest[border]] == border) & (distance[border] <= _ALONG)]
    if len(mutual) < 2 * _LEAST_ALONG:
        return Gap(float(distance.min()), 0.0, 0)
    return Gap(float(distance.min()), float(distance[mutual].mean()), len(mutual) // 2)
