"""Gravity: the potential energy of height."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.element_loops import GRADIENT, Record, element_loops, vertex_record
from pb4u.physics.terms.energy_term import EnergyTerm, constant, sum_by_garment
from pb4u.physics.time_step import TimeStep


def _vertex(
    x: np.ndarray,
    corners: np.ndarray,
    numbers: np.ndarray,
    vertex: int,
    wanted: int,
    forces: np.ndarray,
    blocks: np.ndarray,
    factors: np.ndarray,
) -> float:
    """One vertex; its numbers are its weight along each axis [N], and where its energy is zero [m]."""
    energy = 0.0
    for axis in range(3):
        energy -= numbers[vertex, axis] * (x[vertex, axis] - numbers[vertex, 3 + axis])
        if wanted == GRADIENT:
            forces[0, axis] = -numbers[vertex, axis]
    return energy


class Gravity(EnergyTerm):
    """Minus the sum over vertices of m g . (x' - origin) [J], m the vertex mass [kg], g gravity [m/s^2].

    Heights are from the height origin of the step.
    """

    name = "gravity"
    loops = element_loops(_vertex, 1)
    reads_contacts = False

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        height = x - step.height_origin[garments.vertex_garment]
        energy = -garments.vertex_masses * (height @ _pull(step))
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        garments = step.garments
        weight = as_float64(garments.vertex_masses)[:, None] * as_float64(_pull(step))
        records = (vertex_record(garments, weight, as_float64(step.height_origin[garments.vertex_garment])),)
        return lambda _: records


def _pull(step: TimeStep) -> Tensor:
    """Gravity (3,) [m/s^2] in the numbers of the step."""
    x = step.state.positions
    return constant(step.environment.gravity, x.dtype, x.device)
