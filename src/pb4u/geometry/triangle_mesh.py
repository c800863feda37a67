"""Measures of triangle meshes: normals, areas, edge lengths. Dtype and device follow the input."""

from __future__ import annotations

import numpy as np
import torch
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
