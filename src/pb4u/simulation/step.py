"""One time step, told as a story: predict, refine, answer contact. Simulation and training take the same step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from torch import Tensor

from pb4u.physics.incremental_potential import IncrementalPotential, StepPotential
from pb4u.physics.integrator import integrate
from pb4u.scene.packed import ColliderFrame, PackedGarments
from pb4u.scene.state import State


@dataclass(frozen=True, eq=False)
class Situation:
    """All that is known before a step.

    Args:
        garments: static quantities.
        state: positions and velocities now.
        collider: the bodies before, now and after the step.
        pin_positions: (vertices, 3) [m] where the pinned vertices will be after the step; other rows are not read.
        carried: (vertices, 3) [m] how far the body alone would carry each vertex during the step.
        dt: length of the step [s].
        gravity: (3,) [m/s^2].
    """

    garments: PackedGarments
    state: State
    collider: ColliderFrame
    pin_positions: Tensor
    carried: Tensor
    dt: float
    gravity: Tensor

    @cached_property
    def potential(self) -> StepPotential:
        """The incremental potential of the step at its usual weights, with the contacts at its start found once."""
        return IncrementalPotential().prepare(self.garments, self.state, self.collider, self.dt, self.gravity)

    def with_pins(self, positions: Tensor) -> Tensor:
        """`positions` with the pinned vertices where they will be."""
        return torch.where(self.garments.pinned[:, None], self.pin_positions, positions)


class Predictor(ABC):
    """Says where the garments go."""

    @abstractmethod
    def predict(self, situation: Situation) -> State:
        """The next state, pins in place."""


class BallisticPredictor(Predictor):
    """Free flight: every vertex keeps its velocity. Where the solver starts from."""

    def predict(self, situation: Situation) -> State:
        still = torch.zeros_like(situation.state.positions)
        return integrate(situation.state, still, situation.dt, situation.garments.pinned, situation.pin_positions)


class Refinement(ABC):
    """Improves a prediction by physics."""

    @abstractmethod
    def refine(self, predicted: State, situation: Situation) -> State:
        """A state of lower incremental potential; its velocity is the displacement over dt."""


class NoRefinement(Refinement):
    """Leaves predictions as they are."""

    def refine(self, predicted: State, situation: Situation) -> State:
        return predicted


class Contact(ABC):
    """Answers what is left inside the body."""

    @abstractmethod
    def respond(self, state: State, situation: Situation) -> State:
        """The state with vertices pushed out; push-out depth never becomes speed."""

    @abstractmethod
    def present(self, state: State, garments: PackedGarments, collider: ColliderFrame) -> State:
        """The state as it is written, at the instant of `collider.following`; the simulation goes on from `state`."""


class NoContact(Contact):
    """Leaves states as they are."""

    def respond(self, state: State, situation: Situation) -> State:
        return state

    def present(self, state: State, garments: PackedGarments, collider: ColliderFrame) -> State:
        return state


@dataclass(frozen=True, eq=False)
class StepParts:
    """What a step is made of; each part has a null object."""

    predictor: Predictor
    refinement: Refinement = field(default_factory=NoRefinement)
    contact: Contact = field(default_factory=NoContact)


def step(situation: Situation, parts: StepParts) -> State:
    """The state at the end of the step; nothing given is changed."""
    predicted = parts.predictor.predict(situation)
    refined = parts.refinement.refine(predicted, situation)
    return parts.contact.respond(refined, situation)


def displaced(before: State, positions: Tensor, dt: float) -> State:
    """The state after `before` with `positions` [m], moving at the speed that brought it there."""
    return replace(before, positions=positions, velocities=(positions - before.positions) / dt, frame=before.frame + 1)
