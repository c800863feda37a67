"""Resistance to sliding on the body and on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64, compiled
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.collision import REFERENCE_AREA, Collision
from pb4u.physics.terms.energy_term import (
    CompiledTerm,
    EnergyTerm,
    Tangent,
    constant,
    dot,
    sum_by_garment,
    vertex_elements,
)
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern
from pb4u.physics.time_step import TimeStep
from pb4u.scene.scene import STANDARD_GRAVITY, UP

SLIDING_DOWN = 1e-4
"""Share of the squared slip that always counts, so that sliding straight down costs a little (reference 2.6)."""

SOFTENING = 0.8
"""Share of the softening along the slip that the curvature has: with all of it, steps overshoot where slipping ends."""


@dataclass(frozen=True)
class Friction(EnergyTerm):
    """Sum over touching vertices of mu m g c |s| [J], smoothed to mu m g (sqrt(c^2 |s|^2 + e^2) - e).

    s is the slip [m]: the vertex's displacement over the step less that of the body under it, without its part along
    the body's normal. c^2 = 1 - cos^2(s, up) + 1e-4 makes slipping sideways cost and sliding down nearly free.
    e = `smoothing` dt [m]. A vertex touches when its true distance to the body (or to the ground) at the step's start
    is below `radius`; so the set is known before the step and the energy is convex. Source: HOOD (Grigorev et al.
    2023); its released form is in `measures/released_energies.py`.

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
        magnitude = self._magnitude(step, slip_across(x, anchor, normal))
        return self._sum(step, limit, magnitude)

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        limit, anchor, normal = self._sliding(step, contacts)
        slip = slip_across(x, anchor, normal)
        magnitude = self._magnitude(step, slip)
        pull = slip * _directional(x) * (limit / magnitude)[:, None]
        return self._sum(step, limit, magnitude), pull - dot(pull, normal)[:, None] * normal

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return vertex_elements(step.garments)

    def compiled(self, step: TimeStep, contacts: ContactSet) -> EnergyTerm:
        return CompiledFriction(self, step, contacts)

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
            distance = torch.where(on_ground, height, distance)
            anchor = torch.where(on_ground[:, None], before, anchor)
            normal = torch.where(on_ground[:, None], constant(UP, before.dtype, before.device), normal)
        force = STANDARD_GRAVITY * step.garments.vertex_masses
        if self.load is not None:
            # Cloth deep inside is a fault to be mended, not a load: its force would freeze it there.
            depth = (self.load.clearance - distance).clamp(0.0, 2.0 * self.load.clearance)
            pressed = 3.0 * self.load.weight / REFERENCE_AREA * step.garments.vertex_areas * depth**2
            force = torch.maximum(force, pressed)
        return torch.where(touching, self.coefficient * force, 0.0), anchor, normal


class CompiledFriction(CompiledTerm, Friction):
    """`Friction` compiled for one step, with its second derivative, a little stiffer than exact along the slip.

    Positive, because the smoothed norm is convex.

    Args:
        term: what it stands for.
        step: the time step.
        contacts: contacts at its start.
    """

    def __init__(self, term: Friction, step: TimeStep, contacts: ContactSet) -> None:
        super().__init__(term.coefficient, term.radius, term.smoothing, term.load)
        limit, anchor, normal = self._sliding(step, contacts)
        self._law = (
            as_float64(limit),
            as_float64(anchor),
            as_float64(normal),
            as_float64(_directional(limit)),
            self.smoothing * step.dt,
        )
        self._garment = step.garments.vertex_garment.numpy()

    def add(self, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray) -> None:
        _add_gradient(x, *self._law, self._garment, energies, gradient)

    def add_stiffness(self, contacts: ContactSet, x: np.ndarray, slots: np.ndarray, stiffness: Stiffness) -> None:
        _add_stiffness(x, *self._law, SOFTENING, slots, stiffness.positive)

    def tangents(self, step: TimeStep, contacts: ContactSet, x: np.ndarray, pattern: StiffnessPattern) -> list[Tangent]:
        limit, anchor, normal, weights, rest = self._law
        slots, lengths = pattern.slots[self.name][:, 0], np.zeros(len(x))
        law = limit * pattern.free, anchor, normal, weights, rest, SOFTENING, slots, lengths
        return [lambda moves, stiffness, *forces: _follow(x, moves, *law, stiffness.positive, *forces)]


def _directional(x: Tensor) -> Tensor:
    """(3,) weights of the squared slip along each axis: |s|^2 c^2 = s . W s."""
    return constant((1.0 + SLIDING_DOWN, SLIDING_DOWN, 1.0 + SLIDING_DOWN), x.dtype, x.device)


def slip_across(x: Tensor, anchor: Tensor, normal: Tensor) -> Tensor:
    """Ways (vertices, 3) [m] from `anchor` to `x` (vertices, 3) [m] without their parts along unit `normal`s.

    Args:
        x: (vertices, 3) [m].
        anchor: (vertices, 3) [m] where each vertex would be if it did not slip.
        normal: (vertices, 3) of the surface that it slips on.
    """
    moved = x - anchor
    return moved - dot(moved, normal)[:, None] * normal


@compiled
def _slip_at(
    vertices: np.ndarray, anchor: np.ndarray, normal: np.ndarray, weights: np.ndarray, rest: float, row: int
) -> tuple[float, float, float, float]:
    """Slip [m] of a vertex along each axis, and its smoothed length [m]."""
    s0, s1, s2 = vertices[row, 0] - anchor[row, 0], vertices[row, 1] - anchor[row, 1], vertices[row, 2] - anchor[row, 2]
    n0, n1, n2 = normal[row, 0], normal[row, 1], normal[row, 2]
    height = s0 * n0 + s1 * n1 + s2 * n2
    s0, s1, s2 = s0 - height * n0, s1 - height * n1, s2 - height * n2
    return s0, s1, s2, np.sqrt(weights[0] * s0 * s0 + weights[1] * s1 * s1 + weights[2] * s2 * s2 + rest * rest)


