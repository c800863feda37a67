"""Gravity: the potential energy of height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64, compiled
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.energy_term import EnergyTerm, sum_by_garment
from pb4u.physics.time_step import TimeStep


@dataclass(frozen=True)
class Gravity(EnergyTerm):
    """Minus the sum over vertices of m g . (x' - origin) [J], m the vertex mass [kg], g gravity [m/s^2].

    Args:
        absolute: heights from the world's origin, as the paper's metric has it, instead of the step's height origin.
    """

    absolute: bool = False
    name = "gravity"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        height = x if self.absolute else x - step.height_origin[garments.vertex_garment]
        energy = -garments.vertex_masses * (height @ step.gravity)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        return self.energies(step, contacts, x), -step.garments.vertex_masses[:, None] * step.gravity

    def compiled(self, step: TimeStep, contacts: ContactSet) -> EnergyTerm:
        return CompiledGravity(self, step, contacts)


class CompiledGravity(Gravity):
    """`Gravity` compiled for one step.

    Args:
        term: what it stands for.
        step: the time step.
        contacts: contacts at its start.
    """

    def __init__(self, term: Gravity, step: TimeStep, contacts: ContactSet) -> None:
        origin = torch.zeros_like(step.state.positions)
        self._at_origin, self._gradient = term.energies_and_gradient(step, contacts, origin)
        self._garment = step.garments.vertex_garment.numpy()

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        energies = self._at_origin.clone()
        _add_energies(as_float64(x), self._gradient.numpy(), self._garment, energies.numpy())
        return energies

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        return self.energies(step, contacts, x), self._gradient


@compiled
def _add_energies(vertices: np.ndarray, gradient: np.ndarray, garment: np.ndarray, energies: np.ndarray) -> None:
    """Add to the `energies` (garments,) [J] the products of `vertices` [m] and `gradient` [N], both (vertices, 3)."""
    for row in range(len(vertices)):
        energies[garment[row]] += (
            gradient[row, 0] * vertices[row, 0]
            + gradient[row, 1] * vertices[row, 1]
            + gradient[row, 2] * vertices[row, 2]
        )
