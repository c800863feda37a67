"""From predicted accelerations to the next state: semi-implicit Euler."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.scene.state import State


def integrate(
    state: State, acceleration: Tensor, dt: float, pinned: Tensor | None = None, pin_positions: Tensor | None = None
) -> State:
    """Next state from `acceleration` times dt^2 (vertices, 3) [m per step squared]: v' = v + a / dt, x' = x + dt v'.

    Pinned vertices are overwritten by `pin_positions` (vertices, 3) [m] and take the velocity that brings them there.
    Differentiable. Source: the integrator of MeshGraphNets and its descendants, in SI units outside the network.
    """
    require_time_step(dt)
    displacement = dt * state.velocities + acceleration
    positions = state.positions + displacement
    if pinned is not None and pin_positions is not None:
        positions = torch.where(pinned[:, None], pin_positions, positions)
        displacement = torch.where(pinned[:, None], pin_positions - state.positions, displacement)
    return State(positions=positions, velocities=displacement / dt, frame=state.frame + 1)


def require_time_step(dt: float) -> None:
    """Raise InputError unless `dt` [s] is a positive finite number."""
    if not 0.0 < dt < float("inf"):
        raise InputError(f"A time step must be a positive number of seconds, not {dt}; check the frame rate.")
