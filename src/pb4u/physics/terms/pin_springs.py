"""Springs between pins that give way and where skinning puts them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.element_loops import Record, vertex_record
from pb4u.physics.terms.energy_term import dot, sum_by_garment
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.time_step import TimeStep

_SLACK = 1e-9
"""Time [s] by which sums of steps may miss that at which pins let go."""


class PinSprings(Inertia):
    """Sum over pins of k |x' - p|^2 / 2 [J].

    k is the pin's share of the stiffness of the garment's springs [N/m], 0 after their release, and p the target of the
    pin after the step [m].
    """

    name = "pin springs"

    def acts_on(self, step: TimeStep) -> bool:
        return any(garment.springs is not None for garment in step.garments.garments)

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments, away = step.garments, x - _places(step)
        return sum_by_garment(0.5 * _stiffness(step) * dot(away, away), garments.vertex_garment, garments.garment_count)

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        records = (vertex_record(step.garments, as_float64(_stiffness(step)), as_float64(_places(step))),)
        return lambda _: records


def _stiffness(step: TimeStep) -> Tensor:
    """Stiffness (vertices,) [N/m] of the springs over the step."""
    garments = step.garments
    return torch.where(step.time < garments.pinned_until - _SLACK, garments.pin_stiffness, 0.0)


def _places(step: TimeStep) -> Tensor:
    """Places (vertices, 3) [m] that the pins are drawn to."""
    return step.state.positions if step.pin_positions is None else step.pin_positions
