"""How the two surfaces of a trajectory look in the formats that carry a material: colours and normals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import torch

from pb4u.geometry.triangle_mesh import vertex_normals

Colour: TypeAlias = tuple[float, float, float]
"""Red, green and blue, sRGB [0 to 1]."""

CLOTH = (0.16, 0.36, 0.62)
SKIN = (0.93, 0.87, 0.83)
_FURTHER_CLOTHS = ((0.74, 0.31, 0.24), (0.87, 0.68, 0.33), (0.32, 0.53, 0.40), (0.47, 0.37, 0.58))
"""Colours of the second garment and those after it, in turn, so that layers can be told apart."""


def garment_colours(garments: int, chosen: Sequence[Colour] = ()) -> np.ndarray:
    """Colours (garments, 3) float64 sRGB [0 to 1], one for each garment.

    Args:
        garments: how many there are.
        chosen: colours of the first ones; the others have their usual ones.
    """
    usual = [CLOTH, *(_FURTHER_CLOTHS[k % len(_FURTHER_CLOTHS)] for k in range(max(garments - 1, 0)))]
    return np.array([*chosen[:garments], *usual[len(chosen) : garments]], dtype=np.float64).reshape(-1, 3)


def face_colours(faces: np.ndarray, vertex_garment: np.ndarray, chosen: Sequence[Colour] = ()) -> np.ndarray:
    """Colours (faces, 3) float64 sRGB [0 to 1] of garments, one colour each.

    Args:
        faces: (faces, 3) int.
        vertex_garment: (vertices,) int garment of each vertex.
        chosen: colours of the first garments; the others have their usual ones.
    """
    garment = vertex_garment[faces[:, 0]]
    colours: np.ndarray = garment_colours(int(vertex_garment.max(initial=0)) + 1, chosen)[garment]
    return colours


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
