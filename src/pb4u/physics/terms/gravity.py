"""Gravity: the potential energy of height."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import compiled
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.energy_term import CompiledTerm, EnergyTerm, sum_by_garment
from pb4u.physics.time_step import TimeStep


class Gravity(EnergyTerm):
    """Minus the sum over vertices of m g . (x' - origin) [J], m the vertex mass [kg], g gravity [m/s^2].

    Heights are from the height origin of the step.
    """

    name = "gravity"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        height = x - step.height_origin[garments.vertex_garment]
        energy = -garments.vertex_masses * (height @ step.gravity)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        return self.energies(step, contacts, x), -step.garments.vertex_masses[:, None] * step.gravity

    def compiled(self, step: TimeStep, contacts: ContactSet) -> EnergyTerm:
        return CompiledGravity(self, step, contacts)


class CompiledGravity(CompiledTerm, Gravity):
    """`Gravity` compiled for one step.

    Args:
        term: what it stands for.
        step: the time step.
        contacts: contacts at its start.
    """

    def __init__(self, term: Gravity, step: TimeStep, contacts: ContactSet) -> None:
        origin = torch.zeros_like(step.state.positions)
        found = term.energies_and_gradient(step, contacts, origin)
        self._at_origin, self._gradient = (values.numpy() for values in found)
        self._garment = step.garments.vertex_garment.numpy()

    def add(self, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray) -> None:
        energies += self._at_origin
        gradient[:] = self._gradient[: len(gradient)]
        _add_energies(x, self._gradient, self._garment, energies)


@compiled
def _add_energies(vertices: np.ndarray, gradient: np.ndarray, garment: np.ndarray, energies: np.ndarray) -> None:
    """Add to the `energies` (garments,) [J] the products of `vertices` [m] and `gradient` [N], both (vertices, 3)."""
    for row in range(len(vertices)):
        energies[garment[row]] += (
            gradient[row, 0] * vertices[row, 0]
            + gradient[row, 1] * vertices[row, 1]
            + gradient[row, 2] * vertices[row, 2]
        )
