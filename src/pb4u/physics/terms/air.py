"""Pressure and drag of the air on moving cloth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.environment import Environment
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.element_loops import GRADIENT, SECOND, Record, element_loops, rows
from pb4u.physics.terms.energy_term import EnergyTerm, dot, sum_by_garment
from pb4u.physics.time_step import TimeStep

CARRIED_ALONG, OPEN_AIR = 0.01, 0.03
"""Distances [m] from skin up to which it carries the air along, and from which on that air is the open one."""

TURBULENCE = 0.3
"""Share of the wind's speed that gusts have along each axis: over built ground (Simiu and Yeo, Wind Effects, 2019)."""

_EDDIES = 24
"""Waves that a gusty wind sums; with half as many it is seen to repeat."""

_LONGEST, _SHORTEST = 8.0, 0.4
"""Lengths [m] of its longest and its shortest wave: what is longer is wind, what is shorter no garment feels."""


def _face(
    x: np.ndarray,
    corners: np.ndarray,
    numbers: np.ndarray,
    face: int,
    wanted: int,
    forces: np.ndarray,
    blocks: np.ndarray,
    factors: np.ndarray,
) -> float:
    """One face; its numbers are its normal, where the air carries its centre [m], and both coefficients [J/m^3]."""
    across, along = numbers[face, 6], numbers[face, 7]
    if across == 0.0 and along == 0.0:
        forces[:] = 0.0
        if wanted == SECOND:
            blocks[:] = 0.0
        return 0.0
    a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
    w0 = (x[a, 0] + x[b, 0] + x[c, 0]) / 3.0 - numbers[face, 3]
    w1 = (x[a, 1] + x[b, 1] + x[c, 1]) / 3.0 - numbers[face, 4]
    w2 = (x[a, 2] + x[b, 2] + x[c, 2]) / 3.0 - numbers[face, 5]
    n0, n1, n2 = numbers[face, 0], numbers[face, 1], numbers[face, 2]
    pressed = w0 * n0 + w1 * n1 + w2 * n2
    slip = (w0 - pressed * n0, w1 - pressed * n1, w2 - pressed * n2)
    dragged = np.sqrt(slip[0] * slip[0] + slip[1] * slip[1] + slip[2] * slip[2])
    energy = across * abs(pressed) ** 3 + along * dragged**3
    if wanted == GRADIENT:
        for axis in range(3):
            push = across * abs(pressed) * pressed * numbers[face, axis] + along * dragged * slip[axis]
            for corner in range(3):
                forces[corner, axis] = push
    elif wanted == SECOND:
        for i in range(3):
            for j in range(3):
                both = numbers[face, i] * numbers[face, j]
                second = 2.0 * across * abs(pressed) * both - along * dragged * both
                if i == j:
                    second += along * dragged
                if dragged > 0.0:
                    second += along * slip[i] * slip[j] / dragged
                for pair in range(6):
                    blocks[pair, i, j] = second / 3.0
    return energy


@dataclass(frozen=True)
class Air(EnergyTerm):
    """Sum over faces of rho A dt (Cd |u_n|^3 + Cf |u_t|^3) / 6 [J].

    rho is the density of the air [kg/m^3], A the rest area of the face [m^2], u the velocity of its centre over the
    step less that of the air [m/s], u_n its part along the face's normal at the start of the step and u_t the rest: the
    force on the face is -rho A (Cd |u_n| u_n + Cf |u_t| u_t) / 2 [N].
    What an inclined face feels along its normal is drag and lift at once. Air within 3 cm of the skin moves along with
    it: both coefficients fall to zero from 3 to 1 cm.

    Args:
        pressure: Cd, of flow along the normal; 1.2 of a plate held across it (Hoerner, Fluid-Dynamic Drag, 1965).
        skin_friction: Cf, of flow along the face; 0.02 of both sides of a plate in turbulent flow (there too).
    """

    pressure: float = 1.2
    skin_friction: float = 0.02
    name = "air"
    loops = element_loops(_face, 3)

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        normals, carried, share = self._flow(step, contacts)
        way = x[step.garments.faces].mean(1) - carried
        pressed = dot(way, normals)
        slip = way - pressed[:, None] * normals
        # The root has no slope at zero.
        dragged = dot(slip, slip).clamp_min(torch.finfo(x.dtype).tiny).sqrt()
        energy = share * (self.pressure * pressed.abs() ** 3 + self.skin_friction * dragged**3)
        return sum_by_garment(energy, step.garments.face_garment, step.garments.garment_count)

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return step.garments.faces

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        garments = step.garments
        normals, carried, share = map(as_float64, self._flow(step, contacts))
        numbers = rows(len(normals), normals, carried, self.pressure * share, self.skin_friction * share)
        records = (Record(garments.faces.numpy(), garments.face_garment.numpy(), numbers),)
        return lambda _: records

    def _flow(self, step: TimeStep, contacts: ContactSet) -> tuple[Tensor, Tensor, Tensor]:
        """Unit normals (faces, 3), places (faces, 3) [m] to which the air carries their centres, and rho A / (6 dt^2).

        The last is (faces,) [J/m^3], and less near skin.
        """
        garments, before = step.garments, step.state.positions
        a, b, c = before[garments.faces].unbind(1)
        normals = torch.linalg.cross(b - a, c - a)
        normals = normals / normals.norm(dim=1, keepdim=True).clamp_min(1e-30 if before.dtype.itemsize > 4 else 1e-20)
        centres = (a + b + c) / 3.0
        carried = centres + step.dt * air_velocities(step.environment, centres, step.time)
        share = step.environment.air_density * garments.face_areas / (6.0 * step.dt**2)
        if contacts.now is not None:
            distance = torch.where(contacts.now.touchable, contacts.now.distance, torch.inf)
            open_share = ((distance - CARRIED_ALONG) / (OPEN_AIR - CARRIED_ALONG)).clamp(0.0, 1.0)
            share = share * open_share[garments.faces].mean(1)
        return normals, carried, share


def air_velocities(environment: Environment, points: Tensor, time: float) -> Tensor:
    """Velocities (points, 3) [m/s] of the air.

    Gusts are eddies that the mean wind carries along unchanged: waves in random directions, none of which compresses
    air, as strong as the cube root of their length (Kolmogorov's spectrum; Taylor's hypothesis of frozen turbulence).

    Args:
        environment: its wind and the seed of its gusts.
        points: (points, 3) [m].
        time: since the start of the simulation [s].
    """
    wind = points.new_tensor(environment.wind)
    if environment.gusts is None or not any(environment.wind):
        return wind.expand_as(points)
    waves, strengths, phases = (part.to(points) for part in _eddies(environment.gusts))
    angles = (points - time * wind) @ waves.T + phases
    return wind + TURBULENCE * wind.norm() * torch.sin(angles) @ strengths


@lru_cache
def _eddies(seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Wave vectors (eddies, 3) [1/m], strengths (eddies, 3) of unit mean square along an axis, and phases (eddies,)."""
    random = np.random.default_rng(seed)
    lengths = np.geomspace(_LONGEST, _SHORTEST, _EDDIES)
    across, toward = (_unit(random.normal(size=(_EDDIES, 3))) for _ in range(2))
    strengths = _unit(np.cross(across, toward)) * np.cbrt(lengths)[:, None]
    strengths *= np.sqrt(6.0 / (strengths**2).sum())
    phases = random.uniform(0.0, 2.0 * np.pi, _EDDIES)
    waves = 2.0 * np.pi / lengths[:, None] * across
    return torch.from_numpy(waves), torch.from_numpy(strengths), torch.from_numpy(phases)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """`vectors` (n, 3) of length 1."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
