"""Cloth that lies double: solidified shells and linings."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

GAP = 8e-3
NEIGHBOURS = 12


def double_layered(vertices: np.ndarray, faces: np.ndarray, gap: float = GAP) -> np.ndarray:
    """(faces,) bool: another layer lies within `gap` [m] behind or before the face, looking the other way."""
    corners = vertices[faces]
    centres = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    size = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    near = cKDTree(centres).query(centres, k=min(NEIGHBOURS, len(centres)))[1].reshape(len(centres), -1)
    offset = centres[near] - centres[:, None]
    along = np.abs(np.einsum("fkd,fd->fk", offset, normals))
    across = np.linalg.norm(offset - np.einsum("fkd,fd->fk", offset, normals)[..., None] * normals[:, None], axis=2)
    opposed = np.einsum("fkd,fd->fk", normals[near], normals) < -0.8
    double: np.ndarray = (opposed & (along < gap) & (across < size[:, None])).any(axis=1)
    return double
