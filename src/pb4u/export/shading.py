"""How the two surfaces of a trajectory look in the formats that carry a material: colours and normals."""

from __future__ import annotations

import numpy as np
import torch

from pb4u.geometry.triangle_mesh import vertex_normals

CLOTH = (0.16, 0.36, 0.62)
SKIN = (0.93, 0.87, 0.83)


def unit_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit vertex normals; up where a vertex has no area around it.

    Args:
        positions: (..., vertices, 3) [m].
        faces: (faces, 3) int.

    Returns:
        (..., vertices, 3) float32 [1].
    """
    normals = vertex_normals(
        torch.from_numpy(np.array(positions, dtype=np.float64)), torch.from_numpy(np.array(faces, dtype=np.int64))
    ).numpy()
    flat = np.abs(np.linalg.norm(normals, axis=-1) - 1) > 1e-3
    normals[flat] = (0.0, 1.0, 0.0)
    return normals.astype(np.float32)
