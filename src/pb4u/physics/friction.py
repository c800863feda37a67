"""Resistance to sliding on the body and on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.physics.collision import REFERENCE_AREA, Collision
from pb4u.physics.energy_term import (
    ElementBlocks,
    EnergyTerm,
    TimeStep,
    dot,
    gradient_by_autograd,
    outer,
    sum_by_garment,
)

_STANDARD_GRAVITY = 9.81
_FLOOR = 1e-4
# Share of the softening along the slip that the curvature has: with all of it, steps overshoot where slipping ends.
_SOFTENING = 0.8


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
        load: None for m g as the normal force. Given the collision term, the force with which the body carried the
            vertex at the step's start, where that is more: shoulders then hold the weight of a dress.
    """

    coefficient: float = 0.5
    radius: float = 3e-3
    smoothing: float = 1e-3
    load: Collision | None = None
    name = "friction"

    def energies(self, step: TimeStep, x: Tensor) -> Tensor:
        limit, carried, normal = self._contact(step, x)
        magnitude = self._magnitude(step, _slip(x, carried, normal))
        return self._sum(step, limit, magnitude)

    def energies_and_gradient(self, step: TimeStep, x: Tensor) -> tuple[Tensor, Tensor]:
        limit, carried, normal = self._contact(step, x)
        slip = _slip(x, carried, normal)
        magnitude = self._magnitude(step, slip)
        pull = slip * _directional(x) * (limit / magnitude)[:, None]
        return self._sum(step, limit, magnitude), pull - dot(pull, normal)[:, None] * normal

    def curvature(self, step: TimeStep, x: Tensor) -> ElementBlocks:
        """A little stiffer than exact along the slip; positive, because the smoothed norm is convex."""
        limit, carried, normal = self._contact(step, x)
        slip = _slip(x, carried, normal)
        magnitude = self._magnitude(step, slip)
        weights = _directional(x)
        along = slip * weights / magnitude[:, None]
        along = (along - dot(along, normal)[:, None] * normal).T.contiguous()
        # T W T with T = 1 - n n^T and W diagonal.
        axes = normal.T.contiguous()
        weighted = weights[:, None] * axes
        across = outer(axes, (axes * weighted).sum(0) * axes - weighted) - outer(weighted, axes)
        stiff = torch.diag(weights)[:, :, None] + across - _SOFTENING * outer(along, along)
        blocks = stiff * (limit / magnitude)
        return ElementBlocks(torch.arange(len(x), device=x.device)[:, None], blocks[:, :, None])

    def _magnitude(self, step: TimeStep, slip: Tensor) -> Tensor:
        return (dot(slip * slip, _directional(slip)) + (self.smoothing * step.dt) ** 2).sqrt()

    def _sum(self, step: TimeStep, limit: Tensor, magnitude: Tensor) -> Tensor:
        energy = limit * (magnitude - self.smoothing * step.dt)
        return sum_by_garment(energy, step.garments.vertex_garment, step.garments.garment_count)

    def _contact(self, step: TimeStep, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Friction limit mu m g (vertices,) [N], 0 where nothing touches; carried start and normal (vertices, 3)."""
        before = step.state.positions
        carried, normal = before, torch.zeros_like(before)
        touching = torch.zeros(len(before), dtype=torch.bool, device=before.device)
        distance = torch.full_like(before[:, 0], torch.inf)
        if step.contact_now is not None and step.carried is not None and step.carried_normals is not None:
            distance = torch.where(step.contact_now.touchable, step.contact_now.distance, torch.inf)
            touching = distance < self.radius
            carried, normal = step.carried, step.carried_normals
        if step.ground_height is not None:
            height = before[:, 1] - step.ground_height
            on_ground = (height < self.radius) & (height < distance)
            touching = touching | on_ground
            carried = torch.where(on_ground[:, None], before, carried)
            normal = torch.where(on_ground[:, None], before.new_tensor([0.0, 1.0, 0.0]), normal)
        force = _STANDARD_GRAVITY * step.garments.vertex_masses
        if self.load is not None and step.contact_now is not None:
            # Cloth deep inside is a fault to be mended, not a load: its force would freeze it there.
            depth = (self.load.clearance - distance).clamp(0.0, 2.0 * self.load.clearance)
            carried_load = 3.0 * self.load.weight / REFERENCE_AREA * step.garments.vertex_areas * depth**2
            force = torch.maximum(force, carried_load)
        return torch.where(touching, self.coefficient * force, 0.0), carried, normal


@dataclass(frozen=True)
class ReleasedFriction(EnergyTerm):
    """The family's released friction, for tables: not smoothed, gates on squared distances, the third axis as up.

    Sum of mu m g c |s| over vertices whose nearest face centres before and after the step both lie within
    sqrt(3e-3) m, s projected off the mean of the two normals, c^2 = 1 - cos^2(s, +Z) + 1e-4.
    """

    coefficient: float = 0.5
    squared_radius: float = 3e-3
    name = "friction"

    def energies(self, step: TimeStep, x: Tensor) -> Tensor:
        garments, now, following = step.garments, step.contact_now, step.contact_next
        if now is None or following is None or step.carried is None:
            return x.new_zeros(garments.garment_count)
        mean = now.normals + following.normals
        slip = _slip(x, step.carried, mean / mean.norm(dim=1, keepdim=True).clamp_min(torch.finfo(x.dtype).tiny))
        squared = dot(slip, slip)
        safe = squared.clamp_min(torch.finfo(x.dtype).tiny)
        length = torch.where(squared > 0, (safe * (1.0 + _FLOOR) - slip[:, 2] ** 2).clamp_min(0.0).sqrt(), 0.0)
        near = (now.distance**2 < self.squared_radius) & (following.distance**2 < self.squared_radius)
        limit = self.coefficient * _STANDARD_GRAVITY * garments.vertex_masses
        energy = torch.where(near & now.touchable & following.touchable, limit * length, 0.0)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)

    def energies_and_gradient(self, step: TimeStep, x: Tensor) -> tuple[Tensor, Tensor]:
        return gradient_by_autograd(self, step, x)

    def curvature(self, step: TimeStep, x: Tensor) -> ElementBlocks | None:
        return None


def _directional(x: Tensor) -> Tensor:
    """(3,) weights of the squared slip along each axis: |s|^2 c^2 = s . W s."""
    return x.new_tensor([1.0 + _FLOOR, _FLOOR, 1.0 + _FLOOR])


def _slip(x: Tensor, carried: Tensor, normal: Tensor) -> Tensor:
    moved = x - carried
    return moved - dot(moved, normal)[:, None] * normal
