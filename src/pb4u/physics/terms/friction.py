"""Resistance to sliding on the body and on the ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64, compiled, compiled_into_callers
from pb4u.environment import STANDARD_GRAVITY, UP
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.collision import Collision
from pb4u.physics.terms.element_loops import GRADIENT, SECOND, VALUE, Record, each_vertex, element_loops, vertex_record
from pb4u.physics.terms.energy_term import EnergyTerm, Tangent, constant, dot, sum_by_garment
from pb4u.physics.terms.stiffness_matrix import StiffnessPattern
from pb4u.physics.time_step import TimeStep

SLIDING_DOWN = 1e-4
"""Share of the squared slip that always counts, so that sliding straight down costs a little (reference 2.6)."""

SOFTENING = 0.8
"""Share of the softening along the slip that the curvature has: with all of it, steps overshoot where slipping ends."""


@compiled_into_callers
def _slip_at(x: np.ndarray, numbers: np.ndarray, row: int) -> tuple[float, float, float, float]:
    """Slip [m] of a vertex along each axis, and its weighted, smoothed length [m]."""
    rest, n0, n1, n2 = numbers[row, 1], numbers[row, 5], numbers[row, 6], numbers[row, 7]
    s0, s1, s2 = x[row, 0] - numbers[row, 2], x[row, 1] - numbers[row, 3], x[row, 2] - numbers[row, 4]
    height = s0 * n0 + s1 * n1 + s2 * n2
    s0, s1, s2 = s0 - height * n0, s1 - height * n1, s2 - height * n2
    w0, w1, w2 = numbers[row, 8], numbers[row, 9], numbers[row, 10]
    return s0, s1, s2, np.sqrt(w0 * s0 * s0 + w1 * s1 * s1 + w2 * s2 * s2 + rest * rest)


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
    """One vertex; its numbers are the friction limit [N] (0 without touch), smoothing [m], anchor [m], normal, weights.

    The second derivative is T W T - softening a a^T, a little stiffer than exact along the slip; T = 1 - n n^T, W the
    diagonal of the weights, a the pull T W s over the length of s. Positive, because the smoothed norm is convex.
    """
    limit = numbers[vertex, 0]
    if not limit > 0.0:
        for i in range(3 if wanted != VALUE else 0):
            forces[0, i] = 0.0
            for j in range(3 if wanted == SECOND else 0):
                blocks[0, i, j] = 0.0
        return 0.0
    s0, s1, s2, magnitude = _slip_at(x, numbers, vertex)
    energy = limit * (magnitude - numbers[vertex, 1])
    if wanted == VALUE:
        return energy
    weights = numbers[vertex, 8], numbers[vertex, 9], numbers[vertex, 10]
    along = (weights[0] * s0 / magnitude, weights[1] * s1 / magnitude, weights[2] * s2 / magnitude)
    inward, both = 0.0, 0.0
    for axis in range(3):
        normal = numbers[vertex, 5 + axis]
        inward += along[axis] * normal
        both += weights[axis] * normal * normal
    for axis in range(3):
        forces[0, axis] = limit * (along[axis] - inward * numbers[vertex, 5 + axis])
    if wanted == GRADIENT:
        return energy
    for i in range(3):
        for j in range(3):
            across = (both - weights[i] - weights[j]) * numbers[vertex, 5 + i] * numbers[vertex, 5 + j]
            if i == j:
                across += weights[i]
            softened = SOFTENING * forces[0, i] * forces[0, j] / (limit * limit)
            blocks[0, i, j] = (across - softened) * limit / magnitude
    return energy


@dataclass(frozen=True)
class Friction(EnergyTerm):
    """The paper's: sum over touching vertices of mu N c |s| [J], smoothed to mu N (sqrt(c^2 |s|^2 + e^2) - e) [J].

    mu is the vertex's coefficient of friction, s the slip [m]: its displacement over the step less that of the body
    under it, without its part along the body's normal. N = m g. c^2 = 1 - cos^2(s, up) + 1e-4 makes slipping sideways
    cost and sliding down nearly free. e = `smoothing` dt [m]. A vertex touches when its true distance to the body (or
    to the ground) at the step's start is below `radius`; so the set is known before the step and the energy is convex.
    Source: HOOD (Grigorev et al. 2023); its released form is in `measures/released_energies.py`.

    Args:
        radius: distance below which a vertex touches [m].
        smoothing: slip speed below which the vertex sticks [m/s].
        load: None to use only the weight as the normal force. With the collision term, the contact force on the vertex
            at the step's start is used if it is larger: shoulders then hold the weight of a dress.

    Attributes:
        law: by which a run names it.
        weights: W of the squared slip along each axis, |s|^2 c^2 = s . W s.
    """

    radius: float = 3e-3
    smoothing: float = 1e-3
    load: Collision | None = None
    name = "friction"
    law: ClassVar[str] = "paper"
    weights: ClassVar[tuple[float, float, float]] = (1.0 + SLIDING_DOWN, SLIDING_DOWN, 1.0 + SLIDING_DOWN)
    loops = element_loops(_vertex, 1)

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        limit, anchor, normal = self._sliding(step, contacts)
        slip, rest = slip_across(x, anchor, normal), self.smoothing * step.dt
        magnitude = (dot(slip * slip, constant(self.weights, x.dtype, x.device)) + rest**2).sqrt()
        return sum_by_garment(limit * (magnitude - rest), step.garments.vertex_garment, step.garments.garment_count)

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return each_vertex(step.garments)

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        limit, anchor, normal = map(as_float64, self._sliding(step, contacts))
        weights = np.tile(self.weights, (len(limit), 1))
        records = (vertex_record(step.garments, limit, self.smoothing * step.dt, anchor, normal, weights),)
        return lambda _: records

    def tangents(
        self, step: TimeStep, x: np.ndarray, records: Sequence[Record], pattern: StiffnessPattern
    ) -> list[Tangent]:
        (record,) = records
        sliding = record.numbers * np.where(pattern.free, 1.0, 0.0)[:, None]
        slots, lengths = pattern.slots[self.name][:, 0], np.zeros(len(x))
        return [
            lambda moves, stiffness, *forces: _follow(x, moves, sliding, slots, lengths, stiffness.positive, *forces)
        ]

    def _sliding(self, step: TimeStep, contacts: ContactSet) -> tuple[Tensor, Tensor, Tensor]:
        """Friction limit mu N (vertices,) [N], 0 where nothing touches; anchor and normal (vertices, 3)."""
        before, now = step.state.positions, contacts.now
        anchor, normal = before, torch.zeros_like(before)
        touching = torch.zeros(len(before), dtype=torch.bool, device=before.device)
        distance = torch.full_like(before[:, 0], torch.inf)
        if now is not None and contacts.transported is not None and contacts.transported_normals is not None:
            distance = torch.where(now.touchable, now.distance, torch.inf)
            touching = distance < self.radius
            anchor, normal = contacts.transported, contacts.transported_normals
        if step.environment.ground is not None:
            height = before[:, 1] - step.environment.ground
            on_ground = (height < self.radius) & (height < distance)
            touching = touching | on_ground
            distance = torch.where(on_ground, height, distance)
            anchor = torch.where(on_ground[:, None], before, anchor)
            normal = torch.where(on_ground[:, None], constant(UP, before.dtype, before.device), normal)
        pressed = torch.zeros_like(distance) if self.load is None else self.load.pressing(step, distance)
        force = self._normal_force(step, pressed)
        return torch.where(touching, step.garments.friction * force, 0.0), anchor, normal

    def _normal_force(self, step: TimeStep, pressed: Tensor) -> Tensor:
        """Normal force (vertices,) [N] of vertices that touch, of which the body `pressed` (vertices,) [N]."""
        return torch.maximum(STANDARD_GRAVITY * step.garments.vertex_masses, pressed)


class CoulombFriction(Friction):
    """Coulomb's: sum over touching vertices of mu N (sqrt(|s|^2 + e^2) - e) [J], alike in all directions.

    N is the force with which the body, or the ground, pressed the vertex at the step's start: at rest the part of the
    weight along the normal, in free fall nothing. A new contact slips for one step. What holds a share r of
    its limit creeps by `smoothing` r / sqrt(1 - r^2) [m/s]. Cloth that was pushed out of the body after a step keeps
    its contact force from before the push; otherwise a tight waistband would lose most of its friction.
    """

    law = "coulomb"
    weights = (1.0, 1.0, 1.0)

    def _normal_force(self, step: TimeStep, pressed: Tensor) -> Tensor:
        load = step.state.load
        return pressed if load is None else torch.maximum(pressed, load)


FRICTION_LAWS = {law.law: law for law in (Friction, CoulombFriction)}
"""Terms of friction by the name that `friction_law` of a run takes."""


def slip_across(x: Tensor, anchor: Tensor, normal: Tensor) -> Tensor:
    """Displacements (vertices, 3) [m] from `anchor` to `x` (vertices, 3) [m] without their parts along unit `normal`s.

    Args:
        x: (vertices, 3) [m].
        anchor: (vertices, 3) [m] where each vertex would be if it did not slip.
        normal: (vertices, 3) of the surface that it slips on.
    """
    slip = x - anchor
    return slip - dot(slip, normal)[:, None] * normal


@compiled
def _follow(
    vertices: np.ndarray,
    moves: np.ndarray,
    numbers: np.ndarray,
    slots: np.ndarray,
    lengths: np.ndarray,
    positive: np.ndarray,
    gradient: np.ndarray,
    missed: np.ndarray,
) -> None:
    """Lay the tangents of all vertices where `moves` lead, as a `Tangent` does.

    The force is taken to be T W s times the limit over a smoothed length (vertices,) [m] of the slip, 0 where it is the
    tangent of `_vertex` yet: that length is changed to the one where the moves lead. The rest as there.
    """
    limit, normal = numbers[:, 0], numbers[:, 5:8]
    pull, there = np.empty(3), np.empty(3)
    reached = vertices + moves
    for row in range(len(moves)):
        if not limit[row] > 0.0:
            continue
        s0, s1, s2, here = _slip_at(vertices, numbers, row)
        t0, t1, t2, length = _slip_at(reached, numbers, row)
        weights = numbers[row, 8:]
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
            lengths[row], soft = here, SOFTENING * limit[row] / here**3
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
