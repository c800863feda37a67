"""Contact between cloth elements: a barrier that rises without bound as they near, and friction while they touch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.element_distance import crossing_share, gather, nearest
from pb4u.collision.jit import compiled
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.contact.self_contact import ClothPairs, TouchingCloth
from pb4u.physics.terms.energy_term import EnergyTerm, dot
from pb4u.physics.terms.friction import SOFTENING
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments

_PRESSED = 0.2
"""Share of the room between two elements below which they count as pressed no harder: nearer is a pinch, not a load."""


@dataclass(frozen=True)
class ClothContact(EnergyTerm):
    """Sum over pairs of cloth elements of kappa A_p h_p m_p b(s_p) [J], b(s) = -(1 - s)^2 ln s for s < 1.

    s_p = (d_p - g_p) / h_p with d_p the distance of the two elements [m], g_p the gap that they keep and h_p what is
    between it and the distance at which they begin to feel each other; m_p is 1, and for two edges falls to 0 where
    they are parallel. Source: the barrier of Incremental Potential Contact (Li et al. 2020) with an offset, as for the
    thickness of Codimensional IPC (Li et al. 2021).

    Args:
        stiffness: kappa [Pa]; cloth of 200 g/m^2 presses the one under it with 2 Pa, and comes to rest within a tenth
            of h_p; a pinch of a kilopascal leaves half of it.
    """

    stiffness: float = 1e3
    name = "self_contact"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        if contacts.cloth is None:
            return x.new_zeros(step.garments.garment_count)
        energies: Tensor = _Barrier.apply(x, step, contacts, self)  # type: ignore[no-untyped-call]
        return energies

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        cloth = contacts.cloth
        if cloth is None:
            return x.new_zeros(step.garments.garment_count), torch.zeros_like(x)
        values, gradient = _barrier(cloth.joined(x), *_law(cloth), self.stiffness)
        energies = _by_garment(step.garments, cloth.sides(len(x)), torch.from_numpy(values)).to(x)
        return energies, torch.from_numpy(gradient[: len(x)]).to(x)

    def pair_stiffness(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> PairStiffness | None:
        """Second derivative along the line between the nearest points; what turning adds is left out.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """
        if contacts.cloth is None:
            return None
        corners, rows = _barrier_rows(contacts.cloth.joined(x), *_law(contacts.cloth), self.stiffness)
        rows[corners >= len(x)] = 0.0
        return PairStiffness(np.where(corners < len(x), corners, 0), rows)

    def forces(self, touching: TouchingCloth) -> np.ndarray:
        """Force (pairs,) [N] between the elements of each pair.

        Args:
            touching: pairs that feel each other.
        """
        room = touching.reaches - touching.gaps
        s = np.clip((touching.distances - touching.gaps) / room, _PRESSED, 1.0)
        forces: np.ndarray = self.stiffness * touching.areas * ((1.0 - s) ** 2 / s - 2.0 * (1.0 - s) * np.log(s))
        return forces


@dataclass(frozen=True)
class ClothFriction(EnergyTerm):
    """Sum over pairs that touch at the step's start of mu_p f_p (sqrt(|s_p|^2 + e^2) - e) [J].

    mu_p is the smaller coefficient of the two, that of the cloth where a body presses it. f_p is the force [N] of the
    barrier there, s_p the slip [m] of the two nearest points over the step without its part along their normal, e =
    `smoothing` dt [m]. Lagged, so that it is known before the step and convex. Source: the friction of Incremental
    Potential Contact (Li et al. 2020).

    Args:
        smoothing: slip speed below which the elements stick [m/s].
        contact: whose force presses them together.
    """

    smoothing: float = 1e-3
    contact: ClothContact = ClothContact()
    name = "self_friction"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        touching = contacts.cloth_now
        if touching is None:
            return x.new_zeros(step.garments.garment_count)
        _, limit, magnitude, rest = self._sliding(step, touching, x)
        return _by_garment(step.garments, touching.sides, limit * (magnitude - rest))

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        touching = contacts.cloth_now
        if touching is None:
            return x.new_zeros(step.garments.garment_count), torch.zeros_like(x)
        across, limit, magnitude, rest = self._sliding(step, touching, x)
        pull = (limit / magnitude)[:, None] * across
        weighted = torch.from_numpy(touching.weights).to(x)[:, :, None] * pull[:, None, :]
        corners = torch.from_numpy(touching.corners).reshape(-1)
        gradient = torch.zeros_like(x).index_add_(0, corners, weighted.reshape(-1, 3))
        return _by_garment(step.garments, touching.sides, limit * (magnitude - rest)), gradient

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
        across = self._slip(step, touching, x).numpy()
        rest = self.smoothing * step.dt
        length = np.linalg.norm(across, axis=1)
        magnitude = np.sqrt(length**2 + rest**2)
        stiffness = self._limit(step, touching, x).numpy() / magnitude
        along = np.where((length > 1e-12)[:, None], across, _any_across(touching.normals))
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        softened = stiffness * (1.0 - SOFTENING * (length / magnitude) ** 2)
        axes = (np.sqrt(softened)[:, None] * along, np.sqrt(stiffness)[:, None] * np.cross(touching.normals, along))
        rows = [touching.weights[:, :, None] * axis[:, None, :] for axis in axes]
        return PairStiffness(np.concatenate([touching.corners] * 2), np.concatenate(rows))

    def _sliding(self, step: TimeStep, touching: TouchingCloth, x: Tensor) -> tuple[Tensor, Tensor, Tensor, float]:
        """Slip (pairs, 3) [m], greatest force (pairs,) [N], softened length (pairs,) of the slip [m], softening [m]."""
        across, rest = self._slip(step, touching, x), self.smoothing * step.dt
        return across, self._limit(step, touching, x), (across.square().sum(1) + rest * rest).sqrt(), rest

    def _slip(self, step: TimeStep, touching: TouchingCloth, x: Tensor) -> Tensor:
        """Slip (pairs, 3) [m] of the nearest points over the step without its part along the normal."""
        weights, normals = torch.from_numpy(touching.weights).to(x), torch.from_numpy(touching.normals).to(x)
        slip = (weights[:, :, None] * (x - step.state.positions)[torch.from_numpy(touching.corners)]).sum(1)
        slip = slip + torch.from_numpy(touching.carried).to(x)
        return slip - dot(slip, normals)[:, None] * normals

    def _limit(self, step: TimeStep, touching: TouchingCloth, x: Tensor) -> Tensor:
        """Friction limit (pairs,) [N]."""
        coefficients = step.garments.friction[torch.from_numpy(touching.sides)].amin(1).to(x)
        return coefficients * torch.from_numpy(self.contact.forces(touching)).to(x)


class _Barrier(torch.autograd.Function):
    """The barrier with the gradient that is known by hand."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, step: TimeStep, contacts: ContactSet, term: ClothContact) -> Tensor:
        assert contacts.cloth is not None
        cloth, ctx.saved = contacts.cloth, (step, contacts, term, x)
        values = _barrier(cloth.joined(x), *_law(cloth), term.stiffness)[0]
        return _by_garment(step.garments, cloth.sides(len(x)), torch.from_numpy(values)).to(x)

    @staticmethod
    def backward(ctx: Any, slopes: Tensor) -> tuple[Tensor, None, None, None]:
        step, contacts, term, x = ctx.saved
        # Half of a pair's energy belongs to each of its garments; so does half of its force.
        sides = torch.from_numpy(contacts.cloth.sides(len(x)))
        weights = 0.5 * slopes[step.garments.vertex_garment[sides]].sum(1)
        areas = contacts.cloth.areas * weights.numpy()
        _, gradient = _barrier(contacts.cloth.joined(x), *_law(replace(contacts.cloth, areas=areas)), term.stiffness)
        return torch.from_numpy(gradient[: len(x)]).to(x), None, None, None


