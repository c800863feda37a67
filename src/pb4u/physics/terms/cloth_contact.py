"""Contact between cloth elements: a barrier that rises without bound as they near, and friction while they touch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.element_distance import crossing_share, gather, nearest
from pb4u.collision.jit import as_float64, compiled
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.contact.self_contact import ClothPairs, TouchingCloth
from pb4u.physics.terms.energy_term import EnergyTerm, dot
from pb4u.physics.terms.friction import SOFTENING
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True)
class ClothContact(EnergyTerm):
    """Sum over pairs of cloth elements of kappa A_p h_p m_p b(s_p) [J], b(s) = -(1 - s)^2 ln s for s < 1.

    s_p = (d_p - g_p) / h_p with d_p the distance of the two elements [m], g_p their smallest gap and h_p the difference
    between it and the distance below which they repel each other; m_p is 1, and for two edges falls to 0 where they are
    parallel. Source: the barrier of Incremental Potential Contact (Li et al. 2020) with an offset, as for the thickness
    of Codimensional IPC (Li et al. 2021).

    Args:
        stiffness: kappa [Pa]; cloth of 200 g/m^2 presses the cloth under it with 2 Pa, and then at least nine tenths of
            h_p are left; under a kilopascal half of it is left.
    """

    stiffness: float = 1e3
    name = "self_contact"
    pushes_apart = True

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        if contacts.cloth is None:
            return x.new_zeros(step.garments.garment_count)
        return _Barrier.apply(x, step, contacts, self)  # type: ignore[no-untyped-call]

    energies_and_gradient = EnergyTerm._added

    def add(
        self, step: TimeStep, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray
    ) -> None:
        cloth, owners = contacts.cloth, step.garments.vertex_garment.numpy()
        if cloth is not None:
            _add_barrier(cloth.joined(x), *_law(cloth), self.stiffness, owners, energies, gradient)

    def pair_stiffness(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> PairStiffness | None:
        """Second derivative along the line between the nearest points; the part from its rotation is left out.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """
        if contacts.cloth is None:
            return None
        points = contacts.cloth.joined(as_float64(x))
        corners, rows = _barrier_rows(points, *_law(contacts.cloth), self.stiffness)
        rows[corners >= len(x)] = 0.0
        return PairStiffness(np.where(corners < len(x), corners, 0), rows)

    def forces(self, touching: TouchingCloth) -> np.ndarray:
        """Force (pairs,) [N] between the elements of each pair.

        Args:
            touching: pairs that feel each other.
        """
        return self.stiffness * touching.areas * touching.pressures


@dataclass(frozen=True)
class ClothFriction(EnergyTerm):
    """Sum over pairs that touch at the step's start of mu_p f_p (sqrt(|s_p|^2 + e^2) - e) [J].

    mu_p is the smaller coefficient of the two, that of the cloth where a body presses it. f_p is the force [N] of the
    barrier there, s_p the slip [m] of the two nearest points over the step without its part along their normal, e =
    `smoothing` dt [m]. Lagged, so that it is known before the step and convex. Source: the friction of Incremental
    Potential Contact (Li et al. 2020).

    Args:
        smoothing: slip speed below which the elements stick [m/s].
        contact: contact term whose force presses them together.
    """

    smoothing: float = 1e-3
    contact: ClothContact = ClothContact()
    name = "self_friction"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        touching = contacts.cloth_now
        if touching is None:
            return x.new_zeros(step.garments.garment_count)
        weights, normals = torch.from_numpy(touching.weights).to(x), torch.from_numpy(touching.normals).to(x)
        slip = (weights[:, :, None] * (x - step.state.positions)[torch.from_numpy(touching.corners)]).sum(1)
        slip = slip + torch.from_numpy(touching.carried).to(x)
        across, rest = slip - dot(slip, normals)[:, None] * normals, self.smoothing * step.dt
        limit = step.garments.friction[torch.from_numpy(touching.sides)].amin(1).to(x)
        limit = limit * torch.from_numpy(self.contact.forces(touching)).to(x)
        energies = limit * ((across.square().sum(1) + rest * rest).sqrt() - rest)
        return _by_garment(step.garments, touching.sides, energies)

    energies_and_gradient = EnergyTerm._added

    def add(
        self, step: TimeStep, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray
    ) -> None:
        touching = contacts.cloth_now
        if touching is not None:
            owners = step.garments.vertex_garment.numpy()
            _add_friction(touching.sides, owners, energies, gradient, *self._sliding(step, touching, x))

    def pair_stiffness(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> PairStiffness | None:
        """Second derivative, a little stiffer than exact along the slip, as that of friction on the body.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """
        touching = contacts.cloth_now
        if touching is None:
            return None
        rows = _friction_rows(SOFTENING, *self._sliding(step, touching, as_float64(x)))
        return PairStiffness(np.concatenate([touching.corners] * 2), rows)

    def _sliding(self, step: TimeStep, touching: TouchingCloth, x: np.ndarray) -> tuple[Any, ...]:
        """What the loops over pairs read: moves (vertices, 3) [m], the pairs, friction limits (pairs,) [N], softening
        [m]."""
        limits = as_float64(step.garments.friction)[touching.sides].min(axis=1) * self.contact.forces(touching)
        pairs = touching.corners, touching.weights, touching.normals, touching.carried
        return x - as_float64(step.state.positions), *pairs, limits, self.smoothing * step.dt


class _Barrier(torch.autograd.Function):
    """The barrier with the gradient that is known by hand."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, step: TimeStep, contacts: ContactSet, term: ClothContact) -> Tensor:
        ctx.saved = step, contacts, term, x
        return term._added(step, contacts, x, gradient=False)[0]

    @staticmethod
    def backward(ctx: Any, slopes: Tensor) -> tuple[Tensor, None, None, None]:
        step, contacts, term, x = ctx.saved
        # Half of a pair's energy belongs to each of its garments; so does half of its force.
        sides = torch.from_numpy(contacts.cloth.sides(len(x)))
        weights = 0.5 * slopes[step.garments.vertex_garment[sides]].sum(1)
        areas = contacts.cloth.areas * weights.numpy()
        weighted = replace(contacts, cloth=replace(contacts.cloth, areas=areas))
        return term._added(step, weighted, x)[1], None, None, None


