"""Keeping cloth out of bodies and of the ground: a cubic penalty on depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64, compiled
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.energy_term import (
    CompiledTerm,
    EnergyTerm,
    Tangent,
    constant,
    sum_by_garment,
    vertex_elements,
)
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern
from pb4u.physics.time_step import TimeStep
from pb4u.scene.scene import STANDARD_GRAVITY, UP

REFERENCE_AREA = 1.6e-4
"""Mean vertex area [m^2] of the family's T-shirt at 11,000 triangles."""

STIFF_CONTACT_WEIGHT = 5e5
"""Weight of the term, the highest that the family trains with, where it has to push cloth out of the body.

With the usual 5e3 a tight waistband of denim presses the cloth under it 24 mm into the body, and no push of single
vertices moves both.
"""

_EXACT_DEPTH = 5e-4
"""Depth [m] up to which the curvature is exact: a quarter of the default clearance, where resting cloth lies."""


_DEEPER = 2.0
"""Factor by which a tangent may be laid deeper than it was: the force of a depth twice as large is four times that."""

_TWICE = 2.0
"""Multiple of its own weight that a vertex' first contact is taken to bear, where nothing better is known."""


_Planes = tuple[np.ndarray, np.ndarray, np.ndarray]


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

    def compiled(self, step: TimeStep, contacts: ContactSet) -> CompiledCollision:
        return CompiledCollision(self, step)

    def _vertex_weight(self, step: TimeStep) -> Tensor:
        return (self.weight / REFERENCE_AREA) * step.garments.vertex_areas

    def _depths(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        """Depth below the clearance (vertices,) [m], at least 0, and normal, of the bodies and of the ground."""
        for planes in (contacts.next, contacts.opposite):
            if planes is not None:
                depth = (self.clearance - planes.signed_distance(x)).clamp_min(0.0)
                yield torch.where(planes.touchable, depth, 0.0), planes.normals
        if step.ground_height is not None:
            up = constant(UP, x.dtype, x.device).expand_as(x)
            yield (self.clearance - (x[:, 1] - step.ground_height)).clamp_min(0.0), up


class CompiledCollision(CompiledTerm, Collision):
    """`Collision` compiled for one step, with its second derivative: exact to half a millimetre's depth, softer beyond.

    Softer, so that one Newton step brings a deep vertex to the surface instead of half way.

    Args:
        term: what it stands for.
        step: the time step.
    """

    def __init__(self, term: Collision, step: TimeStep) -> None:
        super().__init__(term.weight, term.clearance)
        self._weight = self._vertex_weight(step).numpy()
        self._garment = step.garments.vertex_garment.numpy()
        self._ground: _Planes | None = None
        if step.ground_height is not None:
            up = np.broadcast_to(np.array(UP), (len(self._weight), 3))
            everywhere = np.ones(len(self._weight), dtype=bool)
            self._ground = (step.ground_height * up, np.ascontiguousarray(up), everywhere)

    def add(self, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray) -> None:
        for planes in self._planes(contacts):
            _add_gradient(x, *planes, self._weight, self.clearance, self._garment, energies, gradient)

    def add_stiffness(self, contacts: ContactSet, x: np.ndarray, slots: np.ndarray, stiffness: Stiffness) -> None:
        for planes in self._planes(contacts):
            _add_stiffness(x, *planes, self._weight, self.clearance, slots, stiffness.positive)

    def tangents(self, step: TimeStep, contacts: ContactSet, x: np.ndarray, pattern: StiffnessPattern) -> list[Tangent]:
        loads = _TWICE * STANDARD_GRAVITY * step.garments.vertex_masses.numpy()
        bearing = np.sqrt(loads / np.maximum(3.0 * self._weight, 1e-300))
        slots = pattern.slots[self.name][:, 0]
        return [
            _tangent(x, planes, self._weight * pattern.free, self.clearance, bearing, slots)
            for planes in self._planes(contacts)
        ]

    def _planes(self, contacts: ContactSet) -> Iterator[_Planes]:
        """Points, normals and whether the plane counts, of the bodies and of the ground."""
        for planes in (contacts.next, contacts.opposite):
            if planes is not None:
                yield as_float64(planes.points), as_float64(planes.normals), planes.touchable.numpy()
        if self._ground is not None:
            yield self._ground


def _tangent(
    vertices: np.ndarray,
    planes: _Planes,
    weight: np.ndarray,
    clearance: float,
    bearing: np.ndarray,
    slots: np.ndarray,
) -> Tangent:
    """Contact of each of the `vertices` (vertices, 3) [m] with one plane, as in `_follow`."""
    points, normals, counts = planes
    depths = clearance - np.einsum("vi,vi->v", vertices - points, normals)
    law = np.where(counts, weight, 0.0), normals, depths, bearing, slots
    laid = np.maximum(depths, 0.0)
    stiffnesses = 3.0 * weight * (laid + np.minimum(laid, _EXACT_DEPTH))
    return lambda moves, stiffness, *forces: _follow(moves, *law, laid, stiffnesses, stiffness.positive, *forces)


@compiled
def _add_gradient(
    vertices: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    counts: np.ndarray,
    weight: np.ndarray,
    clearance: float,
    garment: np.ndarray,
    energies: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add to the `energies` (garments,) [J], and to their `gradient` (vertices, 3) [N] where it has rows.

    Each of the `vertices` (vertices, 3) [m] has a plane through `points` (vertices, 3) [m] with `normals` (vertices, 3)
    where it `counts` (vertices,), and a `weight` (vertices,) [J/m^3].
    """
    for row in range(len(vertices)):
        if not counts[row]:
            continue
        depth = clearance
        for axis in range(3):
            depth -= (vertices[row, axis] - points[row, axis]) * normals[row, axis]
        if depth > 0.0:
            energies[garment[row]] += weight[row] * depth**3
            for axis in range(3 if len(gradient) else 0):
                gradient[row, axis] -= 3.0 * weight[row] * depth * depth * normals[row, axis]


@compiled
def _add_stiffness(
    vertices: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    counts: np.ndarray,
    weight: np.ndarray,
    clearance: float,
    slots: np.ndarray,
    positive: np.ndarray,
) -> None:
    """Add to the `positive` blocks (pairs, 3, 3) [N/m] of a stiffness; the rest as in `_add_gradient`."""
    for row in range(len(vertices)):
        if not counts[row]:
            continue
        depth = clearance
        for axis in range(3):
            depth -= (vertices[row, axis] - points[row, axis]) * normals[row, axis]
        if depth > 0.0:
            stiffness = 3.0 * weight[row] * (depth + min(depth, _EXACT_DEPTH))
            for i in range(3):
                for j in range(3):
                    positive[slots[row, 0], i, j] += stiffness * normals[row, i] * normals[row, j]


@compiled
def _follow(
    moves: np.ndarray,
    weight: np.ndarray,
    normals: np.ndarray,
    depths: np.ndarray,
    bearing: np.ndarray,
    slots: np.ndarray,
    laid: np.ndarray,
    stiffnesses: np.ndarray,
    positive: np.ndarray,
    gradient: np.ndarray,
    missed: np.ndarray,
) -> None:
    """Lay the tangents of all vertices where `moves` lead, as in `Tangent.follow`.

    A vertex that begins at `depths` (vertices,) [m], negative above the clearance, has the tangent of the depth where
    it is `laid` (vertices,) [m], with these `stiffnesses` (vertices,) [N/m]; both are changed. The rest as above.
    """
    for row in range(len(moves)):
        if weight[row] == 0.0:
            continue
        depth = depths[row]
        for axis in range(3):
            depth -= moves[row, axis] * normals[row, axis]
        if depth <= 0.0 and laid[row] == 0.0:
            continue
        deep, old, stiff = max(depth, 0.0), laid[row], stiffnesses[row]
        wrong = 3.0 * weight[row] * (old * old - deep * deep) - stiff * (old - depth)
        new = min(deep, max(_DEEPER * old, bearing[row]))
        stiffer = 6.0 * weight[row] * new
        before = stiff * (old - depths[row]) - 3.0 * weight[row] * old * old
        after = stiffer * (new - depths[row]) - 3.0 * weight[row] * new * new
        laid[row], stiffnesses[row] = new, stiffer
        for i in range(3):
            missed[row, i] += wrong * normals[row, i]
            gradient[row, i] += (after - before) * normals[row, i]
            for j in range(3):
                positive[slots[row], i, j] += (stiffer - stiff) * normals[row, i] * normals[row, j]
