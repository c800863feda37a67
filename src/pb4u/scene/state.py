"""State of a simulation: everything that evolves from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, eq=False)
class State:
    """Positions and velocities of one garment (or of packed garments) at one frame.

    Args:
        positions: (vertices, 3) [m].
        velocities: (vertices, 3) [m/s].
        frame: index of the frame in its scene, lead-in included.
        last_move: (vertices, 3) how far the last pass of the network went in the step before [m per step^2]; None where
            no pass was joined with the one before it.
    """

    positions: Tensor
    velocities: Tensor
    frame: int
    last_move: Tensor | None = None
