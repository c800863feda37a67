"""Damping of cloth: forces against a change of its shape, whatever the rate of frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.bending import Bending, bends, hinge_record, hinge_stiffness
from pb4u.physics.terms.element_loops import Record
from pb4u.physics.terms.energy_term import sum_by_garment
from pb4u.physics.terms.stretch import Stretch, elastic_density, face_record, green_strains
from pb4u.physics.time_step import TimeStep


class StretchDamping(Stretch):
    """Sum over faces of b A / (2 dt) (G - G0) : C : (G - G0) [J], G0 the Green strain at the start of the step.

    b is the damping time of the face's material [s], C its four moduli, A its rest area [m^2]. A mode of angular
    frequency w loses pi b w of the logarithm of its amplitude in a period. Source: Rayleigh damping in strain rates, as
    in Brown et al. 2018 (Accurate dissipative forces in optimization integrators).
    """

    name = "stretch damping"

    def acts_on(self, step: TimeStep) -> bool:
        return step.garments.damps

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        change = green_strains(garments, x) - green_strains(garments, step.state.positions)
        density = garments.damping / step.dt * elastic_density(garments, change)
        return sum_by_garment(garments.face_areas * density, garments.face_garment, garments.garment_count)

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        garments, before = step.garments, step.state.positions.double()
        share, strains = as_float64(garments.damping) / step.dt, green_strains(garments, before)
        records = (face_record(garments, share, 0.0, 0.0, as_float64(strains.T)),)
        return lambda _: records


class BendingDamping(Bending):
    """The same of bending: sum over hinges of b k / (4 (A1 + A2)) (l theta - l0 theta0)^2 / (2 dt) [J].

    b is the mean damping time of both faces [s], l0 theta0 the value at the start of the step; the rest as in
    `Bending`.
    """

    name = "bending damping"

    def acts_on(self, step: TimeStep) -> bool:
        return step.garments.damps

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        change = bends(garments, x) - bends(garments, step.state.positions)
        energy = 0.5 * _stiffness(step) * change * change
        return sum_by_garment(energy, garments.hinge_garment, garments.garment_count)

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        bent = as_float64(bends(step.garments, step.state.positions.double()))
        records = (hinge_record(step.garments, _stiffness(step), bent),)
        return lambda _: records


def _stiffness(step: TimeStep) -> Tensor:
    """Stiffness (hinges,) [J/m^2] of the damping."""
    garments = step.garments
    return hinge_stiffness(garments) * garments.hinge_damping / step.dt


DAMPING = (StretchDamping(), BendingDamping())
"""The energies of damping, which a simulation adds and tables of the six leave out."""
