"""Contacts that follow the iterations of a minimisation, and vertices that the moving body has passed over."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from pb4u.physics.contact.contact_set import UNMOVED, ContactPlanes, nearest_planes
from pb4u.physics.step_potential import StepPotential

REACH = 0.03
"""Distance [m] from the body within which the motion of the body concerns a vertex."""

_FREE_ITERATIONS = 8
"""Iterations in which every vertex that moves is queried; most steps of a walk are solved within twice as many."""

_OPPOSED = 0.8
"""Cosine between two planes below which they are of two parts of the body (37 degrees)."""

_DISTINCT = 0.999
"""The same in late iterations, when a vertex still jumps between the sides of a crease (2.6 degrees)."""

_CAUGHT_WITHIN = 0.01
"""Distance [m] to the plane that it left within which a vertex counts as caught between two."""

_LIFT = 2e-3
"""Height [m] over the body to which an overrun vertex is moved, unless it was lower before."""

_ROUNDING = 1e-9
"""Height [m] by which a vertex that was moved there may be lower: positions are kept as accelerations meanwhile."""


def moved_off_the_body(potential: StepPotential, x: Tensor) -> Tensor:
    """Positions with vertices that the body has passed moved off it, in every world where this lowers the energy.

    Args:
        potential: potential of the step.
        x: (vertices, 3) [m] at the end of the step, with pinned vertices at their targets, where they stay.
    """
    step, planes = potential.step, potential.contacts.now
    garments, bodies = step.garments, step.bodies
    if planes is None or bodies is None:
        return x
    point = planes.transported(bodies.following).to(x)
    normal = planes.transported_normals(bodies.following).to(x)
    # Planes may be raised for the cloth between vertices.
    height = ((x - point) * normal).sum(1)
    if potential.contacts.raised is not None:
        height = height - potential.contacts.raised.to(x)
    wanted = planes.distance.clamp(0.0, _LIFT).to(x)
    moves = ~garments.pinned & (garments.vertex_masses > 0)
    overrun = planes.touchable & moves & (planes.distance.abs() < REACH) & (height < wanted - _ROUNDING)
    if bodies.colliders.capacities is None and not bool(overrun.any()):
        return x
    lifted = torch.where(overrun[:, None], x + (wanted - height)[:, None] * normal, x)
    before, after = (
        potential.with_contact(nearest_planes(bodies.following, garments, at)).energies(at).per_world(garments)
        for at in (x, lifted)
    )
    better = (after < before)[garments.vertex_world]
    return torch.where(better[:, None], lifted, x)


class TrackedContact:
    """The bodies near each vertex, as tangent planes renewed at each iteration.

    Only vertices that may have come near the body are queried. A vertex whose nearest point jumps to another part of
    the body (cloth caught in an armpit) keeps its previous plane as a second one: with the nearest one alone it would
    oscillate for ever.

    Args:
        potential: potential of the step.
        start: (vertices, 3) [m] start of the iterations.
    """

    def __init__(self, potential: StepPotential, start: Tensor) -> None:
        self._potential = potential
        self._planes = potential.contact_at(start)
        self._opposite: ContactPlanes | None = None
        self._iteration = 0

    def potential_at(self, x: Tensor) -> StepPotential:
        """The potential with the bodies near `x` frozen to their tangent planes.

        Args:
            x: (vertices, 3) [m] at the start of an iteration.
        """
        planes, step = self._planes, self._potential.step
        if planes is None or step.bodies is None:
            return self._potential
        patience = self._patience()
        self._iteration += 1
        self._planes = nearest_planes(step.bodies.following, step.garments, x, patience=patience)
        opposed = _OPPOSED if self._iteration < _FREE_ITERATIONS else _DISTINCT
        self._opposite = _left_behind(planes, self._planes, self._opposite, x, opposed)
        return self._potential.with_contact(self._planes, self._opposite)

    def _patience(self) -> float:
        """Displacement [m] after which a vertex is queried again; more in late iterations.

        The distance to a crease has a kink, on which iterations would never end.
        """
        late = self._iteration - _FREE_ITERATIONS
        return UNMOVED if late < 0 else min(2e-5 * 1.15**late, 2e-3)


def _left_behind(
    old: ContactPlanes, new: ContactPlanes, opposite: ContactPlanes | None, x: Tensor, opposed: float
) -> ContactPlanes | None:
    """Plane of each vertex before its nearest point jumped to another part of the body; None where none jumped."""
    jumped = old.touchable & new.touchable & ((old.normals * new.normals).sum(1) < opposed)
    if opposite is None:
        if not bool(jumped.any()):
            return None
        opposite = replace(old, touchable=torch.zeros_like(old.touchable))
    taken = old.where(jumped, opposite)
    caught = ((x - taken.points).norm(dim=1) < _CAUGHT_WITHIN) & new.touchable
    apart = (taken.normals * new.normals).sum(1) < opposed
    return replace(taken, touchable=taken.touchable & caught & apart)
