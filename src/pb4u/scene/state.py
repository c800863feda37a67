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
        history: data of the previous step for the integration rule; without, the rule restarts.
        load: (vertices,) [N] contact force of bodies on each vertex at the end of the step, before vertices inside were
            pushed out; None if it follows from the positions.
    """

    positions: Tensor
    velocities: Tensor
    frame: int
    history: tuple[Tensor, ...] = ()
    load: Tensor | None = None

    def double(self) -> State:
        """This state in double precision."""
        history = tuple(values.double() for values in self.history)
        load = None if self.load is None else self.load.double()
        return State(self.positions.double(), self.velocities.double(), self.frame, history, load)
