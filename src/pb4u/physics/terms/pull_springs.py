"""Springs of a hand that pulls at the cloth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.element_loops import Record, rows
from pb4u.physics.terms.energy_term import dot, sum_by_garment
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.time_step import Pull, TimeStep


class PullSprings(Inertia):
    """Sum over vertices held in the studio of k |x' - p|^2 / 2 [J]: k [N/m] and p [m] are those of the step's pull."""

    name = "pull springs"

    def acts_on(self, step: TimeStep) -> bool:
        return step.pull is not None

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments, pull = step.garments, _pull(step)
        away = x[pull.vertices] - pull.places.to(x)
        energy = 0.5 * pull.stiffness * dot(away, away)
        return sum_by_garment(energy, garments.vertex_garment[pull.vertices], garments.garment_count)

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return _pull(step).vertices[:, None]

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        pull = _pull(step)
        owners = step.garments.vertex_garment[pull.vertices].numpy()
        numbers = rows(len(owners), pull.stiffness, as_float64(pull.places))
        records = (Record(pull.vertices[:, None].numpy(), owners, numbers),)
        return lambda _: records


def _pull(step: TimeStep) -> Pull:
    assert step.pull is not None, "a step without a pull has no such term"
    return step.pull
