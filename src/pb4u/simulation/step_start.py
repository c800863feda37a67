"""Where a network starts a time step from: free flight, as in the paper, or part of the way that the body carries."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor

from pb4u.nn.acceleration_model import GraphNetwork
from pb4u.physics.overrun import lifted_off_the_body
from pb4u.simulation.step import BallisticPredictor, Situation


class StepStart(ABC):
    """Says where a pass of a network starts."""

    @abstractmethod
    def accelerations(self, situation: Situation) -> Tensor:
        """(vertices, 3) [m per step^2] from free flight to the start."""


class FreeFlight(StepStart):
    """The paper's: every vertex keeps its velocity."""

    def accelerations(self, situation: Situation) -> Tensor:
        return torch.zeros_like(situation.state.positions)


class Reached(StepStart):
    """Goes on from what earlier passes of the same step reached.

    Args:
        accelerations: (vertices, 3) [m per step^2].
    """

    def __init__(self, accelerations: Tensor) -> None:
        self._accelerations = accelerations

    def accelerations(self, situation: Situation) -> Tensor:
        return self._accelerations


class Carried(StepStart):
    """Lets every garment start with the share of the body's motion that leaves it least potential, off the body.

    Where a body sets off, free flight leaves all cloth behind by the same amount, and a network has to carry news of
    it across the garment; on a fine mesh that is many edges. Skinning knows that motion at any resolution.

    Args:
        shares: to choose from, besides 0, which is free flight.
    """

    def __init__(self, shares: tuple[float, ...]) -> None:
        self.shares = shares

    @torch.no_grad()
    def accelerations(self, situation: Situation) -> Tensor:
        garments = situation.garments
        free = BallisticPredictor().predict(situation).positions
        missing = situation.carried - situation.dt * situation.state.velocities
        missing = torch.where(garments.pinned[:, None], 0.0, missing)
        shares = missing.new_tensor((0.0, *self.shares))
        # The body's tangent planes half way are exact enough to choose by, and looked up once.
        potential = situation.potential.with_contact_at(free + 0.5 * missing)
        energies = torch.stack([potential.energies(free + share * missing).per_garment for share in shares])
        best = shares[energies.argmin(dim=0)]
        start = free + best[garments.vertex_garment, None] * missing
        return lifted_off_the_body(situation.potential, start) - free


def start_of(network: GraphNetwork) -> StepStart:
    """Where the steps of `network` start."""
    return Carried(network.carried_shares) if network.carried_shares else FreeFlight()
