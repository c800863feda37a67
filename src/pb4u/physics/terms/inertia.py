"""Resistance to change of velocity."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.element_loops import GRADIENT, SECOND, Record, each_vertex, element_loops, vertex_record
from pb4u.physics.terms.energy_term import EnergyTerm, dot, sum_by_garment
from pb4u.physics.time_step import TimeStep


def _vertex(
    x: np.ndarray,
    corners: np.ndarray,
    numbers: np.ndarray,
    element: int,
    wanted: int,
    forces: np.ndarray,
    blocks: np.ndarray,
    factors: np.ndarray,
) -> float:
    """One vertex; its numbers are mass over squared time step [N/m], and where it would keep its velocity [m]."""
    vertex, stiffness, squared = corners[element, 0], numbers[element, 0], 0.0
    for axis in range(3):
        change = x[vertex, axis] - numbers[element, 1 + axis]
        squared += change * change
        if wanted == GRADIENT:
            forces[0, axis] = stiffness * change
        if wanted == SECOND:
            blocks[0, axis, axis] = stiffness
    return 0.5 * stiffness * squared


class Inertia(EnergyTerm):
    """Sum over vertices of m |x' - (x + dt v)|^2 / (2 dt^2) [J], of implicit Euler.

    m is the vertex mass [kg], x' the next position [m], x and v position and velocity before the step. Another
    integrator has another free move than dt v, and another time than dt.
    Source: the variational form of implicit Euler, as used by SNUG (Santesteban et al. 2022).
    """

    name = "inertia"
    loops = element_loops(_vertex, 1)
    reads_contacts = False

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        change = (x - step.state.positions) - step.free_move
        energy = garments.vertex_masses * dot(change, change) / (2.0 * step.inertial_dt**2)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return each_vertex(step.garments)

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        state, masses = step.state.double(), step.garments.vertex_masses.double()
        targets = as_float64(state.positions + step.integrator.free_move(state, step.dt))
        records = (vertex_record(step.garments, as_float64(masses / step.inertial_dt**2), targets),)
        return lambda _: records
