"""Contacts that follow the iterations of a minimisation, and vertices that the moving body has passed over."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pb4u.physics.contact.planes import ContactPlanes, nearest_planes
from pb4u.physics.incremental_potential import StepPotential

REACH = 0.03
"""Distance [m] from the body within which the motion of the body concerns a vertex."""

_LOOKED_UP = 0.01
"""Distance [m] from the body beyond which a vertex is not looked up again: five times where its energy begins."""

_FREE_ITERATIONS = 8
"""Iterations in which every vertex that moves is looked up; most steps of a walk are solved within twice as many."""

_OPPOSED = 0.8
"""Cosine between two planes below which they are of two parts of the body (37 degrees)."""

_DISTINCT = 0.999
"""The same in late iterations, when a vertex still jumps between the sides of a crease (2.6 degrees)."""

_CAUGHT_WITHIN = 0.01
"""Distance [m] to the plane that it left within which a vertex counts as caught between two."""

_LIFT = 2e-3
"""Height [m] over the body that a lifted vertex gets, unless it was lower before."""


@dataclass(frozen=True, eq=False)
class Lifted:
    """Where a step starts once cloth that the body passed over is lifted.

    Args:
        positions: (vertices, 3) [m].
        planes: of the bodies at t+1 nearest to these positions, where they had to be looked up, or None.
    """

    positions: Tensor
    planes: ContactPlanes | None = None


def lifted_off_the_body(potential: StepPotential, x: Tensor) -> Lifted:
    """Positions with vertices that the body passed over lifted, in every world whose energy falls.

    Args:
        potential: potential of the step.
        x: (vertices, 3) [m] at its end, pinned vertices where they will be; these are left there.
    """
    step, planes = potential.step, potential.contacts.now
    garments, bodies = step.garments, step.bodies
    if planes is None or bodies is None:
        return Lifted(x)
    point = planes.transported(bodies.following).to(x)
    normal = planes.transported_normals(bodies.following).to(x)
    height = ((x - point) * normal).sum(1)
    wanted = planes.distance.clamp(0.0, _LIFT).to(x)
    moves = ~garments.pinned & (garments.vertex_masses > 0)
    overrun = planes.touchable & moves & (planes.distance.abs() < REACH) & (height < wanted)
    if not bool(overrun.any()):
        return Lifted(x)
    lifted = torch.where(overrun[:, None], x + (wanted - height)[:, None] * normal, x)
    below = nearest_planes(bodies.following, garments, x)
    above = nearest_planes(bodies.following, garments, lifted, overrun, below)
    before, after = (
        potential.with_contact(found).energies(at).per_world(garments) for found, at in ((below, x), (above, lifted))
    )
    better = (after < before)[garments.vertex_world]
    return Lifted(torch.where(better[:, None], lifted, x), above.where(better, below))


class TrackedContact:
    """The bodies near each vertex, as tangent planes renewed at each iteration.

    Only vertices that may have come near are looked up. A vertex whose nearest point jumps to another part of the body
    (cloth caught in an armpit) keeps the plane that it left as a second one: with the nearest alone it would be thrown
    to and fro for ever.

    Args:
        potential: potential of the step.
        start: (vertices, 3) [m] where the iterations begin.
        lifted: what the start comes from, the planes of which serve all vertices that still are there.
    """

    def __init__(self, potential: StepPotential, start: Tensor, lifted: Lifted) -> None:
        self._potential = potential
        step = potential.step
        if lifted.planes is None or step.bodies is None:
            self._planes = potential.contact_at(start)
        else:
            moved = (start != lifted.positions).any(1)
            self._planes = nearest_planes(step.bodies.following, step.garments, start, moved, lifted.planes)
        self._opposite: ContactPlanes | None = None
        self._found_at = start
        self._iteration = 0

    def potential_at(self, x: Tensor) -> StepPotential:
        """The potential with the bodies near `x` frozen to their tangent planes.

        Args:
            x: (vertices, 3) [m] at which an iteration begins.
        """
        planes, step = self._planes, self._potential.step
        if planes is None or step.bodies is None:
            return self._potential
        moved = (x - self._found_at).norm(dim=1)
        # A distance changes by no more than the vertex moved, so the others are still out of reach.
        stale = (moved > self._patience()) & (planes.distance - moved < _LOOKED_UP)
        self._iteration += 1
        if bool(stale.any()):
            self._planes = nearest_planes(step.bodies.following, step.garments, x, stale, planes)
            opposed = _OPPOSED if self._iteration < _FREE_ITERATIONS else _DISTINCT
            self._opposite = _left_behind(planes, self._planes, self._opposite, x, opposed)
            self._found_at = torch.where(stale[:, None], x, self._found_at)
        return self._potential.with_contact(self._planes, self._opposite)

    def _patience(self) -> float:
        """Displacement [m] after which a vertex is looked up again; above 0 in late iterations.

        The distance to a crease has a kink, on which iterations would never end.
        """
        late = self._iteration - _FREE_ITERATIONS
        return 0.0 if late < 0 else min(2e-5 * 1.15**late, 2e-3)


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
