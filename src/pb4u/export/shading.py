"""How the two surfaces of a trajectory look in the formats that carry a material: colours and normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import torch

from pb4u.geometry.triangle_mesh import vertex_normals

if TYPE_CHECKING:
    from pb4u.scene.trajectory import TrajectoryHeader

Colour: TypeAlias = tuple[float, float, float]
"""Red, green and blue, sRGB [0 to 1]."""

CLOTH = (0.16, 0.36, 0.62)
SKIN = (0.93, 0.87, 0.83)
_FURTHER_CLOTHS = ((0.74, 0.31, 0.24), (0.87, 0.68, 0.33), (0.32, 0.53, 0.40), (0.47, 0.37, 0.58))
"""Colours of the second garment and those after it, in turn, so that layers can be distinguished."""


def garment_colours(garments: int, chosen: Sequence[Colour] = ()) -> np.ndarray:
    """Colours (garments, 3) float64 sRGB [0 to 1], one for each garment.

    Args:
        garments: how many there are.
        chosen: colours of the first ones; the others have their usual ones.
    """
    usual = [CLOTH, *(_FURTHER_CLOTHS[k % len(_FURTHER_CLOTHS)] for k in range(max(garments - 1, 0)))]
    return np.array([*chosen[:garments], *usual[len(chosen) : garments]], dtype=np.float64).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class ClothPart:
    """Faces of one garment that look the same.

    Args:
        name: of the part.
        faces: (n,) int64 indices of its faces.
        colour: sRGB [0 to 1]; multiplies the image.
        image: content of a PNG or JPEG file that the UVs lay on, or None.
    """

    name: str
    faces: np.ndarray
    colour: Colour
    image: bytes | None = None


def cloth_parts(header: TrajectoryHeader, chosen: Sequence[Colour] = ()) -> list[ClothPart]:
    """The garments of a trajectory, each in its colour or in those and the images that its author gave.

    Args:
        header: of the trajectory.
        chosen: colours of the first garments, which take the place of all that their authors gave.
    """
    owner, looks = np.asarray(header.vertex_garment)[header.faces[:, 0]], header.appearances
    count = int(owner.max(initial=0)) + 1
    of_face = np.full(len(owner), -1) if looks is None else np.where(owner < len(chosen), -1, looks.of_face)
    parts = []
    for k, usual in enumerate(garment_colours(count, chosen)):
        for look in np.unique(of_face[owner == k]).tolist():
            faces = np.flatnonzero((owner == k) & (of_face == look))
            if looks is None or look < 0:
                name = "garment" if count == 1 else f"garment {k + 1}"
                if 1 < count == len(header.garments):
                    name = str(header.garments[k]["name"])
                parts.append(ClothPart(name, faces, tuple(usual)))
            else:
                given = looks.listed[look]
                parts.append(ClothPart(given.name, faces, given.colour, given.image))
    return parts


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
