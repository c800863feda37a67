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
        (..., vertices, 3); 0 where no face is.
    """
    a, b, c = (vertices.index_select(-2, faces[:, k]) for k in range(3))
    cross = torch.linalg.cross(b - a, c - a)
    total = torch.zeros_like(vertices)
    for k in range(3):
        total = total.index_add(-2, faces[:, k], cross)
    return total / total.norm(dim=-1, keepdim=True).clamp_min(torch.finfo(vertices.dtype).tiny)


def face_cross_products(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(faces, 3) outward normals as long as twice the area [m^2] of a numpy mesh (vertices, 3) [m]."""
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    return np.cross(b - a, c - a)


def area_weighted_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(vertices, 3) unit vertex normals of a numpy mesh (vertices, 3) [m], weighted by area; 0 where no face is."""
    cross = np.repeat(face_cross_products(vertices, faces), 3, axis=0)
    columns = [np.bincount(faces.reshape(-1), cross[:, k], len(vertices)) for k in range(3)]
    normals = np.stack(columns, axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(faces,) areas [m^2] of a numpy mesh (vertices, 3) [m]."""
    return 0.5 * np.linalg.norm(face_cross_products(vertices, faces), axis=1)


def edge_lengths(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(edges,) lengths [m] of (edges, 2) vertex pairs of a numpy mesh (vertices, 3) [m]."""
    return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)


def smallest_angles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(faces,) smallest interior angle [rad] of each triangle; 0 for a degenerate one."""
    corners = vertices[faces]
    angles = []
    for k in range(3):
        u = corners[:, (k + 1) % 3] - corners[:, k]
        v = corners[:, (k + 2) % 3] - corners[:, k]
        angles.append(np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v)))
    return np.min(angles, axis=0)
