"""When a garment in training is lost: what follows is worth neither learning from nor counting."""

from __future__ import annotations

from torch import Tensor

from pb4u.evaluation.metrics import DIVERGED_DISTANCE, DIVERGED_STRAIN
from pb4u.geometry.principal_stretch import face_strains, weighted_percentile
from pb4u.scene.packed import PackedGarments

SUNK = 2e-6
"""Collision term over its weight [m^5], a garment, above which it has sunk in: a quarter of a T-shirt 2 cm deep."""


def is_lost(garments: PackedGarments, positions: Tensor, skinned: Tensor, collision: float) -> bool:
    """Whether garments diverged as evaluation counts it, or sank into the body.

    Args:
        garments: as packed. positions, skinned: (vertices, 3) [m]. collision: collision term over its weight [m^5].
    """
    strain = strain_percentile(garments, positions)
    share = garments.vertex_masses / garments.vertex_masses.sum()
    distance = float((share[:, None] * (positions - skinned)).sum(0).norm())
    # So that what is not a number is lost.
    return not (strain <= DIVERGED_STRAIN and distance <= DIVERGED_DISTANCE and collision <= SUNK)


def strain_percentile(garments: PackedGarments, positions: Tensor) -> float:
    """Area-weighted 95th percentile of the strains of a pack."""
    strains = face_strains(positions, garments.faces, garments.inverse_rest_shape)
    return float(weighted_percentile(strains, garments.face_areas, 95.0))
