"""Out-of-plane bending at the edge between two faces."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.physics.contact.planes import ContactSet
from pb4u.physics.energy_term import EnergyTerm, columns, corner_pairs, dot, sum_by_garment, sum_by_vertex
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True)
class Bending(EnergyTerm):
    """Sum over hinges of k l^2 / (4 (A1 + A2)) (theta - theta0)^2 / 2 [J].

    k is the bending coefficient [J], l the current edge length [m], A1 and A2 the rest areas of the two faces [m^2],
    theta = atan2(e . (n0 x n1), n0 . n1) their dihedral angle [rad]. Source: SNUG and HOOD, where theta0 = 0.

    Args:
        rest_angles: whether theta0 is the angle of the rest shape instead of 0.
    """

    rest_angles: bool = False
    name = "bending"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        length, angle = _length_and_angle(x, garments.hinges)
        return self._energies(garments, length * (angle - self._rest(garments)))

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        garments = step.garments
        bend, derivative = self._bend_and_derivative(garments, x)
        pull = _stiffness(garments) * bend
        forces = torch.cat([pull * d for d in derivative], dim=1)
        return self._energies(garments, bend), sum_by_vertex(forces, garments.hinges.T.reshape(-1), len(x))

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return step.garments.hinges

    def curvature(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        """Gauss-Newton matrices (3, 3, pairs, hinges) [J/m^2]: k times the outer product of d(l (theta - theta0))/dx.

        Args:
            step: the time step.
            contacts: not read.
            x: (vertices, 3) [m] next positions.
        """
        garments = step.garments
        _, derivative = self._bend_and_derivative(garments, x)
        root = _stiffness(garments).sqrt()
        scaled = [root * d for d in derivative]
        pairs = corner_pairs(4)
        blocks = x.new_empty((3, 3, len(pairs), len(root)))
        for k, (i, j) in enumerate(pairs):
            torch.mul(scaled[i][:, None], scaled[j][None], out=blocks[:, :, k])
        return blocks

    def _rest(self, garments: PackedGarments) -> Tensor | float:
        return dihedral_angles(garments.rest_positions, garments.hinges) if self.rest_angles else 0.0

    def _energies(self, garments: PackedGarments, bend: Tensor) -> Tensor:
        energy = 0.5 * _stiffness(garments) * bend * bend
        return sum_by_garment(energy, garments.hinge_garment, garments.garment_count)

    def _bend_and_derivative(self, garments: PackedGarments, x: Tensor) -> tuple[Tensor, list[Tensor]]:
        """l (theta - theta0) [m] of each hinge and its derivative (3, hinges) by each of the four vertices."""
        x0, x1, x2, x3 = columns(x, garments.hinges.T.reshape(-1)).reshape(3, 4, -1).unbind(1)
        edge, to_x2, to_x3 = x1 - x0, x2 - x0, x3 - x0
        length = _inner(edge, edge).sqrt().clamp_min(_tiny(x))
        along = edge / length
        n0, n1 = torch.linalg.cross(edge, to_x2, dim=0), torch.linalg.cross(to_x3, edge, dim=0)
        sine = _inner(along, torch.linalg.cross(n0, n1, dim=0))
        angle = torch.atan2(sine, _inner(n0, n1)) - self._rest(garments)
        m0 = n0 * (length / _inner(n0, n0).clamp_min(_tiny(x)))
        m1 = n1 * (length / _inner(n1, n1).clamp_min(_tiny(x)))
        part2, part3 = _inner(to_x2, along), _inner(to_x3, along)
        lengthening = angle * along
        by_x0 = (length - part2) * m0 + (length - part3) * m1 - lengthening
        by_x1 = part2 * m0 + part3 * m1 + lengthening
        return length * angle, [by_x0, by_x1, -length * m0, -length * m1]


def dihedral_angles(x: Tensor, hinges: Tensor) -> Tensor:
    """Angles (hinges,) [rad] between the two faces at each hinge; 0 where flat.

    Args:
        x: (vertices, 3) [m] positions.
        hinges: (hinges, 4) int64 vertices: edge v0 v1, opposite v2, opposite v3.
    """
    return _length_and_angle(x, hinges)[1]


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
