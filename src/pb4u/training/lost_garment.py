"""When a garment in training is lost: what follows is worth neither learning from nor counting."""

from __future__ import annotations

from torch import Tensor

from pb4u.evaluation.metrics import DIVERGED_DISTANCE, DIVERGED_STRAIN
from pb4u.geometry.principal_stretch import face_strains, weighted_percentile
from pb4u.scene.packed import PackedGarments

SUNK = 2e-6
"""Collision term over its weight [m^5], a garment, above which it has sunk in: a quarter of a T-shirt 2 cm deep."""


def is_lost(strain: float, drift: float, collision: float) -> bool:
    """Whether garments diverged as evaluation counts it, or sank into the body.

    Args:
        strain: as `strain_percentile`. drift: as `drift_from` skinning [m].
        collision: collision term over its weight [m^5].
    """
    # So that what is not a number is lost.
    return not (strain <= DIVERGED_STRAIN and drift <= DIVERGED_DISTANCE and collision <= SUNK)


def drift_from(skinned: Tensor, garments: PackedGarments, positions: Tensor) -> float:
    """Distance [m] of the centre of mass of `positions` from that of `skinned`, both (vertices, 3) [m]."""
    share = garments.vertex_masses / garments.vertex_masses.sum()
    return float((share[:, None] * (positions - skinned)).sum(0).norm())


def strain_percentile(garments: PackedGarments, positions: Tensor) -> float:
    """Area-weighted 95th percentile of the strains of a pack."""
    strains = face_strains(positions, garments.faces, garments.inverse_rest_shape)
    return float(weighted_percentile(strains, garments.face_areas, 95.0))
