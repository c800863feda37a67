"""Objective of training: the incremental potential of the predicted step, summed over its terms."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from pb4u.environment import STANDARD_GRAVITY
from pb4u.errors import InputError
from pb4u.network.acceleration_model import PreparedGarments
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.step_potential import Energies
from pb4u.physics.terms.collision import Collision
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments

REFERENCE_WEIGHT = 5e3
"""Weight of the collision term at which losses of different times are compared [J/m^3]."""

_LIFT = 1e-4
"""Height [m]; the energy that lifts a garment by it is added to the decrease of each pass, so that smaller ones do not
matter."""


@dataclass(frozen=True)
class Inside(Collision):
    """A second collision term that begins at the skin, used only in the loss.

    Resting cloth lies above the skin, where collisions need the weight that they have in a simulation: a network
    trained with a larger weight leaves cloth hovering, with too little pressure for friction to hold it. Inside the
    skin that weight is too small: the network would learn to let cloth sink in.
    """

    clearance: float = 0.0
    name = "inside"


LOSS_POTENTIAL = IncrementalPotential()
"""The six energies of the paper, which training descends: its loss, the start, the feature and the search of its
steps."""

LOSS_TERMS = (*LOSS_POTENTIAL.names, Inside.name)
"""Names of the terms that a loss may have."""


def step_energies(step: TimeStep, positions: Tensor, collision_weight: float, inside_weight: float = 0.0) -> Energies:
    """Energies of a step for each garment; differentiable.

    Args:
        step: the time step.
        positions: (vertices, 3) [m] at its end.
        collision_weight: weight of the collision term [J/m^3].
        inside_weight: weight of the term for vertices inside the skin [J/m^3]; 0 for none.
    """
    potential = LOSS_POTENTIAL.with_term(Collision(weight=collision_weight))
    if inside_weight:
        potential = potential.with_term(Inside(weight=inside_weight))
    return potential.of(step).energies(positions)


def mean_energies(energies: Energies) -> dict[str, Tensor]:
    """Mean of every term and of their `total` over the garments, scalars [J] by name.

    Args:
        energies: of each garment.
    """
    terms = {name: value.mean() for name, value in energies.terms.items()}
    return {**terms, "total": energies.total / len(energies.per_garment)}


def further_losses(prepared: PreparedGarments, step: TimeStep, positions: Tensor, progress: float) -> dict[str, Tensor]:
    """Losses of the network's method besides the potential, (garments,) [J] each by name.

    Args:
        prepared: the garments.
        step: the time step.
        positions: (vertices, 3) [m] at its end.
        progress: fraction of the training's budget spent.
    """
    before = step.state.positions
    return {loss.name: loss.energies(before, positions, progress) for loss in prepared.losses}


def progress_weights(garments: PackedGarments, decrease: Tensor | None) -> Tensor:
    """Weights (garments,) [1/J] of losses: a joule counts less, the larger the energy decrease of the pass.

    Where a pass lowers the energy by much more than what lifts the garment by `_LIFT`, descending this loss raises the
    logarithm of that decrease, of the terms that its search knows: it asks for the best direction alike far from the
    minimum and near it, in silk and in leather. It differs from a logarithm elsewhere: a pass that raises the energy
    gets the same, largest weight as one that does not change it. Only passes that are joined (`conjugate_move`) know
    their decrease.

    Args:
        garments: the pack that the losses are of.
        decrease: (worlds,) energy decrease [J] of the pass, where its search measures it.

    Raises:
        InputError: the search of the passes does not measure their energy decrease.
    """
    if decrease is None:
        raise InputError("loss_weight=progress needs a network whose passes are conjugate: network.conjugate=True.")
    of_world = decrease[garments.garment_world].clamp_min(0.0)
    return 1.0 / (of_world + (_LIFT * STANDARD_GRAVITY * garments.garment_masses).to(of_world))


JOULE, PROGRESS = LOSS_WEIGHTS = ("joule", "progress")
"""What a joule of a garment counts: always the same, as in the paper, or by `progress_weights`."""


def comparable_total(terms: dict[str, float], collision_weight: float) -> float:
    """Total loss [J] as it would be with collisions at the reference weight and without the term `Inside`.

    Args:
        terms: mean energies [J] by name, with their "total".
        collision_weight: weight of the collision term in them [J/m^3].
    """
    heavier = terms["collision"] * (1.0 - REFERENCE_WEIGHT / collision_weight)
    return terms["total"] - heavier - terms.get(Inside.name, 0.0)


def strain_energy(terms: dict[str, float], collision_weight: float) -> float:
    """Loss [J] without gravity, which is never negative, with collisions at the reference weight.

    Args:
        terms: mean energies [J] by name, with their "total".
        collision_weight: weight of the collision term in them [J/m^3].
    """
    return comparable_total(terms, collision_weight) - terms["gravity"]
