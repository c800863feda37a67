"""Out-of-plane bending at the edge between two faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import compiled_with_fused_products
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.energy_term import CompiledTerm, EnergyTerm, columns, dot, sum_by_garment, sum_by_vertex
from pb4u.physics.terms.stiffness_matrix import Stiffness
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True)
class Bending(EnergyTerm):
    """Sum over hinges of k l^2 / (4 (A1 + A2)) theta^2 / 2 [J].

    k is the bending coefficient [J], l the current edge length [m], A1 and A2 the rest areas of the two faces [m^2],
    theta = atan2(e . (n0 x n1), n0 . n1) their dihedral angle [rad], 0 where flat. Source: SNUG and HOOD.
    """

    name = "bending"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        length, angle = _length_and_angle(x, garments.hinges)
        return self._energies(garments, length * angle)

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        garments = step.garments
        bend, derivative = self._bend_and_derivative(garments, x)
        pull = _stiffness(garments) * bend
        forces = torch.cat([pull * d for d in derivative], dim=1)
        return self._energies(garments, bend), sum_by_vertex(forces, garments.hinges.T.reshape(-1), len(x))

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return step.garments.hinges

    def compiled(self, step: TimeStep, contacts: ContactSet) -> CompiledBending:
        return CompiledBending(step.garments)

    def _energies(self, garments: PackedGarments, bend: Tensor) -> Tensor:
        energy = 0.5 * _stiffness(garments) * bend * bend
        return sum_by_garment(energy, garments.hinge_garment, garments.garment_count)

    def _bend_and_derivative(self, garments: PackedGarments, x: Tensor) -> tuple[Tensor, list[Tensor]]:
        """l theta [m] of each hinge and its derivative (3, hinges) by each of the four vertices."""
        x0, x1, x2, x3 = columns(x, garments.hinges.T.reshape(-1)).reshape(3, 4, -1).unbind(1)
        edge, to_x2, to_x3 = x1 - x0, x2 - x0, x3 - x0
        length = _inner(edge, edge).sqrt().clamp_min(_tiny(x))
        along = edge / length
        n0, n1 = torch.linalg.cross(edge, to_x2, dim=0), torch.linalg.cross(to_x3, edge, dim=0)
        sine = _inner(along, torch.linalg.cross(n0, n1, dim=0))
        angle = torch.atan2(sine, _inner(n0, n1))
        m0 = n0 * (length / _inner(n0, n0).clamp_min(_tiny(x)))
        m1 = n1 * (length / _inner(n1, n1).clamp_min(_tiny(x)))
        part2, part3 = _inner(to_x2, along), _inner(to_x3, along)
        lengthening = angle * along
        by_x0 = (length - part2) * m0 + (length - part3) * m1 - lengthening
        by_x1 = part2 * m0 + part3 * m1 + lengthening
        return length * angle, [by_x0, by_x1, -length * m0, -length * m1]


class CompiledBending(CompiledTerm, Bending):
    """`Bending` compiled, with Gauss-Newton second derivatives: k times the outer product of d(l theta)/dx.

    Args:
        garments: in float64 on the CPU.
    """

    def __init__(self, garments: PackedGarments) -> None:
        self._hinges, self._garment = garments.hinges.numpy(), garments.hinge_garment.numpy()
        self._stiffness = _stiffness(garments).numpy()

    def add(self, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray) -> None:
        _add_gradient(x, self._hinges, self._stiffness, self._garment, energies, gradient)

    def add_stiffness(self, contacts: ContactSet, x: np.ndarray, slots: np.ndarray, stiffness: Stiffness) -> None:
        _add_stiffness(x, self._hinges, self._stiffness, slots, stiffness.positive)


def _length_and_angle(x: Tensor, hinges: Tensor) -> tuple[Tensor, Tensor]:
    x0, x1, x2, x3 = (x.index_select(0, hinges[:, k]) for k in range(4))
    edge = x1 - x0
    length = edge.norm(dim=1).clamp_min(_tiny(x))
    n0, n1 = torch.linalg.cross(edge, x2 - x0), torch.linalg.cross(x3 - x0, edge)
    sine = dot(edge, torch.linalg.cross(n0, n1)) / length
    return length, torch.atan2(sine, dot(n0, n1))


def _inner(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(0)


def _stiffness(garments: PackedGarments) -> Tensor:
    """k / (4 (A1 + A2)) (hinges,) [J/m^2]."""
    return garments.bending / (4.0 * garments.hinge_areas)


def _tiny(x: Tensor) -> float:
    return 1e-30 if x.dtype == torch.float64 else 1e-20


@compiled_with_fused_products
def _bend(vertices: np.ndarray, hinges: np.ndarray, hinge: int) -> tuple[float, ...]:
    """l and theta of one hinge; then its edge, the edges to v2 and to v3, and both normals, not unit."""
    a, b, c, d = hinges[hinge, 0], hinges[hinge, 1], hinges[hinge, 2], hinges[hinge, 3]
    e0, e1, e2 = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    c0, c1, c2 = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    d0, d1, d2 = vertices[d, 0] - vertices[a, 0], vertices[d, 1] - vertices[a, 1], vertices[d, 2] - vertices[a, 2]
    length = max(np.sqrt(e0 * e0 + e1 * e1 + e2 * e2), 1e-30)
    m0, m1, m2 = e1 * c2 - e2 * c1, e2 * c0 - e0 * c2, e0 * c1 - e1 * c0
    n0, n1, n2 = d1 * e2 - d2 * e1, d2 * e0 - d0 * e2, d0 * e1 - d1 * e0
    sine = e0 * (m1 * n2 - m2 * n1) + e1 * (m2 * n0 - m0 * n2) + e2 * (m0 * n1 - m1 * n0)
    angle = np.arctan2(sine / length, m0 * n0 + m1 * n1 + m2 * n2)
    return length, angle, e0, e1, e2, c0, c1, c2, d0, d1, d2, m0, m1, m2, n0, n1, n2


@compiled_with_fused_products
def _bend_derivative(vertices: np.ndarray, hinges: np.ndarray, hinge: int, derivative: np.ndarray) -> float:
    """l theta [m] of one hinge; fills its `derivative` (4, 3) by each of the four vertices."""
    length, angle, e0, e1, e2, c0, c1, c2, d0, d1, d2, m0, m1, m2, n0, n1, n2 = _bend(vertices, hinges, hinge)
    over_m = length / max(m0 * m0 + m1 * m1 + m2 * m2, 1e-30)
    over_n = length / max(n0 * n0 + n1 * n1 + n2 * n2, 1e-30)
    along_c, along_d = (c0 * e0 + c1 * e1 + c2 * e2) / length, (d0 * e0 + d1 * e1 + d2 * e2) / length
    for axis, e, m, n in ((0, e0, m0, n0), (1, e1, m1, n1), (2, e2, m2, n2)):
        lengthening, of_c, of_d = angle * e / length, m * over_m, n * over_n
        derivative[0, axis] = (length - along_c) * of_c + (length - along_d) * of_d - lengthening
        derivative[1, axis] = along_c * of_c + along_d * of_d + lengthening
        derivative[2, axis] = -length * of_c
        derivative[3, axis] = -length * of_d
    return length * angle


@compiled_with_fused_products
def _add_gradient(
    vertices: np.ndarray,
    hinges: np.ndarray,
    stiffness: np.ndarray,
    garment: np.ndarray,
    energies: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add to the `energies` (garments,) [J], and to their `gradient` (vertices, 3) [N] where it has rows.

    `stiffness` (hinges,) is in [J/m^2].
    """
    derivative = np.empty((4, 3))
    for hinge in range(len(hinges)):
        if not len(gradient):
            length, angle = _bend(vertices, hinges, hinge)[:2]
            energies[garment[hinge]] += 0.5 * stiffness[hinge] * (length * angle) ** 2
            continue
        bend = _bend_derivative(vertices, hinges, hinge, derivative)
        energies[garment[hinge]] += 0.5 * stiffness[hinge] * bend * bend
        for corner in range(4):
            for axis in range(3):
                gradient[hinges[hinge, corner], axis] += stiffness[hinge] * bend * derivative[corner, axis]


@compiled_with_fused_products
def _add_stiffness(
    vertices: np.ndarray,
    hinges: np.ndarray,
    stiffness: np.ndarray,
    slots: np.ndarray,
    positive: np.ndarray,
) -> None:
    """Add to the `positive` blocks (pairs, 3, 3) [N/m] of a stiffness."""
    derivative = np.empty((4, 3))
    for hinge in range(len(hinges)):
        _bend_derivative(vertices, hinges, hinge, derivative)
        pair = 0
        for first in range(4):
            for second in range(first, 4):
                # The matrix holds one block of two vertices, that of the lower one's row.
                low, high = (first, second) if hinges[hinge, first] < hinges[hinge, second] else (second, first)
                slot = slots[hinge, pair]
                for i in range(3):
                    pull = stiffness[hinge] * derivative[low, i]
                    for j in range(3):
                        positive[slot, i, j] += pull * derivative[high, j]
                pair += 1
