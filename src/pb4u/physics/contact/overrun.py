"""Vertices that the moving body has overrun, lifted back to the side of the body that they were on."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.physics.contact.tracking import REACH
from pb4u.physics.incremental_potential import StepPotential

_CLEARANCE = 2e-3
"""Height [m] over the body that a lifted vertex gets, unless it was lower before."""


def lifted_off_the_body(potential: StepPotential, x: Tensor) -> Tensor:
    """`x` (vertices, 3) [m], with overrun vertices lifted in every world whose energy falls by it.

    Args:
        potential: of the step. x: positions at its end, pinned vertices where they will be; these are left there.
    """
    step, planes = potential.step, potential.contacts.now
    garments, bodies = step.garments, step.bodies
    if planes is None or bodies is None:
        return x
    point = planes.transported(bodies.following).to(x)
    normal = planes.transported_normals(bodies.following).to(x)
    height = ((x - point) * normal).sum(1)
    wanted = planes.distance.clamp(0.0, _CLEARANCE).to(x)
    moves = ~garments.pinned & (garments.vertex_masses > 0)
    overrun = planes.touchable & moves & (planes.distance.abs() < REACH) & (height < wanted)
    if not bool(overrun.any()):
        return x
    lifted = torch.where(overrun[:, None], x + (wanted - height)[:, None] * normal, x)
    better = potential.energies(lifted).per_world(garments) < potential.energies(x).per_world(garments)
    return torch.where(better[garments.vertex_world, None], lifted, x)
