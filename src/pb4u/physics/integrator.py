"""Integration in time: where inertia would take a state by itself, and the velocities that a move leaves."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor

from pb4u.scene.state import State


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

    def history(self, state: State) -> tuple[Tensor, ...]:
        """What the state at the end of a step has to tell the next one of the state at its start.

        Args:
            state: at the start of the step.
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

    def history(self, state: State) -> tuple[Tensor, ...]:
        return ()


IMPLICIT_EULER = ImplicitEuler()

INTEGRATORS: dict[str, Integrator] = {IMPLICIT_EULER.name: IMPLICIT_EULER}
"""Rules of integration by the name that `time_integration` of a run takes."""
