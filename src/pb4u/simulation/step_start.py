"""Start of a time step: free flight, as in the paper, or a share of the body's motion."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pb4u.network.acceleration_model import GraphNetwork
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.contact_tracking import moved_off_the_body
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.energy_term import constant
from pb4u.physics.time_step import TimeStep, integrate
from pb4u.threads import begun

WARM_START_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the body's motion that a step may start from, besides none."""

_ROUNDING = 1e-6
"""Share of an energy by which it is not taken to rise: a few times what it is rounded by in single precision."""


class BodyMotionWarmStart:
    """Starts every world with the share of the body's motion of least potential, moved off the body.

    When a body begins to move, free flight leaves all cloth behind by the same amount, and a network has to pass that
    on across the garment; on a fine mesh that is many edges. Skinning gives that motion at any resolution.

    Args:
        potential: the energies; those of cloth against cloth do not count, as shares of a motion may cross. Where it
            keeps bodies off what lies between vertices, the start has the heights over the skin that a solve keeps.
        shares: to choose from, besides 0, which is free flight.
    """

    def __init__(self, potential: IncrementalPotential, shares: tuple[float, ...] = WARM_START_SHARES) -> None:
        self.potential = potential
        self.shares = shares

    @torch.no_grad()
    def accelerations(self, step: TimeStep) -> Tensor:
        """Accelerations (vertices, 3) [m per step^2] from free flight to the start.

        Args:
            step: the time step.
        """
        free = integrate(step, torch.zeros_like(step.state.positions)).positions
        if step.skinned_motion is None:
            return torch.zeros_like(free)
        garments, potential = step.garments, self.potential.of(step).without_cloth()
        # What the terms read of the step is gathered while the bodies are looked up.
        gathered = begun(potential.gather)
        missing = step.skinned_motion - step.free_move
        missing = torch.where(garments.pinned[:, None], 0.0, missing)
        shares = constant((0.0, *self.shares), missing.dtype, missing.device)
        # The body's tangent planes half way are exact enough to choose by, and queried once.
        frozen = potential.with_contact_at(free + 0.5 * missing)
        gathered()
        best = _best(frozen, free, missing, shares)
        start = free + best[garments.vertex_world, None] * missing
        return moved_off_the_body(potential, start) - free

    def positions(self, step: TimeStep) -> Tensor:
        """Positions (vertices, 3) [m] of the start.

        Args:
            step: the time step.
        """
        return integrate(step, self.accelerations(step)).positions


def _best(potential: StepPotential, free: Tensor, missing: Tensor, shares: Tensor) -> Tensor:
    """The share (worlds,) of least energy, of some `shares` that rise, of the `missing` motion (vertices, 3) [m].

    A processor looks at them from the largest on, until the energy of every world has risen: it falls towards one share
    from both sides.
    """
    if potential.step.batches:
        return shares[potential.energies_of_worlds(free + shares[:, None, None] * missing).argmin(dim=0)]
    worlds = potential.step.garments.world_count
    best, lowest = shares.new_zeros(worlds), shares.new_full((worlds,), math.inf)
    is_falling = torch.ones(worlds, dtype=torch.bool)
    for share in shares.flip(0):
        energies = potential.energies(free + share * missing).per_world(potential.step.garments)
        # Where the motion is nothing, all energies are alike but for rounding, and the smallest share is taken.
        is_falling = is_falling & (energies <= lowest + _ROUNDING * lowest.abs())
        if not bool(is_falling.any()):
            break
        is_lower = is_falling & (energies <= lowest)
        best, lowest = torch.where(is_lower, share, best), torch.where(is_lower, energies, lowest)
    return best


def start_of(network: GraphNetwork, potential: IncrementalPotential) -> BodyMotionWarmStart | None:
    """Start of the steps of `network`; None for free flight, as in the paper.

    Args:
        network: the network.
        potential: the energies that choose it.
    """
    shares = network.configuration.warm_start_shares
    return BodyMotionWarmStart(potential, shares) if shares else None


def start_accelerations(start: BodyMotionWarmStart | None, step: TimeStep) -> Tensor:
    """Accelerations (vertices, 3) [m per step^2] from free flight to where `step` starts.

    Args:
        start: rule for the start; None for free flight.
        step: the time step.
    """
    return torch.zeros_like(step.state.positions) if start is None else start.accelerations(step)
