"""Gravity: the potential energy of height."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from pb4u.physics.contact.planes import ContactSet
from pb4u.physics.energy_term import EnergyTerm, sum_by_garment
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
