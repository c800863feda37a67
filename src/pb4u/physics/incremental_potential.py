"""Which energies a time step sums: for the training objective, the solver's objective and the metric."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pb4u.physics.contact.contact_set import PlaneSearch, nearest_planes
from pb4u.physics.contact.self_contact import CollisionFree
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.bending import Bending
from pb4u.physics.terms.cloth_contact import ClothContact, ClothFriction
from pb4u.physics.terms.collision import Collision
from pb4u.physics.terms.energy_term import EnergyTerm
from pb4u.physics.terms.friction import FRICTION_LAWS, Friction
from pb4u.physics.terms.gravity import Gravity
from pb4u.physics.terms.inertia import Inertia
from pb4u.physics.terms.stretch import Stretch
from pb4u.physics.time_step import TimeStep

TERMS: tuple[EnergyTerm, ...] = (Stretch(), Bending(), Gravity(), Inertia(), Collision(), Friction(load=Collision()))
"""The energies of a time step. Everything downstream takes their names from here."""

SELF_CONTACT: tuple[EnergyTerm, ...] = (ClothContact(), ClothFriction())
"""The energies of contact between cloth elements, which a simulation adds and tables of the six leave out."""


@dataclass(frozen=True, eq=False)
class IncrementalPotential:
    """Energies to sum, and how a vertex finds the body near it.

    Args:
        terms: the energies, in their order.
        search: finds the planes of the body: its exact nearest points, or the family's nearest face centres.
        self_contact: keeps cloth from passing through cloth; None for the paper's physics, which does not.
    """

    terms: tuple[EnergyTerm, ...] = TERMS
    search: PlaneSearch = nearest_planes
    self_contact: CollisionFree | None = None

    def with_self_contact(self, bodies: bool = False) -> IncrementalPotential:
        """This potential with contact between cloth elements.

        Args:
            bodies: whether elements of bodies count among them.
        """
        return replace(self, terms=(*self.terms, *SELF_CONTACT), self_contact=CollisionFree(feels_bodies=bodies))

    def pressed_by_bodies(self) -> IncrementalPotential:
        """This potential with faces and edges of bodies among what presses cloth, where cloth feels bodies at all."""
        contact = self.self_contact
        if contact is None or not contact.feels_bodies:
            return self
        return replace(self, self_contact=replace(contact, pressed_by_bodies=True))

    def without_self_contact(self) -> IncrementalPotential:
        """This potential without contact between cloth elements."""
        ours = {term.name for term in SELF_CONTACT}
        return replace(self, terms=tuple(t for t in self.terms if t.name not in ours), self_contact=None)

    def with_friction(self, law: str) -> IncrementalPotential:
        """This potential with another law of friction on bodies and on the ground, under the load of contact.

        Args:
            law: "coulomb" or "paper".
        """
        return self.with_term(FRICTION_LAWS[law](load=Collision()))

    @property
    def friction_law(self) -> str:
        """Name of the law of friction on bodies and on the ground; "none" without friction."""
        return next((term.law for term in self.terms if isinstance(term, Friction)), "none")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms, in their order."""
        return tuple(term.name for term in self.terms)

    def term(self, name: str) -> EnergyTerm:
        """The term called `name`; KeyError if there is none.

        Args:
            name: of the term.
        """
        return {term.name: term for term in self.terms}[name]

    def with_term(self, new: EnergyTerm) -> IncrementalPotential:
        """This potential with `new` replacing the term of its name, or added if there is none.

        Args:
            new: the term.
        """
        if new.name not in self.names:
            return replace(self, terms=(*self.terms, new))
        return replace(self, terms=tuple(new if term.name == new.name else term for term in self.terms))

    def of(self, step: TimeStep) -> StepPotential:
        """The potential of `step`, with the contacts of the body at its start queried; compiled on a processor.

        Args:
            step: the time step.
        """
        heights = self._heights(step)
        if self.search is nearest_planes:
            contacts = step.contacts if heights is None else step.raised_contacts
        else:
            contacts = step.contacts_by(self.search).raised_by(heights)
        terms = tuple(term for term in self.terms if term.acts_on(step))
        if step.is_on_a_processor:
            terms = tuple(term.compiled(step, contacts) for term in terms)
        return StepPotential(replace(self, terms=terms), step, contacts)

    def load(self, step: TimeStep, x: Tensor) -> Tensor | None:
        """Forces (vertices,) [N] with which bodies press the vertices at the end of a step; None without bodies.

        Args:
            step: the time step.
            x: (vertices, 3) [m] at its end.
        """
        collision = self.term(Collision.name)
        if step.bodies is None or not isinstance(collision, Collision):
            return None
        planes, heights = self.search(step.bodies.following, step.garments, x), self._heights(step)
        if heights is not None:
            planes = planes.raised(heights.to(x))
        return collision.pressing(step, torch.where(planes.touchable, planes.distance, torch.inf))

    def _heights(self, step: TimeStep) -> Tensor | None:
        """Heights (vertices,) [m] that the planes of bodies are raised by for the cloth between vertices, or None."""
        return step.sags if self.self_contact is not None and self.self_contact.feels_bodies else None
