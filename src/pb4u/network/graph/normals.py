"""Normals of garments and bodies as features: one pass over the faces on a processor."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import compiled
from pb4u.geometry.triangle_mesh import vertex_normals


def feature_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Area-weighted unit normals (vertices, 3) [1], as `vertex_normals`; 0 where no face is.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
    """
    if vertices.device.type != "cpu" or vertices.requires_grad:
        return vertex_normals(vertices, faces)
    normals = torch.zeros_like(vertices)
    _add_normals(vertices.numpy(), faces.numpy(), normals.numpy())
    return normals


@compiled
def _add_normals(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> None:
    for a, b, c in faces:
        px, py, pz = (vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2])
        qx, qy, qz = (vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2])
        x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        for corner in (a, b, c):
            normals[corner, 0] += x
            normals[corner, 1] += y
            normals[corner, 2] += z
    for normal in normals:
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        # What is not a number stays so.
        if length != 0.0:
            normal /= length
