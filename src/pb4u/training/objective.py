"""Objective of training: the incremental potential of the predicted step, summed over its terms."""

from __future__ import annotations

from torch import Tensor

from pb4u.nn.acceleration_model import PreparedGarments
from pb4u.physics.contact.collision import Collision
from pb4u.physics.incremental_potential import Energies, IncrementalPotential
from pb4u.physics.time_step import TimeStep

REFERENCE_WEIGHT = 5e3
"""Weight of the collision term at which losses of different times are compared [J/m^3]."""


def step_energies(step: TimeStep, positions: Tensor, collision_weight: float) -> Energies:
    """Energies of a step for each garment; differentiable.

    Args:
        step: time step that was taken.
        positions: (vertices, 3) [m] at its end.
        collision_weight: weight of the collision term [J/m^3].
    """
    return IncrementalPotential().with_term(Collision(weight=collision_weight)).of(step).energies(positions)


def mean_energies(energies: Energies) -> dict[str, Tensor]:
    """Mean of every term and of their `total` over the garments, scalars [J] by name."""
    terms = {name: value.mean() for name, value in energies.terms.items()}
    return {**terms, "total": energies.total / len(energies.per_garment)}


def further_losses(prepared: PreparedGarments, step: TimeStep, positions: Tensor, progress: float) -> dict[str, Tensor]:
    """Losses of the network's method besides the potential, each averaged over the garments: scalars [J] by name.

    Args:
        prepared: the garments.
        step: time step that was taken.
        positions: (vertices, 3) [m] at its end.
        progress: fraction of the training's budget spent.
    """
    before = step.state.positions
    return {loss.name: loss.energies(before, positions, progress).mean() for loss in prepared.losses}


def comparable_total(terms: dict[str, float], collision_weight: float) -> float:
    """Total loss [J] as it would be with collisions at the reference weight.

    Args:
        terms: mean energies [J] by name, with their "total".
        collision_weight: weight of the collision term in them [J/m^3].
    """
    return terms["total"] - terms["collision"] * (1.0 - REFERENCE_WEIGHT / collision_weight)


def strain_energy(terms: dict[str, float], collision_weight: float) -> float:
    """Loss [J] without gravity, which is never negative, with collisions at the reference weight.

    Args:
        terms: mean energies [J] by name, with their "total".
        collision_weight: weight of the collision term in them [J/m^3].
    """
    return comparable_total(terms, collision_weight) - terms["gravity"]
