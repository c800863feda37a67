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
        history: what the rule of integration keeps of the step that led here; without, it begins anew.
    """

    positions: Tensor
    velocities: Tensor
    frame: int
    history: tuple[Tensor, ...] = ()

    def double(self) -> State:
        """This state in double precision."""
        history = tuple(values.double() for values in self.history)
        return State(self.positions.double(), self.velocities.double(), self.frame, history)