def _law(cloth: ClothPairs) -> tuple[np.ndarray, int, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return cloth.pairs.corners, cloth.pairs.vertex_faces, cloth.gaps, cloth.reaches, cloth.areas, cloth.parallels


def _by_garment(garments: PackedGarments, sides: np.ndarray, values: Tensor) -> Tensor:
    """Sums (garments,) of `values` (pairs,), half for the garment of the vertex on either of the `sides` (pairs, 2)."""
    first, second = (garments.vertex_garment[torch.from_numpy(sides[:, k])] for k in (0, 1))
    sums = values.new_zeros(garments.garment_count)
    return sums.index_add(0, first, 0.5 * values).index_add(0, second, 0.5 * values)


@compiled
def _add_barrier(
    vertices: np.ndarray,
    corners: np.ndarray,
    vertex_faces: int,
    gaps: np.ndarray,
    reaches: np.ndarray,
    areas: np.ndarray,
    parallels: np.ndarray,
    stiffness: float,
    owners: np.ndarray,
    energies: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add energies (garments,) [J] and gradient (vertices, 3) [N] of the barriers; infinite where a gap is not kept.

    Half of a pair's energy is for each of the `owners` (vertices,) of its sides. The gradient may have no rows.
    """
    values = np.zeros(len(corners))
    points, slopes, weights, between = np.empty((4, 3)), np.empty((4, 3)), np.empty(4), np.empty(3)
    for pair in range(len(corners)):
        gather(vertices, corners[pair], points)
        distance = nearest(points, pair < vertex_faces, weights, between)
        if distance >= reaches[pair]:
            continue
        room = reaches[pair] - gaps[pair]
        s = (distance - gaps[pair]) / room
        if not s > 0.0:
            values[pair] = np.inf
            continue
        across = crossing_share(points, parallels[pair], slopes)
        full = -stiffness * areas[pair] * room * (1.0 - s) ** 2 * np.log(s)
        values[pair] = across * full
        slope = across * stiffness * areas[pair] * (2.0 * (1.0 - s) * np.log(s) - (1.0 - s) ** 2 / s)
        for corner in range(4):
            vertex = corners[pair, corner]
            if vertex >= len(gradient):
                continue
            for axis in range(3):
                force = slope * weights[corner] * between[axis] / distance + full * slopes[corner, axis]
                gradient[vertex, axis] += force
    for side in range(2):
        for pair in range(len(corners)):
            vertex, other = corners[pair, 2 * side], corners[pair, 2 - 2 * side]
            energies[owners[vertex if vertex < len(owners) else other]] += 0.5 * values[pair]


@compiled
def _slip_of(
    moves: np.ndarray, corners: np.ndarray, weights: np.ndarray, normals: np.ndarray, carried: np.ndarray, pair: int
) -> tuple[float, float, float]:
    """Slip [m] of the nearest points of a pair over the step, along each axis, without its part along the normal."""
    x, y, z = 0.0, 0.0, 0.0
    for corner in range(4):
        vertex, weight = corners[pair, corner], weights[pair, corner]
        x += weight * moves[vertex, 0]
        y += weight * moves[vertex, 1]
        z += weight * moves[vertex, 2]
    x, y, z = x + carried[pair, 0], y + carried[pair, 1], z + carried[pair, 2]
    height = x * normals[pair, 0] + y * normals[pair, 1] + z * normals[pair, 2]
    return x - height * normals[pair, 0], y - height * normals[pair, 1], z - height * normals[pair, 2]


@compiled
def _add_friction(
    sides: np.ndarray,
    owners: np.ndarray,
    energies: np.ndarray,
    gradient: np.ndarray,
    moves: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
    normals: np.ndarray,
    carried: np.ndarray,
    limits: np.ndarray,
    rest: float,
) -> None:
    """Add energies (garments,) [J] and gradient (vertices, 3) [N], or one without rows, of friction between pairs.

    Half of a pair's energy is for each of the `owners` (vertices,) of its `sides` (pairs, 2).
    """
    values = np.empty(len(corners))
    for pair in range(len(corners)):
        x, y, z = _slip_of(moves, corners, weights, normals, carried, pair)
        magnitude = np.sqrt(x * x + y * y + z * z + rest * rest)
        values[pair] = limits[pair] * (magnitude - rest)
        pull = limits[pair] / magnitude
        for corner in range(4 if len(gradient) else 0):
            vertex, weight = corners[pair, corner], weights[pair, corner]
            gradient[vertex, 0] += weight * (pull * x)
            gradient[vertex, 1] += weight * (pull * y)
            gradient[vertex, 2] += weight * (pull * z)
    for side in range(2):
        for pair in range(len(corners)):
            energies[owners[sides[pair, side]]] += 0.5 * values[pair]


@compiled
def _friction_rows(
    softening: float,
    moves: np.ndarray,
    corners: np.ndarray,
    weights: np.ndarray,
    normals: np.ndarray,
    carried: np.ndarray,
    limits: np.ndarray,
    rest: float,
) -> np.ndarray:
    """Rows (2 pairs, 4, 3) [(N/m)^0.5] of the stiffness of friction: along the slips, then across them.

    With a share of the `softening` along the slip; the rest as in `_sliding`.
    """
    rows, along = np.empty((2 * len(corners), 4, 3)), np.empty(3)
    for pair in range(len(corners)):
        n = normals[pair]
        along[0], along[1], along[2] = _slip_of(moves, corners, weights, normals, carried, pair)
        length = np.sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2])
        magnitude = np.sqrt(length * length + rest * rest)
        stiffness = limits[pair] / magnitude
        share = length / magnitude
        if not length > 1e-12:
            # Any direction across the normal.
            least = int(np.argmin(np.abs(n)))
            ahead, behind = (least + 1) % 3, (least + 2) % 3
            along[least], along[ahead], along[behind] = 0.0, n[behind], -n[ahead]
            length = np.sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2])
        for axis in range(3):
            along[axis] /= length
        first, second = np.sqrt(stiffness * (1.0 - softening * (share * share))), np.sqrt(stiffness)
        for axis in range(3):
            ahead, behind = (axis + 1) % 3, (axis + 2) % 3
            across = n[ahead] * along[behind] - n[behind] * along[ahead]
            for corner in range(4):
                rows[pair, corner, axis] = weights[pair, corner] * (first * along[axis])
                rows[len(corners) + pair, corner, axis] = weights[pair, corner] * (second * across)
    return rows


@compiled
def _barrier_rows(
    vertices: np.ndarray,
    corners: np.ndarray,
    vertex_faces: int,
    gaps: np.ndarray,
    reaches: np.ndarray,
    areas: np.ndarray,
    parallels: np.ndarray,
    stiffness: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (rows, 4) of the pairs that feel each other, and rows (rows, 4, 3) [(N/m)^0.5] of their stiffness."""
    points, slopes, weights, between = np.empty((4, 3)), np.empty((4, 3)), np.empty(4), np.empty(3)
    chosen, rows = np.empty((len(corners), 4), dtype=np.int64), np.empty((len(corners), 4, 3))
    count = 0
    for pair in range(len(corners)):
        gather(vertices, corners[pair], points)
        distance = nearest(points, pair < vertex_faces, weights, between)
        if distance >= reaches[pair]:
            continue
        room = reaches[pair] - gaps[pair]
        s = max((distance - gaps[pair]) / room, 1e-9)
        bend = -2.0 * np.log(s) + 4.0 * (1.0 - s) / s + ((1.0 - s) / s) ** 2
        area = crossing_share(points, parallels[pair], slopes) * areas[pair]
        root = np.sqrt(stiffness * area * bend / room) / distance
        for corner in range(4):
            chosen[count, corner] = corners[pair, corner]
            for axis in range(3):
                rows[count, corner, axis] = root * weights[corner] * between[axis]
        count += 1
    return chosen[:count], rows[:count]
