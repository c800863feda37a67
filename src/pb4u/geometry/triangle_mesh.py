"""Measures of triangle meshes: normals, areas, edge lengths. Dtype and device follow the input."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Area-weighted unit vertex normals.

    Args:
        vertices: (..., vertices, 3) [m].
        faces: (faces, 3) int64.

    Returns:
        (..., vertices, 3) [1]; 0 where no face is.
    """
    a, b, c = (vertices.index_select(-2, faces[:, k]) for k in range(3))
    cross = torch.linalg.cross(b - a, c - a)
    total = torch.zeros_like(vertices)
    for k in range(3):
        total = total.index_add(-2, faces[:, k], cross)
    return total / total.norm(dim=-1, keepdim=True).clamp_min(torch.finfo(vertices.dtype).tiny)


def face_cross_products(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Outward normals as long as twice the area of each face, of a numpy mesh.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.

    Returns:
        (faces, 3) [m^2].
    """
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    return np.cross(b - a, c - a)


def area_weighted_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit vertex normals of a numpy mesh, weighted by area.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.

    Returns:
        (vertices, 3) [1]; 0 where no face is.
    """
    cross = np.repeat(face_cross_products(vertices, faces), 3, axis=0)
    columns = [np.bincount(faces.reshape(-1), cross[:, k], len(vertices)) for k in range(3)]
    normals = np.stack(columns, axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas of the faces of a numpy mesh.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.

    Returns:
        (faces,) [m^2].
    """
    return 0.5 * np.linalg.norm(face_cross_products(vertices, faces), axis=1)


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A third of the area of the faces around each vertex of a numpy mesh.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.

    Returns:
        (vertices,) [m^2].
    """
    return np.bincount(faces.ravel(), np.repeat(face_areas(vertices, faces) / 3.0, 3), len(vertices))


def edge_lengths(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Lengths of the edges of a numpy mesh.

    Args:
        vertices: (vertices, 3) [m].
        edges: (edges, 2) int64 pairs of vertices.

    Returns:
        (edges,) [m].
    """
    return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)


def laid_flat(corners: np.ndarray) -> np.ndarray:
    """Corners (faces, 3, 2) of triangles in their own planes: the first at the origin, the second on the x axis.

    Args:
        corners: (faces, 3, 3) in any unit; a triangle whose first two corners coincide gives values that are not
            finite.
    """
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    flat = np.zeros((len(corners), 3, 2))
    flat[:, 1, 0] = np.linalg.norm(e1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        flat[:, 2, 0] = np.einsum("ij,ij->i", e1, e2) / flat[:, 1, 0]
        flat[:, 2, 1] = np.linalg.norm(np.cross(e1, e2), axis=1) / flat[:, 1, 0]
    return flat


def carried_directions(directions: np.ndarray, corners: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Directions (faces, n) transferred from triangles to other shapes of the same triangles, in the unit of
    `directions`.

    Args:
        directions: (faces, m) one on each triangle; only the part in its plane is transferred.
        corners: (faces, 3, m) of the triangles [m], in the plane or in space.
        others: (faces, 3, n) of their other shapes [m].
    """
    shares = directions[:, None] @ np.linalg.pinv(corners[:, 1:] - corners[:, :1])
    return (shares @ (others[:, 1:] - others[:, :1]))[:, 0]


def shares_below(values: np.ndarray, level: float) -> np.ndarray:
    """Share (faces,) of each face's area on which a quantity that is linear on faces is below a level.

    Args:
        values: (faces, 3) of the quantity at the corners, in any unit.
        level: in the same unit.
    """
    low, middle, high = np.sort(values, axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        below = (level - low) ** 2 / ((middle - low) * (high - low))
        above = (high - level) ** 2 / ((high - low) * (high - middle))
    shares = np.where(middle >= level, below, 1.0 - above)
    return np.where(low >= level, 0.0, np.where(high <= level, 1.0, shares))


def both_below(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Whether (faces,) bool two quantities, linear on each face, are both below zero somewhere on the face.

    Args:
        one: (faces, 3) at the corners, in any unit.
        other: (faces, 3) of the other, in any unit.
    """
    # Two half-planes that meet within a triangle meet on one of its edges.
    first, last = np.zeros(one.shape), np.ones(one.shape)
    for values in (one, other):
        ends = np.roll(values, -1, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            zero = values / (values - ends)
        first = np.maximum(first, np.where(values < 0.0, 0.0, np.where(ends < 0.0, zero, 1.0)))
        last = np.minimum(last, np.where(ends < 0.0, 1.0, np.where(values < 0.0, zero, 0.0)))
    return np.asarray((last - first > 1e-6).any(axis=1))


def nearest_segments(points: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest segment to each point, among those with the nearest midpoints, for segments of about equal length.

    Args:
        points: (points, 3) [m].
        starts: (segments, 3) of the segments [m].
        ends: (segments, 3) likewise.

    Returns:
        Segment (points,) int64 and the distance (points,) to it [m].
    """
    count = min(8, len(starts))
    near = cKDTree(0.5 * (starts + ends)).query(points, k=count)[1].reshape(len(points), count)
    along, way = ends[near] - starts[near], points[:, None] - starts[near]
    at = np.clip((way * along).sum(axis=2) / np.maximum((along**2).sum(axis=2), 1e-30), 0.0, 1.0)
    distances = np.linalg.norm(way - at[..., None] * along, axis=2)
    best = distances.argmin(axis=1)[:, None]
    return np.take_along_axis(near, best, axis=1)[:, 0], np.take_along_axis(distances, best, axis=1)[:, 0]


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume [m^3] within a closed surface, positive where its faces look outwards; of an open surface relative to its
    middle.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
    """
    a, b, c = np.moveaxis(vertices[faces] - vertices[faces].mean(axis=(0, 1)), 1, 0)
    return float(np.einsum("fc,fc->", a, np.cross(b, c))) / 6.0
