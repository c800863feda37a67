"""Resistance to change of velocity."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.physics.contact.planes import ContactSet
from pb4u.physics.energy_term import EnergyTerm, dot, sum_by_garment, vertex_elements
from pb4u.physics.time_step import TimeStep


class Inertia(EnergyTerm):
    """Sum over vertices of m |x' - (x + dt v)|^2 / (2 dt^2) [J].

    m is the vertex mass [kg], x' the next position [m], x and v position and velocity before the step.
    Source: the variational form of implicit Euler, as used by SNUG (Santesteban et al. 2022).
    """

    name = "inertia"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        return self._energies(step, self._change(step, x))

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        change = self._change(step, x)
        return self._energies(step, change), (step.garments.vertex_masses / step.dt**2)[:, None] * change

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return vertex_elements(step.garments)

    def curvature(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        stiffness = step.garments.vertex_masses / step.dt**2
        return stiffness * torch.eye(3, dtype=x.dtype, device=x.device)[:, :, None, None]

    def _change(self, step: TimeStep, x: Tensor) -> Tensor:
        return (x - step.state.positions) - step.dt * step.state.velocities

    def _energies(self, step: TimeStep, change: Tensor) -> Tensor:
        garments = step.garments
        energy = garments.vertex_masses * dot(change, change) / (2.0 * step.dt**2)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)
