"""Resistance to sliding on the body and on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.physics.contact.collision import REFERENCE_AREA, Collision
from pb4u.physics.contact.planes import ContactSet
from pb4u.physics.energy_term import EnergyTerm, MeasuredTerm, dot, outer, sum_by_garment, vertex_elements
from pb4u.physics.time_step import TimeStep
from pb4u.scene.scene import STANDARD_GRAVITY, UP

_FLOOR = 1e-4
"""Share of the squared slip that always counts, so that sliding straight down costs a little (reference 2.6)."""

_SOFTENING = 0.8
"""Share of the softening along the slip that the curvature has: with all of it, steps overshoot where slipping ends."""


@dataclass(frozen=True)
class Friction(EnergyTerm):
    """Sum over touching vertices of mu m g c |s| [J], smoothed to mu m g (sqrt(c^2 |s|^2 + e^2) - e).

    s is the slip [m]: the vertex's displacement over the step less that of the body under it, without its part along
    the body's normal. c^2 = 1 - cos^2(s, up) + 1e-4 makes slipping sideways cost and sliding down nearly free.
    e = `smoothing` dt [m]. A vertex touches when its true distance to the body (or to the ground) at the step's start
    is below `radius`; so the set is known before the step and the energy is convex. Source: HOOD (Grigorev et al.
    2023); its released gate and its third axis for up are in `ReleasedFriction`.

    Args:
        coefficient: mu.
        radius: distance below which a vertex touches [m].
        smoothing: slip speed below which the vertex sticks [m/s].
        load: None for m g as the normal force. Given the collision term, the force with which the body pressed the
            vertex at the step's start, where that is more: shoulders then hold the weight of a dress.
    """

    coefficient: float = 0.5
    radius: float = 3e-3
    smoothing: float = 1e-3
    load: Collision | None = None
    name = "friction"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        limit, anchor, normal = self._sliding(step, contacts)
        magnitude = self._magnitude(step, _slip(x, anchor, normal))
        return self._sum(step, limit, magnitude)

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        limit, anchor, normal = self._sliding(step, contacts)
        slip = _slip(x, anchor, normal)
        magnitude = self._magnitude(step, slip)
        pull = slip * _directional(x) * (limit / magnitude)[:, None]
        return self._sum(step, limit, magnitude), pull - dot(pull, normal)[:, None] * normal

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return vertex_elements(step.garments)

    def curvature(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        """Second derivatives (3, 3, 1, vertices) [J/m^2]; a little stiffer than exact along the slip.

        Positive, because the smoothed norm is convex.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """
        limit, anchor, normal = self._sliding(step, contacts)
        slip = _slip(x, anchor, normal)
        magnitude = self._magnitude(step, slip)
        weights = _directional(x)
        along = slip * weights / magnitude[:, None]
        along = (along - dot(along, normal)[:, None] * normal).T.contiguous()
        # T W T with T = 1 - n n^T and W diagonal.
        axes = normal.T.contiguous()
        weighted = weights[:, None] * axes
        across = outer(axes, (axes * weighted).sum(0) * axes - weighted) - outer(weighted, axes)
        stiff = torch.diag(weights)[:, :, None] + across - _SOFTENING * outer(along, along)
        return (stiff * (limit / magnitude))[:, :, None]

    def _magnitude(self, step: TimeStep, slip: Tensor) -> Tensor:
        return (dot(slip * slip, _directional(slip)) + (self.smoothing * step.dt) ** 2).sqrt()

    def _sum(self, step: TimeStep, limit: Tensor, magnitude: Tensor) -> Tensor:
        energy = limit * (magnitude - self.smoothing * step.dt)
        return sum_by_garment(energy, step.garments.vertex_garment, step.garments.garment_count)

    def _sliding(self, step: TimeStep, contacts: ContactSet) -> tuple[Tensor, Tensor, Tensor]:
        """Friction limit mu m g (vertices,) [N], 0 where nothing touches; anchor and normal (vertices, 3)."""
        before, now = step.state.positions, contacts.now
        anchor, normal = before, torch.zeros_like(before)
        touching = torch.zeros(len(before), dtype=torch.bool, device=before.device)
        distance = torch.full_like(before[:, 0], torch.inf)
        if now is not None and contacts.transported is not None and contacts.transported_normals is not None:
            distance = torch.where(now.touchable, now.distance, torch.inf)
            touching = distance < self.radius
            anchor, normal = contacts.transported, contacts.transported_normals
        if step.ground_height is not None:
            height = before[:, 1] - step.ground_height
            on_ground = (height < self.radius) & (height < distance)
            touching = touching | on_ground
            anchor = torch.where(on_ground[:, None], before, anchor)
            normal = torch.where(on_ground[:, None], before.new_tensor(UP), normal)
        force = STANDARD_GRAVITY * step.garments.vertex_masses
        if self.load is not None and now is not None:
            # Cloth deep inside is a fault to be mended, not a load: its force would freeze it there.
            depth = (self.load.clearance - distance).clamp(0.0, 2.0 * self.load.clearance)
            pressed = 3.0 * self.load.weight / REFERENCE_AREA * step.garments.vertex_areas * depth**2
            force = torch.maximum(force, pressed)
        return torch.where(touching, self.coefficient * force, 0.0), anchor, normal


@dataclass(frozen=True)
class ReleasedFriction(MeasuredTerm):
    """The family's released friction, for tables: not smoothed, gates on squared distances, the third axis as up.

    Sum of mu m g c |s| over vertices whose nearest face centres before and after the step both lie within
    sqrt(3e-3) m, s projected off the mean of the two normals, c^2 = 1 - cos^2(s, +Z) + 1e-4.

    Args:
        coefficient: mu.
        squared_radius: square of the distance within which a vertex touches [m^2].
    """

    coefficient: float = 0.5
    squared_radius: float = 3e-3
    name = "friction"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments, now, following = step.garments, contacts.now, contacts.next
        if now is None or following is None or contacts.transported is None:
            return x.new_zeros(garments.garment_count)
        mean = now.normals + following.normals
        slip = _slip(
            x, contacts.transported, mean / mean.norm(dim=1, keepdim=True).clamp_min(torch.finfo(x.dtype).tiny)
        )
        squared = dot(slip, slip)
        safe = squared.clamp_min(torch.finfo(x.dtype).tiny)
        length = torch.where(squared > 0, (safe * (1.0 + _FLOOR) - slip[:, 2] ** 2).clamp_min(0.0).sqrt(), 0.0)
        near = (now.distance**2 < self.squared_radius) & (following.distance**2 < self.squared_radius)
        limit = self.coefficient * STANDARD_GRAVITY * garments.vertex_masses
        energy = torch.where(near & now.touchable & following.touchable, limit * length, 0.0)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)


def _directional(x: Tensor) -> Tensor:
    """(3,) weights of the squared slip along each axis: |s|^2 c^2 = s . W s."""
    return x.new_tensor([1.0 + _FLOOR, _FLOOR, 1.0 + _FLOOR])


def _slip(x: Tensor, anchor: Tensor, normal: Tensor) -> Tensor:
    moved = x - anchor
    return moved - dot(moved, normal)[:, None] * normal
