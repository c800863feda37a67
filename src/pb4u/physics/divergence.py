"""Noticing a simulation that has left the numbers."""

from __future__ import annotations

import torch

from pb4u.errors import Pb4uError
from pb4u.scene.state import State


class DivergedError(Pb4uError):
    """A state is no longer finite; frames before `frame` are still good."""

    def __init__(self, frame: int, reason: str) -> None:
        super().__init__(f"The simulation diverged at frame {frame}: {reason}; the frames before it are kept.")
        self.frame = frame


def require_finite(state: State) -> State:
    """Return `state`, or raise DivergedError when a position or velocity is not finite."""
    finite = torch.isfinite(state.positions).all(1) & torch.isfinite(state.velocities).all(1)
    if not bool(finite.all()):
        bad = torch.nonzero(~finite).reshape(-1)
        reason = f"{len(bad)} of {len(finite)} vertices are not finite, first vertex {int(bad[0])}"
        raise DivergedError(state.frame, reason)
    return state