def _any_across(normals: np.ndarray) -> np.ndarray:
    """A direction (pairs, 3) across each of the unit `normals` (pairs, 3)."""
    smallest = np.eye(3)[np.abs(normals).argmin(axis=1)]
    return np.cross(normals, smallest)


def _law(cloth: ClothPairs) -> tuple[np.ndarray, int, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return cloth.pairs.corners, cloth.pairs.vertex_faces, cloth.gaps, cloth.reaches, cloth.areas, cloth.parallels


def _by_garment(garments: PackedGarments, sides: np.ndarray, values: Tensor) -> Tensor:
    """Sums (garments,) of `values` (pairs,), half for the garment of the vertex on either of the `sides` (pairs, 2)."""
    first, second = (garments.vertex_garment[torch.from_numpy(sides[:, k])] for k in (0, 1))
    sums = values.new_zeros(garments.garment_count)
    return sums.index_add(0, first, 0.5 * values).index_add(0, second, 0.5 * values)


@compiled
def _barrier(
    vertices: np.ndarray,
    corners: np.ndarray,
    vertex_faces: int,
    gaps: np.ndarray,
    reaches: np.ndarray,
    areas: np.ndarray,
    parallels: np.ndarray,
    stiffness: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Energies (pairs,) [J] and gradient (vertices, 3) [N] of the barriers; infinite where a gap is not kept."""
    energies, gradient = np.zeros(len(corners)), np.zeros_like(vertices)
    points, slopes, weights, between = np.empty((4, 3)), np.empty((4, 3)), np.empty(4), np.empty(3)
    for pair in range(len(corners)):
        gather(vertices, corners[pair], points)
        distance = nearest(points, pair < vertex_faces, weights, between)
        if distance >= reaches[pair]:
            continue
        room = reaches[pair] - gaps[pair]
        s = (distance - gaps[pair]) / room
        if not s > 0.0:
            energies[pair] = np.inf
            continue
        across = crossing_share(points, parallels[pair], slopes)
        full = -stiffness * areas[pair] * room * (1.0 - s) ** 2 * np.log(s)
        energies[pair] = across * full
        slope = across * stiffness * areas[pair] * (2.0 * (1.0 - s) * np.log(s) - (1.0 - s) ** 2 / s)
        for corner in range(4):
            for axis in range(3):
                force = slope * weights[corner] * between[axis] / distance + full * slopes[corner, axis]
                gradient[corners[pair, corner], axis] += force
    return energies, gradient


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
