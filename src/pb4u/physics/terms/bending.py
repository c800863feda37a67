"""Out-of-plane bending at the edge between two faces."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.element_loops import GRADIENT, VALUE, Record, element_loops, rows
from pb4u.physics.terms.energy_term import EnergyTerm, dot, sum_by_garment
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments


def _hinge(
    x: np.ndarray,
    corners: np.ndarray,
    numbers: np.ndarray,
    hinge: int,
    wanted: int,
    forces: np.ndarray,
    blocks: np.ndarray,
    factors: np.ndarray,
) -> float:
    """One hinge; its numbers are k / (4 (A1 + A2)) [J/m^2], and l theta [m] at which it bends back with no force.

    The second derivative is Gauss-Newton's: that times the outer product of d(l theta)/dx.
    """
    a, b, c, d = corners[hinge, 0], corners[hinge, 1], corners[hinge, 2], corners[hinge, 3]
    e = (x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2])
    to_c = (x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2])
    to_d = (x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2])
    length = max(np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), 1e-30)
    m = (e[1] * to_c[2] - e[2] * to_c[1], e[2] * to_c[0] - e[0] * to_c[2], e[0] * to_c[1] - e[1] * to_c[0])
    n = (to_d[1] * e[2] - to_d[2] * e[1], to_d[2] * e[0] - to_d[0] * e[2], to_d[0] * e[1] - to_d[1] * e[0])
    sine = e[0] * (m[1] * n[2] - m[2] * n[1]) + e[1] * (m[2] * n[0] - m[0] * n[2]) + e[2] * (m[0] * n[1] - m[1] * n[0])
    angle = np.arctan2(sine / length, m[0] * n[0] + m[1] * n[1] + m[2] * n[2])
    stiffness, bend = numbers[hinge, 0], length * angle - numbers[hinge, 1]
    energy = 0.5 * stiffness * bend * bend
    if wanted == VALUE:
        return energy
    over_m = length / max(m[0] * m[0] + m[1] * m[1] + m[2] * m[2], 1e-30)
    over_n = length / max(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], 1e-30)
    along_c = (to_c[0] * e[0] + to_c[1] * e[1] + to_c[2] * e[2]) / length
    along_d = (to_d[0] * e[0] + to_d[1] * e[1] + to_d[2] * e[2]) / length
    scale = stiffness * bend if wanted == GRADIENT else 1.0
    for axis in range(3):
        lengthening, of_c, of_d = angle * e[axis] / length, m[axis] * over_m, n[axis] * over_n
        forces[0, axis] = scale * ((length - along_c) * of_c + (length - along_d) * of_d - lengthening)
        forces[1, axis] = scale * (along_c * of_c + along_d * of_d + lengthening)
        forces[2, axis] = scale * (-length * of_c)
        forces[3, axis] = scale * (-length * of_d)
    if wanted == GRADIENT:
        return energy
    pair = 0
    for first in range(4):
        for second in range(first, 4):
            for i in range(3):
                for j in range(3):
                    blocks[pair, i, j] = stiffness * forces[first, i] * forces[second, j]
            pair += 1
    return energy


class Bending(EnergyTerm):
    """Sum over hinges of k l^2 / (4 (A1 + A2)) theta^2 / 2 [J].

    k is the bending coefficient [J], l the current edge length [m], A1 and A2 the rest areas of the two faces [m^2],
    theta = atan2(e . (n0 x n1), n0 . n1) their dihedral angle [rad], 0 where flat. Source: SNUG and HOOD.
    """

    name = "bending"
    loops = element_loops(_hinge, 4)
    reads_contacts = False

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments, (stiffness, unbent) = step.garments, self.resisted(step)
        bend = bends(garments, x) - unbent
        energy = 0.5 * stiffness * bend * bend
        return sum_by_garment(energy, garments.hinge_garment, garments.garment_count)

    def resisted(self, step: TimeStep) -> tuple[Tensor, Tensor | float]:
        """Stiffness (hinges,) [J/m^2], and l theta [m] of hinges without a bending force, (hinges,) or one for all.

        Args:
            step: the time step.
        """
        return hinge_stiffness(step.garments), 0.0

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return step.garments.hinges

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        garments, (stiffness, unbent) = step.garments, self.resisted(step)
        numbers = rows(len(garments.hinges), as_float64(stiffness), np.asarray(unbent))
        records = (Record(garments.hinges.numpy(), garments.hinge_garment.numpy(), numbers),)
        return lambda _: records


def bends(garments: PackedGarments, x: Tensor) -> Tensor:
    """Length times dihedral angle (hinges,) [m] at x (vertices, 3) [m].

    Args:
        garments: the garments with these hinges.
        x: (vertices, 3) [m].
    """
    tiny = 1e-30 if x.dtype == torch.float64 else 1e-20
    x0, x1, x2, x3 = (x.index_select(0, garments.hinges[:, k]) for k in range(4))
    edge = x1 - x0
    length = edge.norm(dim=1).clamp_min(tiny)
    n0, n1 = torch.linalg.cross(edge, x2 - x0), torch.linalg.cross(x3 - x0, edge)
    return length * torch.atan2(dot(edge, torch.linalg.cross(n0, n1)) / length, dot(n0, n1))


def hinge_stiffness(garments: PackedGarments) -> Tensor:
    """k / (4 (A1 + A2)) (hinges,) [J/m^2].

    Args:
        garments: the garments with these hinges.
    """
    return garments.bending / (4.0 * garments.hinge_areas)
