"""Vertices that the moving body has overrun, lifted back to the side of the body that they were on."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.physics.incremental_potential import StepPotential
from pb4u.physics.tracked_contact import REACH

_CLEARANCE = 2e-3
"""Height [m] over the body that a lifted vertex gets, unless it was lower before."""


def lifted_off_the_body(potential: StepPotential, x: Tensor) -> Tensor:
    """`x` (vertices, 3) [m], with overrun vertices lifted in every garment whose energy falls by it.

    Args:
        potential: of the step. x: positions at its end, pinned vertices where they will be; these are left there.
    """
    step = potential.step
    garments, planes, collider = step.garments, step.contact_now, step.collider
    if planes is None or collider is None:
        return x
    point = planes.carried(collider.following, collider.faces).to(x)
    normal = planes.carried_normals(collider.following, collider.faces).to(x)
    height = ((x - point) * normal).sum(1)
    wanted = planes.distance.clamp(0.0, _CLEARANCE).to(x)
    moves = ~garments.pinned & (garments.vertex_masses > 0)
    overrun = planes.touchable & moves & (planes.distance.abs() < REACH) & (height < wanted)
    if not bool(overrun.any()):
        return x
    lifted = torch.where(overrun[:, None], x + (wanted - height)[:, None] * normal, x)
    better = potential.energies(lifted).per_garment < potential.energies(x).per_garment
    return torch.where(better[garments.vertex_garment, None], lifted, x)
