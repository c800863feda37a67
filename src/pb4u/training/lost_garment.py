"""When a garment in training is lost: it came apart, came off, or sank into the body and stays there."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.measures.divergence import DIVERGED_DISTANCE, DIVERGED_STRAIN
from pb4u.scene.packed import PackedGarments

SUNK = 2e-6
"""Collision term over its weight [m^5], a garment, above which it has sunk in: a quarter of a T-shirt 2 cm deep."""

MOST_SUNK = 5
"""Steps on end after which what has sunk in does not come out again: garments that start in a body are out of it after
one to three, those that a hip catches at a run after one or two."""


class GarmentWatch:
    """Sees step by step whether garments are lost.

    Attributes:
        sunk: () number of successive steps after which they were inside the body.
        lost: () bool whether they are lost.
        seen_lost: whether the processor has read this.
    """

    def __init__(self) -> None:
        self.sunk: Tensor | int = 0
        self.lost: Tensor | None = None
        self.seen_lost = False

    def is_lost(self, strain: Tensor, drift: Tensor, collision: Tensor) -> Tensor:
        """Whether () bool they ever diverged in a step as evaluation counts it, or had sunk in for `MOST_SUNK` steps.

        Args:
            strain: () as `strain_percentile`, after the step.
            drift: () as `drift_from` skinning [m].
            collision: () collision term over its weight [m^5].
        """
        # So that what is not a number has sunk, or is lost.
        self.sunk = torch.where(collision.double() <= SUNK, 0, self.sunk + 1)
        fine = (strain.double() <= DIVERGED_STRAIN) & (drift.double() <= DIVERGED_DISTANCE) & (self.sunk < MOST_SUNK)
        self.lost = ~fine if self.lost is None else self.lost | ~fine
        return self.lost


def drift_from(skinned: Tensor, garments: PackedGarments, positions: Tensor) -> Tensor:
    """Distance () [m] of the centre of mass of packed garments from where skinning alone would put it.

    Args:
        skinned: (vertices, 3) skinned positions [m].
        garments: the pack, whose vertex masses weigh the mean.
        positions: (vertices, 3) simulated positions [m].
    """
    share = garments.vertex_masses / garments.vertex_masses.sum()
    return (share[:, None] * (positions - skinned)).sum(0).norm()
