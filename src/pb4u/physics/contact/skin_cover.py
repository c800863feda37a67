"""Which cloth lies over or under a place on the skin: what skin that shows is measured by, and covered again by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.collision.jit import as_float64, compiled
from pb4u.collision.nearest_surface import PosedSurface

SKIN_OVER_CLOTH = 0.02
"""Height [m] of skin over cloth up to which it has come through: what lies higher wears other cloth, or none."""

_ALONG_NORMAL = 0.5
"""Least share of the way to the cloth that goes along the normal: 60 degrees, as steep as in the hollow of a back."""


@dataclass(frozen=True, eq=False)
class SkinCover:
    """The cloth nearest to points on the skin.

    Args:
        heights: (places,) [m] of the cloth over the skin, along its normal; negative beneath it.
        distances: (places,) [m] to the cloth.
        belongs: (places,) bool, whether the cloth lies along the normal and has a similar normal, not at a border of
            the cloth.
        faces: (places,) int64 of the cloth.
        barycentric: (places, 3) of the nearest point in that face.
    """

    heights: np.ndarray
    distances: np.ndarray
    belongs: np.ndarray
    faces: np.ndarray
    barycentric: np.ndarray

    @staticmethod
    def at(places: np.ndarray, normals: np.ndarray, cloth: PosedSurface) -> SkinCover:
        """The cover of given points of the skin.

        Args:
            places: (places, 3) on the skin [m].
            normals: (places, 3) outward unit normals of the skin.
            cloth: all garments that may cover it.
        """
        near = cloth.nearest(places)
        nearest = near.triangle.numpy(), near.positions.numpy(), near.beyond_border.numpy()
        heights, distances, belongs = described(
            nearest, places, normals, as_float64(cloth.vertices), cloth.surface.faces
        )
        return SkinCover(heights, distances, belongs, nearest[0], near.barycentric.numpy())

    @property
    def shown(self) -> np.ndarray:
        """Mask (places,) bool of points that show although cloth should cover them."""
        return self.belongs & (self.heights < 0.0) & (self.distances < SKIN_OVER_CLOTH)


@compiled
def described(
    found: tuple, places: np.ndarray, normals: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights, distances and whether the cloth belongs to the skin, as in `SkinCover`.

    Args:
        found: nearest face of the cloth, nearest point [m], and whether it is on the border.
        places: (places, 3) [m] on the skin.
        normals: (places, 3) unit normals of the skin.
        vertices: (vertices, 3) [m] of the cloth.
        faces: (faces, 3) int64 of the cloth.
    """
    triangle, nearest, beyond = found
    heights, distances = np.empty(len(places)), np.empty(len(places))
    belongs = np.empty(len(places), dtype=np.bool_)
    for row in range(len(places)):
        a, b, c = faces[triangle[row]]
        height, squared, facing = 0.0, 0.0, 0.0
        for axis in range(3):
            offset = nearest[row, axis] - places[row, axis]
            height += offset * normals[row, axis]
            squared += offset * offset
            i, j = (axis + 1) % 3, (axis + 2) % 3
            across = (vertices[b, i] - vertices[a, i]) * (vertices[c, j] - vertices[a, j])
            across -= (vertices[b, j] - vertices[a, j]) * (vertices[c, i] - vertices[a, i])
            facing += across * normals[row, axis]
        heights[row], distances[row] = height, np.sqrt(squared)
        belongs[row] = facing > 0.0 and not beyond[row] and abs(height) >= _ALONG_NORMAL * distances[row]
    return heights, distances, belongs
