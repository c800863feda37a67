"""Which cloth lies over or under a place on the skin: what skin that shows is measured by, and covered again by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.geometry.nearest_surface import PosedSurface
from pb4u.geometry.triangle_mesh import face_cross_products

SKIN_OVER_CLOTH = 0.02
"""Height [m] of skin over cloth up to which it has come through: what lies higher wears other cloth, or none."""

_ALONG_NORMAL = 0.5
"""Least share of the way to the cloth that goes along the normal: 60 degrees, as steep as in the hollow of a back."""


@dataclass(frozen=True, eq=False)
class SkinCover:
    """The cloth nearest to places on the skin.

    Args:
        heights: (places,) [m] of the cloth over the skin, along its normal; negative beneath it.
        distances: (places,) [m] to the cloth.
        belongs: (places,) bool, whether the cloth lies along the normal and faces its way, not at its own border.
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
        """The cover of some places.

        Args:
            places: (places, 3) on the skin [m].
            normals: (places, 3) outward unit normals of it.
            cloth: all garments that may cover it.
        """
        near = cloth.nearest(places)
        face = near.triangle.numpy()
        offset = near.positions.numpy() - places
        height, distance = np.einsum("ij,ij->i", offset, normals), np.linalg.norm(offset, axis=1)
        faces = cloth.surface.faces[face]
        facing = face_cross_products(cloth.vertices.numpy(force=True), faces)
        belongs = np.einsum("ij,ij->i", facing, normals) > 0.0
        belongs &= ~near.beyond_border.numpy() & (np.abs(height) >= _ALONG_NORMAL * distance)
        return SkinCover(height, distance, belongs, face, near.barycentric.numpy())

    @property
    def shown(self) -> np.ndarray:
        """Places (places,) bool that show where cloth should cover them."""
        return self.belongs & (self.heights < 0.0) & (self.distances < SKIN_OVER_CLOTH)
