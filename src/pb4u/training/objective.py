"""What training minimises: the incremental potential of the predicted step, summed over its terms."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor, nn

from pb4u.graph.graph import Graph
from pb4u.nn.acceleration_model import PreparedGarments
from pb4u.physics.collision import Collision
from pb4u.physics.incremental_potential import Energies, IncrementalPotential
from pb4u.physics.integrator import integrate
from pb4u.scene.state import State
from pb4u.simulation.network_simulator import local_origin
from pb4u.simulation.situation_features import SituationFeatures
from pb4u.simulation.step import Predictor, Situation
from pb4u.simulation.step_start import StepStart

REFERENCE_WEIGHT = 5e3
"""Weight of the collision term at which losses of different times are compared [J/m^3]."""


class LearningPredictor(Predictor):
    """The network's prediction, differentiable with respect to its weights.

    Args:
        network: called with a graph and the prepared garments; the model itself, or what distributes it.
        prepared: with the propagation steps of this step.
        start: of the first pass.
        passes: how many to make; only the last is differentiable.
        features: of the garments, where they are already made.

    Attributes:
        reached: accelerations after the latest prediction.
    """

    reached: Tensor

    def __init__(
        self,
        network: nn.Module,
        prepared: PreparedGarments,
        start: StepStart,
        passes: int = 1,
        features: SituationFeatures | None = None,
    ) -> None:
        self.network, self.prepared, self.passes = network, prepared, passes
        self._start = start
        self._features = features or SituationFeatures(prepared)

    def graph(self, situation: Situation, found: Tensor | None = None) -> Graph:
        """What the network sees after `found` accelerations (vertices, 3) [m per step^2]; at the start by default."""
        found = self._start.accelerations(situation) if found is None else found
        extra = self._features.of(situation, found)
        return self.prepared.graph(
            situation.state, situation.collider, situation.dt, local_origin(situation.collider), extra
        )

    def predict(self, situation: Situation) -> State:
        found = self._start.accelerations(situation)
        for _ in range(self.passes):
            before = found.detach()
            found = before + self.network(self.graph(situation, before), self.prepared)
        self.reached = found.detach()
        return integrate(situation.state, found, situation.dt, situation.garments.pinned, situation.pin_positions)


def step_energies(situation: Situation, positions: Tensor, collision_weight: float) -> Energies:
    """Energies of the step from `situation` to `positions` (vertices, 3) [m], garment by garment; differentiable."""
    potential = replace(IncrementalPotential(), collision=Collision(weight=collision_weight))
    prepared = potential.prepare(
        situation.garments,
        situation.state,
        situation.collider,
        situation.dt,
        situation.gravity,
        situation.potential.step.contact_now,
    )
    return prepared.energies(positions)


def mean_energies(energies: Energies) -> dict[str, Tensor]:
    """Every term and their `total`, averaged over the garments."""
    terms = {name: value.mean() for name, value in energies.terms.items()}
    return {**terms, "total": energies.total / len(energies.per_garment)}


def further_losses(
    prepared: PreparedGarments, situation: Situation, positions: Tensor, progress: float
) -> dict[str, Tensor]:
    """What the network's method minimises besides the potential, each averaged over the garments; mostly nothing.

    Args:
        prepared: the garments.
        situation: before the step.
        positions: (vertices, 3) after it [m].
        progress: fraction of the training's budget spent.
    """
    before = situation.state.positions
    return {loss.name: loss.energies(before, positions, progress).mean() for loss in prepared.losses}


def comparable_total(terms: dict[str, float], collision_weight: float) -> float:
    """A loss [J] as it would be with collisions at the reference weight."""
    return terms["total"] - terms["collision"] * (1.0 - REFERENCE_WEIGHT / collision_weight)


def strain_energy(terms: dict[str, float], collision_weight: float) -> float:
    """What of a loss cannot be negative [J]: all but gravity, with collisions at the reference weight."""
    return comparable_total(terms, collision_weight) - terms["gravity"]
