"""Objective of training: the incremental potential of the predicted step, summed over its terms."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor

from pb4u.errors import unknown_name
from pb4u.nn.acceleration_model import PreparedGarments
from pb4u.physics.contact.collision import Collision
from pb4u.physics.incremental_potential import Energies, IncrementalPotential
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments
from pb4u.scene.scene import STANDARD_GRAVITY

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
    """Losses of the network's method besides the potential, (garments,) [J] each by name.

    Args:
        prepared: the garments.
        step: time step that was taken.
        positions: (vertices, 3) [m] at its end.
        progress: fraction of the training's budget spent.
    """
    before = step.state.positions
    return {loss.name: loss.energies(before, positions, progress) for loss in prepared.losses}


class LossWeight(ABC):
    """What the loss of each garment counts, beside those of other garments and other steps."""

    @abstractmethod
    def of(self, energies: Energies, garments: PackedGarments) -> Tensor:
        """Weights (garments,), without a gradient.

        Args:
            energies: of the step, for each garment.
            garments: the pack that they are of.
        """


class JouleWeight(LossWeight):
    """Every joule counts the same, as in the paper: what is heavy, stiff or lost decides."""

    def of(self, energies: Energies, garments: PackedGarments) -> Tensor:
        return torch.ones_like(energies.per_garment).detach()


class RelativeWeight(LossWeight):
    """A joule counts the less, the more of them the garment has now without gravity's, in 1/J.

    Descending this is descending the logarithm of that energy, so that its ratio to the solver's counts alike for silk
    and leather, and a garment that is lost no more than one that is worn.

    Args:
        lift: height [m] to which the energy added to all would lift the garment, so that cloth at rest weighs no more
            than cloth that hangs.
    """

    def __init__(self, lift: float = 1e-3) -> None:
        self.lift = lift

    def of(self, energies: Energies, garments: PackedGarments) -> Tensor:
        own = energies.per_garment.detach() - energies.terms["gravity"].detach()
        masses = torch.zeros_like(own).index_add_(0, garments.vertex_garment, garments.vertex_masses.to(own))
        return 1.0 / (own + self.lift * STANDARD_GRAVITY * masses)


LOSS_WEIGHTS: dict[str, LossWeight] = {"joule": JouleWeight(), "relative": RelativeWeight()}
"""By the name that a configuration gives them."""


def loss_weight(name: str) -> LossWeight:
    """The weight called `name`. Raises InputError listing the names."""
    if name not in LOSS_WEIGHTS:
        raise unknown_name("loss weight", name, LOSS_WEIGHTS)
    return LOSS_WEIGHTS[name]


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
