"""Where a network starts a time step from: free flight, as in the paper, or part of the way that the body carries."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.physics.integrator import integrate
from pb4u.physics.overrun import lifted_off_the_body
from pb4u.simulation.step import Situation


class StepStart:
    """Lets every garment start with the share of the body's motion that leaves it least potential, off the body.

    Where a body sets off, free flight leaves all cloth behind by the same amount, and a network has to carry news of
    it across the garment; on a fine mesh that is many edges. Skinning knows that motion at any resolution.

    Args:
        carried_shares: to choose from, besides 0, which is free flight; none is the paper's start.
    """

    def __init__(self, carried_shares: tuple[float, ...] = ()) -> None:
        self.shares = carried_shares

    @torch.no_grad()
    def accelerations(self, situation: Situation) -> Tensor:
        """(vertices, 3) [m per step^2] from free flight to the start of each garment."""
        free = integrate(
            situation.state,
            torch.zeros_like(situation.state.positions),
            situation.dt,
            situation.garments.pinned,
            situation.pin_positions,
        )
        if not self.shares:
            return torch.zeros_like(free.positions)
        carried = situation.carried - situation.dt * situation.state.velocities
        carried = torch.where(situation.garments.pinned[:, None], 0.0, carried)
        shares = carried.new_tensor((0.0, *self.shares))
        # The body's tangent planes half way are exact enough to choose by, and looked up once.
        potential = situation.potential.with_contact_at(free.positions + 0.5 * carried)
        energies = torch.stack([potential.energies(free.positions + share * carried).per_garment for share in shares])
        best = energies.argmin(dim=0)
        start = free.positions + shares[best][situation.garments.vertex_garment, None] * carried
        return lifted_off_the_body(situation.potential, start) - free.positions
