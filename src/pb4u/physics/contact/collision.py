"""Keeping cloth out of bodies and of the ground: a cubic penalty on depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.physics.contact.planes import ContactSet
from pb4u.physics.energy_term import EnergyTerm, MeasuredTerm, dot, outer, sum_by_garment, vertex_elements
from pb4u.physics.time_step import TimeStep
from pb4u.scene.scene import UP

REFERENCE_AREA = 1.6e-4
"""Mean vertex area [m^2] of the family's T-shirt at 11,000 triangles."""

_EXACT_DEPTH = 5e-4
"""Depth [m] up to which the curvature is exact: a quarter of the default clearance, where resting cloth lies."""


@dataclass(frozen=True)
class Collision(EnergyTerm):
    """Sum over vertices of w A_i / A_ref max(eps - d_i, 0)^3 [J], with d_i the signed distance to the surface [m].

    Weighing by the vertex area A_i makes it an integral over the cloth, the same at every resolution; A_ref is
    `REFERENCE_AREA`, where it equals the released per-vertex sum. Source: SNUG; cubic since HOOD.

    Args:
        weight: w [J/m^3]; the family trains with 5e3 to 5e5 and evaluates with 5e3.
        clearance: eps, the distance at which it begins [m].
    """

    weight: float = 5e3
    clearance: float = 2e-3
    name = "collision"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        weight = self._vertex_weight(step)
        energy = torch.zeros_like(x[:, 0])
        for depth, _ in self._depths(step, contacts, x):
            energy = energy + weight * depth**3
        return sum_by_garment(energy, step.garments.vertex_garment, step.garments.garment_count)

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        weight = self._vertex_weight(step)
        energy, gradient = torch.zeros_like(x[:, 0]), torch.zeros_like(x)
        for depth, normal in self._depths(step, contacts, x):
            energy = energy + weight * depth**3
            gradient = gradient - (3.0 * weight * depth * depth)[:, None] * normal
        return sum_by_garment(energy, step.garments.vertex_garment, step.garments.garment_count), gradient

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return vertex_elements(step.garments)

    def curvature(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        """Second derivatives (3, 3, 1, vertices) [J/m^2]; exact to a depth of half a millimetre, softer beyond it.

        Softer, so that one Newton step brings a deep vertex to the surface instead of half way.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """
        weight = self._vertex_weight(step)
        blocks = x.new_zeros((3, 3, len(x)))
        for depth, normal in self._depths(step, contacts, x):
            stiffness = 3.0 * weight * (depth + depth.clamp_max(_EXACT_DEPTH))
            axes = normal.T.contiguous()
            blocks = blocks + outer(stiffness * axes, axes)
        return blocks[:, :, None]

    def _vertex_weight(self, step: TimeStep) -> Tensor:
        return (self.weight / REFERENCE_AREA) * step.garments.vertex_areas

    def _depths(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        """Depth below the clearance (vertices,) [m], at least 0, and normal, of the bodies and of the ground."""
        for planes in (contacts.next, contacts.opposite):
            if planes is not None:
                depth = (self.clearance - planes.signed_distance(x)).clamp_min(0.0)
                yield torch.where(planes.touchable, depth, 0.0), planes.normals
        if step.ground_height is not None:
            up = x.new_tensor(UP).expand_as(x)
            yield (self.clearance - (x[:, 1] - step.ground_height)).clamp_min(0.0), up


@dataclass(frozen=True)
class ReleasedCollision(MeasuredTerm):
    """The family's released collision, for tables: w max(eps - d_i, 0)^3 summed over vertices, without area or ground.

    d_i is the height over the plane, at t+1, of the face whose centre was nearest at t.

    Args:
        weight: w [J/m^3].
        clearance: eps, the distance at which it begins [m].
    """

    weight: float = 5e3
    clearance: float = 2e-3
    name = "collision"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments, planes, normal = step.garments, contacts.now, contacts.transported_normals
        if planes is None or step.bodies is None or normal is None:
            return x.new_zeros(garments.garment_count)
        centre = planes.transported(step.bodies.following).to(x)
        depth = (self.clearance - dot(x - centre, normal)).clamp_min(0.0)
        energy = torch.where(planes.touchable, self.weight * depth**3, 0.0)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)
