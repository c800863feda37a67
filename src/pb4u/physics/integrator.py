"""Integration in time: where inertia would take a state by itself, and the velocities that a move leaves."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from pb4u.scene.state import State

_MOST_GROWTH = 2.0
"""How much longer than the one before a step of the second order may be: above 2.41 it is not stable."""


class Integrator(Protocol):
    """A rule of integration in time. It has no state of its own: data on earlier states are in a state's history.

    Attributes:
        name: its value of `time_integration`.
    """

    name: str

    def inertial_dt(self, state: State, dt: float) -> float | Tensor:
        """Time step [s] of the inertia term, one or (vertices,).

        Args:
            state: at the start of the step.
            dt: length of the step [s].
        """

    def free_move(self, state: State, dt: float) -> Tensor:
        """Displacement (vertices, 3) [m] of every vertex in a step without forces.

        Args:
            state: at the start of the step.
            dt: length of the step [s].
        """

    def arrived(self, state: State, dt: float, positions: Tensor, move: Tensor, struck: Tensor | None = None) -> State:
        """State at the end of a step, with its velocities and the history for the next step; differentiable.

        Args:
            state: at the start of the step.
            dt: its length [s].
            positions: (vertices, 3) [m] at its end.
            move: (vertices, 3) [m] that led there, from which the velocities follow.
            struck: (vertices,) bool on which contact pushes there; None for none.
        """

    def turned_aside(self, state: State, dt: float, positions: Tensor) -> State:
        """A state at other positions, to which contact led the end of its step.

        Args:
            state: at the end of a step.
            dt: length of that step [s].
            positions: (vertices, 3) [m].
        """

    def joined(self, state: State, dt: float, last: State) -> State:
        """State at the end of a step that was taken in parts.

        Args:
            state: at the start of the step.
            dt: its length [s].
            last: at the end of its last part.
        """


class ImplicitEuler:
    """Of first order: velocities are the last move over its time, and no state before counts."""

    name = "implicit-euler"

    def inertial_dt(self, state: State, dt: float) -> float:
        return dt

    def free_move(self, state: State, dt: float) -> Tensor:
        return dt * state.velocities

    def arrived(self, state: State, dt: float, positions: Tensor, move: Tensor, struck: Tensor | None = None) -> State:
        return State(positions, move / dt, state.frame + 1)

    def turned_aside(self, state: State, dt: float, positions: Tensor) -> State:
        return replace(state, positions=positions, velocities=state.velocities + (positions - state.positions) / dt)

    def joined(self, state: State, dt: float, last: State) -> State:
        return replace(last, frame=state.frame + 1)


class _StepBefore(NamedTuple):
    """What the rule of second order knows of the step that led to a state.

    Whatever answers contact after a step changes velocities, and may move cloth without giving it speed. The mean
    velocity of the step therefore follows from the velocity at its end, as (velocity + lag) / lead.

    Args:
        velocities: (vertices, 3) [m/s] at its start.
        lag: (vertices, 3) [m/s].
        lead: (vertices, 1) by how much the velocity at its end changes for each 1 of the mean velocity.
        dt: (vertices, 1) its length [s]; 0 where the next step begins anew.
    """

    velocities: Tensor
    lag: Tensor
    lead: Tensor
    dt: Tensor

    def mean_velocity(self, velocities: Tensor) -> Tensor:
        """Mean velocity (vertices, 3) [m/s] over the step, from the `velocities` (vertices, 3) [m/s] at its end."""
        return (velocities + self.lag) / self.lead


class SecondOrder:
    """Backward differences over two steps (BDF2), of second order: a swing keeps its height at any frame rate.

    With r the step over the one before, the derivative at the end of a step is (1 + 2 r) / (1 + r) of the mean slope
    over it, less r / (1 + r) of the mean slope over the one before: 3/2 and 1/2 where both are equal. The step after a
    state without history, or more than twice as long as the previous one, uses implicit Euler. Source: Hairer, Norsett,
    Wanner, Solving Ordinary Differential Equations I, III.5 (steps may grow by 1 + sqrt(2) at most).

    So does the step of a vertex pushed by contact: its velocity jumps, and the difference of two mean velocities would
    throw it back with half of its speed before. Such a vertex gets its mean velocity and no history
    (docs/design/time_integration.md).
    """

    name = "bdf2"

    def inertial_dt(self, state: State, dt: float) -> float | Tensor:
        return dt / _lead(_growth(state, dt))[:, 0] if state.history else dt

    def free_move(self, state: State, dt: float) -> Tensor:
        if not state.history:
            return dt * state.velocities
        before, growth = _StepBefore(*state.history), _growth(state, dt)
        lead = _lead(growth)
        share = lead - 1.0
        # The velocity would change as it did, and the way follows from it.
        unchanged = state.velocities + share / lead * growth * (state.velocities - before.velocities)
        return dt / lead * (unchanged + share * before.mean_velocity(state.velocities))

    def arrived(self, state: State, dt: float, positions: Tensor, move: Tensor, struck: Tensor | None = None) -> State:
        mean = move / dt
        if state.history:
            lead = _lead(_growth(state, dt))
            velocities = lead * mean - (lead - 1.0) * _StepBefore(*state.history).mean_velocity(state.velocities)
        else:
            lead, velocities = torch.ones_like(mean[:, :1]), mean
        after = _StepBefore(state.velocities, lead * mean - velocities, lead, torch.full_like(lead, dt))
        arrived = State(positions, velocities, state.frame + 1, after)
        return arrived if struck is None else _begun_anew(arrived, struck)

    def turned_aside(self, state: State, dt: float, positions: Tensor) -> State:
        cut = positions - state.positions
        stopped = _begun_anew(state, (cut != 0.0).any(1))
        return replace(stopped, positions=positions, velocities=stopped.velocities + cut / dt)

    def joined(self, state: State, dt: float, last: State) -> State:
        full = self.arrived(state, dt, last.positions, last.positions - state.positions)
        step = _StepBefore(*full.history)
        # The velocity is that of the last part, and the mean one that of the whole step.
        step = step._replace(lag=step.lag + full.velocities - last.velocities)
        anew = _StepBefore(*last.history).dt[:, 0] == 0.0
        step = step._replace(dt=step.dt.masked_fill(anew[:, None], 0.0))
        return replace(full, velocities=last.velocities, history=step)


def _growth(state: State, dt: float) -> Tensor:
    """The step over the one before (vertices, 1), by their lengths; 0 where it begins anew."""
    growth = dt / _StepBefore(*state.history).dt
    return torch.where(growth > _MOST_GROWTH, 0.0, growth)


def _lead(growth: Tensor) -> Tensor:
    """By how much the velocity at the end of a step changes for each 1 of its mean velocity."""
    return (1.0 + 2.0 * growth) / (1.0 + growth)


def _begun_anew(state: State, struck: Tensor) -> State:
    """`state` with the mean velocity of its step at the vertices `struck` (vertices,), which forget the step."""
    if not state.history:  # no step led to it: it is where a simulation begins
        return state
    step, anew = _StepBefore(*state.history), struck[:, None]
    velocities = torch.where(anew, step.mean_velocity(state.velocities), state.velocities)
    lag, lead = torch.where(anew, 0.0, step.lag), torch.where(anew, 1.0, step.lead)
    history = _StepBefore(step.velocities, lag, lead, step.dt.masked_fill(anew, 0.0))
    return replace(state, velocities=velocities, history=history)


IMPLICIT_EULER, SECOND_ORDER = ImplicitEuler(), SecondOrder()

INTEGRATORS: dict[str, Integrator] = {rule.name: rule for rule in (IMPLICIT_EULER, SECOND_ORDER)}
"""Rules of integration by the name that `time_integration` of a run takes."""
