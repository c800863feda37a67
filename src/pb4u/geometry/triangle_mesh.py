"""Measures of triangle meshes: normals, areas, edge lengths. Dtype and device follow the input."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def face_normals_and_areas(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Unit normals (..., faces, 3) and areas (..., faces) [m^2] of `vertices` (..., vertices, 3) [m].

    A degenerate face has area 0 and normal 0.
    """
    a, b, c = (vertices.index_select(-2, faces[:, k]) for k in range(3))
    cross = torch.linalg.cross(b - a, c - a)
    double_area = cross.norm(dim=-1, keepdim=True)
    return cross / double_area.clamp_min(torch.finfo(vertices.dtype).tiny), 0.5 * double_area[..., 0]


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Area-weighted unit vertex normals (..., vertices, 3) of `vertices` (..., vertices, 3) [m]."""
    a, b, c = (vertices.index_select(-2, faces[:, k]) for k in range(3))
    cross = torch.linalg.cross(b - a, c - a)
    total = torch.zeros_like(vertices)
    for k in range(3):
        total = total.index_add(-2, faces[:, k], cross)
    return total / total.norm(dim=-1, keepdim=True).clamp_min(torch.finfo(vertices.dtype).tiny)


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(faces,) areas [m^2] of a numpy mesh (vertices, 3) [m]."""
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


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
