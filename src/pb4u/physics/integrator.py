"""Integration in time: where inertia would take a state by itself, and the velocities that a move leaves."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from pb4u.scene.state import State

_MOST_GROWTH = 2.0
"""How much longer than the one before a step of the second order may be: above 2.41 it is not stable."""


class Integrator(Protocol):
    """A rule of integration in time. It keeps nothing: what it has to know of earlier states is a state's history.

    Attributes:
        name: by which a run asks for it.
    """

    name: str

    def inertial_dt(self, state: State, dt: float) -> float:
        """Time [s] by whose square inertia is divided; a further move over it is what the velocity changes by.

        Args:
            state: at the start of the step.
            dt: length of the step [s].
        """

    def free_move(self, state: State, dt: float) -> Tensor:
        """How far (vertices, 3) [m] every vertex goes in a step in which nothing acts on it.

        Args:
            state: at the start of the step.
            dt: length of the step [s].
        """

    def velocities(self, state: State, dt: float, move: Tensor) -> Tensor:
        """Velocities (vertices, 3) [m/s] at the end of a step; differentiable.

        Args:
            state: at its start.
            dt: its length [s].
            move: (vertices, 3) [m] from its start to its end.
        """

    def history(self, state: State, dt: float, move: Tensor, velocities: Tensor) -> tuple[Tensor, ...]:
        """What the state at the end of a step has to tell the next one of the step that led there.

        Args:
            state: at the start of the step.
            dt: its length [s].
            move: (vertices, 3) [m] from its start to its end.
            velocities: (vertices, 3) [m/s] at its end.
        """


class ImplicitEuler:
    """Of first order: velocities are the last move over its time, and no state before counts."""

    name = "implicit-euler"

    def inertial_dt(self, state: State, dt: float) -> float:
        return dt

    def free_move(self, state: State, dt: float) -> Tensor:
        return dt * state.velocities

    def velocities(self, state: State, dt: float, move: Tensor) -> Tensor:
        return move / dt

    def history(self, state: State, dt: float, move: Tensor, velocities: Tensor) -> tuple[Tensor, ...]:
        return ()


class _StepBefore(NamedTuple):
    """What the rule of second order knows of the step that led to a state.

    Whatever answers contact after a step changes velocities, and may move cloth without giving it speed. The mean
    velocity of the step therefore follows from the velocity at its end, as (velocity + lag) / lead.

    Args:
        velocities: (vertices, 3) [m/s] at its start.
        lag: (vertices, 3) [m/s].
        lead: () by how much the velocity at its end changes for each 1 of the mean velocity.
        dt: () its length [s].
    """

    velocities: Tensor
    lag: Tensor
    lead: Tensor
    dt: Tensor


class SecondOrder:
    """Backward differences over two steps (BDF2), of second order: a swing keeps its height at any frame rate.

    With r the step over the one before, the derivative at the end of a step is (1 + 2 r) / (1 + r) of the mean slope
    over it, less r / (1 + r) of the mean slope over the one before: 3/2 and 1/2 where both are equal. The step after a
    state without history, and one more than twice as long as that before, is one of implicit Euler. Source: Hairer,
    Norsett, Wanner, Solving Ordinary Differential Equations I, III.5 (steps may grow by 1 + sqrt(2) at most).
    """

    name = "bdf2"

    def inertial_dt(self, state: State, dt: float) -> float:
        return dt / _lead(state, dt)

    def free_move(self, state: State, dt: float) -> Tensor:
        lead = _lead(state, dt)
        if lead == 1.0:
            return dt * state.velocities
        before = _StepBefore(*state.history)
        share = lead - 1.0
        # The velocity would change as it did, and the way follows from it.
        unchanged = state.velocities + share / lead * _over(before.dt, dt) * (state.velocities - before.velocities)
        return dt / lead * (unchanged + share * _mean_velocity(state))

    def velocities(self, state: State, dt: float, move: Tensor) -> Tensor:
        lead = _lead(state, dt)
        return move / dt if lead == 1.0 else lead * move / dt - (lead - 1.0) * _mean_velocity(state)

    def history(self, state: State, dt: float, move: Tensor, velocities: Tensor) -> tuple[Tensor, ...]:
        lead = _lead(state, dt)
        numbers = torch.tensor([lead, dt], dtype=torch.float64)
        return _StepBefore(state.velocities, lead * move / dt - velocities, numbers[0], numbers[1])


def _over(before: Tensor, dt: float) -> float:
    """The step over the one before, by their lengths [s]."""
    return dt / float(before)


def _lead(state: State, dt: float) -> float:
    """By how much the velocity at the end of a step changes for each 1 of its mean velocity."""
    if not state.history:
        return 1.0
    growth = _over(_StepBefore(*state.history).dt, dt)
    return 1.0 if growth > _MOST_GROWTH else (1.0 + 2.0 * growth) / (1.0 + growth)


def _mean_velocity(state: State) -> Tensor:
    """Mean velocity (vertices, 3) [m/s] over the step that led to `state`."""
    before = _StepBefore(*state.history)
    return (state.velocities + before.lag) / float(before.lead)


IMPLICIT_EULER, SECOND_ORDER = ImplicitEuler(), SecondOrder()

INTEGRATORS: dict[str, Integrator] = {rule.name: rule for rule in (IMPLICIT_EULER, SECOND_ORDER)}
"""Rules of integration by the name that `time_integration` of a run takes."""
