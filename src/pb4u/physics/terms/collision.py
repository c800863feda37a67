"""Keeping cloth out of bodies and of the ground: a cubic penalty on depth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64, compiled
from pb4u.environment import STANDARD_GRAVITY, UP
from pb4u.physics.contact.contact_set import ContactPlanes, ContactSet
from pb4u.physics.terms.element_loops import SECOND, VALUE, Record, each_vertex, element_loops, vertex_record
from pb4u.physics.terms.energy_term import EnergyTerm, Tangent, sum_by_garment
from pb4u.physics.terms.stiffness_matrix import StiffnessPattern
from pb4u.physics.time_step import TimeStep

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
    """One vertex; its numbers are its weight [J/m^3], the clearance [m], and a point [m] and the normal of its plane.

    The second derivative is exact to half a millimetre's depth and softer beyond, so that one Newton step brings a deep
    vertex to the surface instead of half way.
    """
    weight, depth = numbers[vertex, 0], numbers[vertex, 1]
    for axis in range(3):
        depth -= (x[vertex, axis] - numbers[vertex, 2 + axis]) * numbers[vertex, 5 + axis]
    depth = max(depth, 0.0) if weight > 0.0 else 0.0
    energy = weight * depth * depth * depth
    if wanted == VALUE:
        return energy
    pull = 3.0 * weight * depth * depth
    stiffness = 3.0 * weight * (depth + min(depth, _EXACT_DEPTH))
    for i in range(3):
        forces[0, i] = -pull * numbers[vertex, 5 + i]
        if wanted == SECOND:
            for j in range(3):
                blocks[0, i, j] = stiffness * numbers[vertex, 5 + i] * numbers[vertex, 5 + j]
    return energy


@dataclass(frozen=True)
class Collision(EnergyTerm):
    """Sum over vertices of w A_i / A_ref max(eps - d_i, 0)^3 [J], with d_i the signed distance to the surface [m].

    Weighing by the vertex area A_i makes it an integral over the cloth, the same at every resolution; A_ref is
    `REFERENCE_AREA`, where it equals the released per-vertex sum. Source: SNUG; cubic since HOOD.

    Args:
        weight: w [J/m^3]; the family trains with 5e3 to 5e5 and evaluates with 5e3.
        clearance: eps, the distance below which it acts [m].
    """

    weight: float = 5e3
    clearance: float = 2e-3
    name = "collision"
    pushes_apart = True
    loops = element_loops(_vertex, 1)

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        weight = self._vertex_weight(step)
        energy = torch.zeros_like(x[:, 0])
        for depth in self._depths(step, contacts, x):
            energy = energy + weight * depth**3
        return sum_by_garment(energy, step.garments.vertex_garment, step.garments.garment_count)

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return each_vertex(step.garments)

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        garments, weight = step.garments, as_float64(self._vertex_weight(step))
        every, owners = each_vertex(garments).numpy(), garments.vertex_garment.numpy()
        ground = []
        if step.environment.ground is not None:
            up = np.tile(UP, (len(weight), 1))
            ground = [vertex_record(garments, weight, self.clearance, step.environment.ground * up, up)]

        @lru_cache(maxsize=2)  # a Newton step compares several places with the same planes
        def record(planes: ContactPlanes) -> Record:
            points, normals = as_float64(planes.points), as_float64(planes.normals)
            numbers = _plane_numbers(weight, planes.touchable.numpy(), self.clearance, points, normals)
            return Record(every, owners, numbers)

        def records(at: ContactSet) -> Sequence[Record]:
            return [*(record(planes) for planes in (at.next, at.opposite) if planes is not None), *ground]

        return records

    def tangents(
        self, step: TimeStep, x: np.ndarray, records: Sequence[Record], pattern: StiffnessPattern
    ) -> list[Tangent]:
        loads = _TWICE * STANDARD_GRAVITY * as_float64(step.garments.vertex_masses)
        weight, slots = as_float64(self._vertex_weight(step)), pattern.slots[self.name][:, 0]
        bearing = np.sqrt(loads / np.maximum(3.0 * weight, 1e-300))
        return [_tangent(x, record.numbers, pattern.free, bearing, slots) for record in records]

    def pressing(self, step: TimeStep, distance: Tensor) -> Tensor:
        """Forces (vertices,) [N] with which bodies press vertices at signed distances from them.

        Cloth deep inside is a fault to be mended, not a load: friction would freeze it there.

        Args:
            step: the time step.
            distance: (vertices,) [m], inf where nothing is touched.
        """
        depth = (self.clearance - distance).clamp(0.0, 2.0 * self.clearance)
        return 3.0 * self.weight / REFERENCE_AREA * step.garments.vertex_areas * depth**2

    def _vertex_weight(self, step: TimeStep) -> Tensor:
        return (self.weight / REFERENCE_AREA) * step.garments.vertex_areas

    def _depths(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Iterator[Tensor]:
        """Depth below the clearance (vertices,) [m], at least 0, of the bodies and of the ground."""
        for planes in (contacts.next, contacts.opposite):
            if planes is not None:
                depth = (self.clearance - planes.signed_distance(x)).clamp_min(0.0)
                yield torch.where(planes.touchable, depth, 0.0)
        if step.environment.ground is not None:
            yield (self.clearance - (x[:, 1] - step.environment.ground)).clamp_min(0.0)


@compiled
def _plane_numbers(
    weight: np.ndarray, touchable: np.ndarray, clearance: float, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Numbers (vertices, 8) that `_vertex` reads of vertices with one plane each."""
    numbers = np.empty((len(weight), 8))
    for row in range(len(weight)):
        numbers[row, 0], numbers[row, 1] = weight[row] * touchable[row], clearance
        for axis in range(3):
            numbers[row, 2 + axis], numbers[row, 5 + axis] = points[row, axis], normals[row, axis]
    return numbers


def _tangent(x: np.ndarray, planes: np.ndarray, free: np.ndarray, bearing: np.ndarray, slots: np.ndarray) -> Tangent:
    """Contact of each vertex of `x` (vertices, 3) [m] that is free with one plane, as in `_follow`."""
    weight, normals = planes[:, 0] * free, np.ascontiguousarray(planes[:, 5:])
    depths = planes[:, 1] - np.einsum("vi,vi->v", x - planes[:, 2:5], normals)
    law = weight, normals, depths, bearing, slots
    laid = np.maximum(depths, 0.0)
    stiffnesses = 3.0 * weight * (laid + np.minimum(laid, _EXACT_DEPTH))
    return lambda moves, stiffness, *forces: _follow(moves, *law, laid, stiffnesses, stiffness.positive, *forces)


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
    """Lay the tangents of all vertices where `moves` lead, as a `Tangent` does.

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
