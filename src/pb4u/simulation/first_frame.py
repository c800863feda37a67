"""How a simulation starts: from the garment where skinning puts it to a settled state at rest on the standing body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import torch

from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver import Solver
from pb4u.scene.state import State
from pb4u.simulation.refinement import SolverRefinement
from pb4u.simulation.stage import Stage
from pb4u.simulation.step import BallisticPredictor, Contact, NoContact, Situation, StepParts, step

SETTLING_DT = 1.0 / 3.0
"""Length of a settling step [s]: inertia weighs a hundredth of what it does at 30 fps (reference 1.8)."""


class FirstFrame(ABC):
    """Makes the state of frame 0."""

    @abstractmethod
    def start(self, stage: Stage) -> State:
        """Positions settled on the body at frame 0, with the velocity that skinning has there."""


def skinned_state(stage: Stage, frame: int = 0) -> State:
    """The garment where the body alone would carry it, at the speed the body alone would give it."""
    return State(stage.skinned(frame), stage.skinned_velocity(frame), frame)


def settling_situation(stage: Stage, state: State, dt: float = SETTLING_DT) -> Situation:
    """A long step from rest on the body standing still at the state's frame."""
    resting = replace(state, velocities=torch.zeros_like(state.velocities))
    pins = stage.skinned(state.frame)
    held = stage.held_collider(state.frame)
    return Situation(stage.garments, resting, held, pins, torch.zeros_like(pins), dt, stage.gravity)


@dataclass(frozen=True)
class AsSkinned(FirstFrame):
    """Starts where skinning puts the garment, unsettled."""

    def start(self, stage: Stage) -> State:
        return skinned_state(stage)


@dataclass(frozen=True)
class OneLongStep(FirstFrame):
    """The paper's way: the method's own step, once, with the body held and a long time step.

    Args:
        parts: the step of the method that is being started.
        contact: applied once before it (the released code's collision push).
    """

    parts: StepParts
    contact: Contact

    def start(self, stage: Stage) -> State:
        begun = skinned_state(stage)
        situation = settling_situation(stage, begun)
        pushed = self.contact.respond(situation.state, situation)
        settled = step(settling_situation(stage, replace(pushed, frame=begun.frame)), self.parts)
        return replace(begun, positions=settled.positions)


class Relaxed(FirstFrame):
    """Settled by the solver: long steps from rest, until none moves the cloth more than a little.

    Args:
        still: rms displacement of one settling step [m] at which the garment counts as settled.
        most_steps: settling steps after which it starts anyway.
        iterations: solver iterations of each.
        contact: applied after each.
    """

    def __init__(
        self, still: float = 2e-3, most_steps: int = 12, iterations: int = 12, contact: Contact | None = None
    ) -> None:
        self.still, self.most_steps = still, most_steps
        refinement = SolverRefinement(iterations, Solver(), IncrementalPotential())
        self.parts = StepParts(BallisticPredictor(), refinement, contact or NoContact())

    def start(self, stage: Stage) -> State:
        begun = skinned_state(stage)
        state = begun
        for _ in range(self.most_steps):
            settled = step(settling_situation(stage, state), self.parts)
            moved = float((settled.positions - state.positions).square().sum(1).mean().sqrt())
            state = replace(begun, positions=settled.positions)
            if moved <= self.still:
                break
        return state
