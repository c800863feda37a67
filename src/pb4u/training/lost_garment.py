"""When a garment in training is lost: what follows is worth neither learning from nor counting."""

from __future__ import annotations

from torch import Tensor

from pb4u.evaluation.metrics import DIVERGED_STRAIN
from pb4u.geometry.principal_stretch import face_strains, weighted_percentile
from pb4u.scene.packed import PackedGarments

SUNK = 2e-6
"""Collision term over its weight [m^5], a garment, above which it has sunk in: a quarter of a T-shirt 2 cm deep."""

FALLEN = 0.5
"""Mean distance [m] from where the body alone would carry the garment, above which it has come off."""


def is_lost(garments: PackedGarments, positions: Tensor, skinned: Tensor, collision: float) -> bool:
    """Whether garments came apart, came off or sank into the body.

    Args:
        garments: as packed. positions, skinned: (vertices, 3) [m]. collision: collision term over its weight [m^5].
    """
    strain, distance = strain_percentile(garments, positions), float((positions - skinned).norm(dim=1).mean())
    # So that what is not a number is lost.
    return not (strain <= DIVERGED_STRAIN and distance <= FALLEN and collision <= SUNK)


def strain_percentile(garments: PackedGarments, positions: Tensor) -> float:
    """Area-weighted 95th percentile of the strains of a pack."""
    strains = face_strains(positions, garments.faces, garments.inverse_rest_shape)
    return float(weighted_percentile(strains, garments.face_areas, 95.0))
