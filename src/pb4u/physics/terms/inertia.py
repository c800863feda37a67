"""Resistance to change of velocity."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from pb4u.collision.jit import compiled
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.energy_term import CompiledTerm, EnergyTerm, dot, sum_by_garment, vertex_elements
from pb4u.physics.terms.stiffness_matrix import Stiffness
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

    def compiled(self, step: TimeStep, contacts: ContactSet) -> EnergyTerm:
        return CompiledInertia(step)

    def _change(self, step: TimeStep, x: Tensor) -> Tensor:
        return (x - step.state.positions) - step.dt * step.state.velocities

    def _energies(self, step: TimeStep, change: Tensor) -> Tensor:
        garments = step.garments
        energy = garments.vertex_masses * dot(change, change) / (2.0 * step.dt**2)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)


class CompiledInertia(CompiledTerm, Inertia):
    """`Inertia` compiled for one step.

    Args:
        step: the time step.
    """

    def __init__(self, step: TimeStep) -> None:
        garments = step.garments
        self._kept = (step.state.positions + step.dt * step.state.velocities).numpy()
        self._stiffness = (garments.vertex_masses / step.dt**2).numpy()
        self._garment = garments.vertex_garment.numpy()

    def add(self, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray) -> None:
        _add_gradient(x, self._kept, self._stiffness, self._garment, energies, gradient)

    def add_stiffness(self, contacts: ContactSet, x: np.ndarray, slots: np.ndarray, stiffness: Stiffness) -> None:
        for axis in range(3):
            stiffness.positive[slots[:, 0], axis, axis] += self._stiffness


@compiled
def _add_gradient(
    vertices: np.ndarray,
    kept: np.ndarray,
    stiffness: np.ndarray,
    garment: np.ndarray,
    energies: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add to the `energies` (garments,) [J] and to their `gradient` (vertices, 3) [N] where it has rows.

    `vertices` (vertices, 3) [m] are `kept` (vertices, 3) [m] where they keep their velocity; `stiffness` (vertices,) is
    mass over squared time step [N/m].
    """
    for row in range(len(vertices)):
        squared = 0.0
        for axis in range(3):
            change = vertices[row, axis] - kept[row, axis]
            if len(gradient):
                gradient[row, axis] += stiffness[row] * change
            squared += change * change
        energies[garment[row]] += 0.5 * stiffness[row] * squared