@compiled
def _add_gradient(
    vertices: np.ndarray,
    limit: np.ndarray,
    anchor: np.ndarray,
    normal: np.ndarray,
    weights: np.ndarray,
    rest: float,
    garment: np.ndarray,
    energies: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add to the `energies` (garments,) [J], and to their `gradient` (vertices, 3) [N] where it has rows.

    Each of the `vertices` (vertices, 3) [m] has a `limit` (vertices,) [N], an `anchor` (vertices, 3) [m] and a `normal`
    (vertices, 3); the `weights` (3,) are those of `_directional`, `rest` [m] smooths.
    """
    for row in range(len(vertices)):
        if not limit[row] > 0.0:
            continue
        s0, s1, s2, magnitude = _slip_at(vertices, anchor, normal, weights, rest, row)
        energies[garment[row]] += limit[row] * (magnitude - rest)
        if not len(gradient):
            continue
        pull = limit[row] / magnitude
        p0, p1, p2 = pull * weights[0] * s0, pull * weights[1] * s1, pull * weights[2] * s2
        inward = p0 * normal[row, 0] + p1 * normal[row, 1] + p2 * normal[row, 2]
        gradient[row, 0] += p0 - inward * normal[row, 0]
        gradient[row, 1] += p1 - inward * normal[row, 1]
        gradient[row, 2] += p2 - inward * normal[row, 2]


@compiled
def _add_stiffness(
    vertices: np.ndarray,
    limit: np.ndarray,
    anchor: np.ndarray,
    normal: np.ndarray,
    weights: np.ndarray,
    rest: float,
    softening: float,
    slots: np.ndarray,
    positive: np.ndarray,
) -> None:
    """Add to the `positive` blocks (pairs, 3, 3) [N/m] of a stiffness; the rest as in `_add_gradient`.

    T W T - softening a a^T with T = 1 - n n^T, W the diagonal of `weights` and a the pull T W s over the length of s.
    """
    along = np.empty(3)
    for row in range(len(vertices)):
        if not limit[row] > 0.0:
            continue
        s0, s1, s2, magnitude = _slip_at(vertices, anchor, normal, weights, rest, row)
        along[0], along[1], along[2] = weights[0] * s0, weights[1] * s1, weights[2] * s2
        inward, both = 0.0, 0.0
        for axis in range(3):
            inward += along[axis] * normal[row, axis]
            both += weights[axis] * normal[row, axis] * normal[row, axis]
        for axis in range(3):
            along[axis] = (along[axis] - inward * normal[row, axis]) / magnitude
        for i in range(3):
            for j in range(3):
                across = (both - weights[i] - weights[j]) * normal[row, i] * normal[row, j]
                stiff = across - softening * along[i] * along[j]
                if i == j:
                    stiff += weights[i]
                positive[slots[row, 0], i, j] += stiff * limit[row] / magnitude


@compiled
def _follow(
    vertices: np.ndarray,
    moves: np.ndarray,
    limit: np.ndarray,
    anchor: np.ndarray,
    normal: np.ndarray,
    weights: np.ndarray,
    rest: float,
    softening: float,
    slots: np.ndarray,
    lengths: np.ndarray,
    positive: np.ndarray,
    gradient: np.ndarray,
    missed: np.ndarray,
) -> None:
    """Lay the tangents of all vertices where `moves` lead, as in `Tangent.follow`.

    The force is taken to be T W s times the limit over a smoothed length (vertices,) [m] of the slip, 0 where it is the
    tangent of `_add_stiffness` yet: that length is changed to the one where the moves lead. The rest as there.
    """
    pull, there = np.empty(3), np.empty(3)
    reached = vertices + moves
    for row in range(len(moves)):
        if not limit[row] > 0.0:
            continue
        s0, s1, s2, here = _slip_at(vertices, anchor, normal, weights, rest, row)
        t0, t1, t2, length = _slip_at(reached, anchor, normal, weights, rest, row)
        pull[0], pull[1], pull[2] = weights[0] * s0, weights[1] * s1, weights[2] * s2
        there[0], there[1], there[2] = weights[0] * t0, weights[1] * t1, weights[2] * t2
        inward, outward, both, along = 0.0, 0.0, 0.0, 0.0
        for axis in range(3):
            inward += pull[axis] * normal[row, axis]
            outward += there[axis] * normal[row, axis]
            both += weights[axis] * normal[row, axis] * normal[row, axis]
        for axis in range(3):
            pull[axis] -= inward * normal[row, axis]
            there[axis] -= outward * normal[row, axis]
            along += pull[axis] * moves[row, axis]
        first, soft = lengths[row] == 0.0, 0.0
        if first:
            lengths[row], soft = here, softening * limit[row] / here**3
        change = limit[row] / length - limit[row] / lengths[row]
        lengths[row] = length
        for i in range(3):
            missed[row, i] += change * there[i] + soft * along * pull[i]
            gradient[row, i] += change * pull[i]
            for j in range(3):
                across = (both - weights[i] - weights[j]) * normal[row, i] * normal[row, j]
                if i == j:
                    across += weights[i]
                positive[slots[row], i, j] += change * across + soft * pull[i] * pull[j]
