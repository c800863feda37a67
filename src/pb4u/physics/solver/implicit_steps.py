"""Time steps taken by the solver alone: one implicit step, or several where the body moves far."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from torch import Tensor

from pb4u.physics.contact.contact_set import MOTION_REACH
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.newton_solver import Solution, Solver
from pb4u.physics.time_step import TimeStep
from pb4u.scene.state import State

LARGEST_MOTION = 0.15
"""How far the body under the cloth may move in one implicit step [m]: less than a limb is thick."""


def substep_count(step: TimeStep, largest_motion: float = LARGEST_MOTION) -> int:
    """Number of implicit steps that `step` is divided into so that no part of the body near the cloth passes it.

    Args:
        step: the time step.
        largest_motion: largest displacement [m] of such a part in one step.
    """
    planes, bodies = step.contacts.now, step.bodies
    if planes is None or bodies is None:
        return 1
    near = planes.touchable & (planes.distance < MOTION_REACH)
    if not bool(near.any()):
        return 1
    motion = planes.interpolated(bodies.motion, bodies.colliders.contact_faces)[near]
    return max(1, math.ceil(float(motion.norm(dim=1).max()) / largest_motion))


def free_flight(step: TimeStep) -> Tensor:
    """Positions (vertices, 3) [m] if every vertex keeps its velocity, with pinned ones at their targets.

    Args:
        step: the time step.
    """
    return step.with_pins(step.state.positions + step.free_move)


def implicit_steps(
    potential: IncrementalPotential,
    solver: Solver,
    step: TimeStep,
    iterations: int | None = None,
    start: Callable[[TimeStep], Tensor] = free_flight,
) -> tuple[State, Solution]:
    """The state at the end of `step`, and the solution of its last implicit step.

    The solution has the iterations of all parts, and is converged if all are.

    A body that moves far in the step is moved along straight lines in several implicit steps.

    Args:
        potential: the energies.
        solver: minimises them.
        step: garments in float64 on the CPU.
        iterations: at most this many in each implicit step; None goes to the solver's tolerance.
        start: gives the positions (vertices, 3) [m] that an implicit step starts from.

    Raises:
        DivergedError: the state is not finite.
    """
    count = substep_count(step)
    return in_parts(step, count, lambda part: solver.minimise(potential.of(part), start(part), iterations))


def in_parts(step: TimeStep, count: int, solve: Callable[[TimeStep], Solution]) -> tuple[State, Solution]:
    """The state at the end of `step`, and the solution of the last of its parts, as `implicit_steps` gives them.

    Args:
        step: the time step.
        count: number of parts.
        solve: solves one part.
    """
    state, iterations, converged = step.state, 0, True
    for k in range(count):
        part = step if count == 1 else step.part(k, count, state)
        solution = solve(part)
        state = part.reached(solution.positions, solution.struck)
        iterations, converged = iterations + solution.iterations, converged and solution.converged
    if count > 1:
        state = step.reached_by_parts(state)
    return state, replace(solution, iterations=iterations, converged=converged)
