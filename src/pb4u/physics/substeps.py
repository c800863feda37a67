"""One frame by implicit steps: as many as the body's motion needs."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from pb4u.physics.energy_term import TimeStep
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver import Solution, Solver
from pb4u.scene.packed import ColliderFrame, PackedGarments
from pb4u.scene.state import State

LARGEST_MOTION = 0.15
"""How far the body under the cloth may move in one implicit step [m]: less than a limb is thick."""

_NEAR = 0.05


def substep_count(step: TimeStep) -> int:
    """Implicit steps that `step` should be cut into so that no part of the body near the cloth jumps over it."""
    planes, collider = step.contact_now, step.collider
    if planes is None or collider is None:
        return 1
    near = planes.touchable & (planes.distance < _NEAR)
    if not bool(near.any()):
        return 1
    motion = planes.carried(collider.following - collider.now, collider.faces)[near]
    return max(1, math.ceil(float(motion.norm(dim=1).max()) / LARGEST_MOTION))


def advance(
    potential: IncrementalPotential,
    solver: Solver,
    garments: PackedGarments,
    state: State,
    collider: ColliderFrame,
    dt: float,
    gravity: Tensor | None = None,
    pin_positions: Tensor | None = None,
    iterations: int | None = None,
) -> tuple[State, Solution]:
    """The state one frame later, from free flight, and the solution of its last implicit step.

    A body that moves far in the frame is moved along straight lines in several implicit steps.

    Args:
        potential: the energies. solver: their minimiser. garments: static quantities, float64 on the CPU.
        state: at the start of the frame. collider: the bodies around it. dt: length of the frame [s].
        gravity: (3,) [m/s^2], standard by default.
        pin_positions: (vertices, 3) [m] where pinned vertices are at the end of the frame.
        iterations: at most this many in each implicit step; None goes to the solver's tolerance.

    Raises DivergedError when the state is not finite.
    """
    whole = potential.prepare(garments, state, collider, dt, gravity)
    count = substep_count(whole.step)
    now, current, current_dt = state, whole, dt / count
    for k in range(count):
        if count > 1:
            part = _between(collider, k / count, (k + 1) / count)
            current = potential.prepare(garments, now, part, current_dt, gravity)
        start = now.positions + current_dt * now.velocities
        if pin_positions is not None:
            pins = torch.lerp(state.positions, pin_positions, (k + 1) / count)
            start = torch.where(garments.pinned[:, None], pins, start)
        solution = solver.minimise(current, start, iterations)
        now = replace(now, positions=solution.positions, velocities=(solution.positions - now.positions) / current_dt)
    return replace(now, frame=state.frame + 1), solution


def _between(collider: ColliderFrame, start: float, end: float) -> ColliderFrame:
    now = torch.lerp(collider.now, collider.following, start)
    following = torch.lerp(collider.now, collider.following, end)
    return replace(collider, previous=2.0 * now - following, now=now, following=following)
