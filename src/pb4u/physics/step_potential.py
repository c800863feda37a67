"""The sum of all energies over one time step as a function of where it ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.environment import STANDARD_GRAVITY
from pb4u.physics.contact.contact_set import ContactPlanes, ContactSet
from pb4u.physics.contact.obstacle import Obstacle
from pb4u.physics.contact.self_contact import ClothPairs
from pb4u.physics.terms.energy_term import CompiledTerm, Tangent
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments
from pb4u.threads import begun, parallel_map

if TYPE_CHECKING:
    from pb4u.physics.incremental_potential import IncrementalPotential

Part = TypeVar("Part")
Result = TypeVar("Result")

_STRUCK = 0.1
"""Share of the weight of a vertex with which contact has to push for its velocity to have jumped."""

_CACHE_LINE = 16
"""Numbers of eight bytes that no processor fetches together."""

_FEW = 2048
"""Vertices up to which one thread evaluates all terms: 0.7 ms, beside which it takes long to begin another."""


@dataclass(frozen=True, eq=False)
class Energies:
    """Energies of each garment of a pack [J].

    Args:
        terms: (garments,) energies [J] by name of the term.
        table: (terms, garments) the same in one tensor, if they were computed so.
    """

    terms: Mapping[str, Tensor]
    table: Tensor | None = None

    @property
    def per_garment(self) -> Tensor:
        """Sum of all terms, (garments,) [J]."""
        return (torch.stack(list(self.terms.values())) if self.table is None else self.table).sum(0)

    def per_world(self, garments: PackedGarments) -> Tensor:
        """Sums (worlds,) [J] of all terms over the garments of each world.

        Args:
            garments: the pack that the energies are of.
        """
        return garments.by_world(self.per_garment)

    @property
    def total(self) -> Tensor:
        """Sum over terms and garments, a scalar [J]."""
        return self.per_garment.sum()

    def floats(self) -> dict[str, float]:
        """Energies [J] of all garments together by name of the term, with their `total`."""
        values = {name: float(value.sum()) for name, value in self.terms.items()}
        return {**values, "total": sum(values.values())}


@dataclass(frozen=True, eq=False)
class StepPotential:
    """The potential of one time step as a function of the next positions `x` (vertices, 3) [m].

    Unless contacts were fixed by `with_contact_at`, every evaluation looks up the nearest surface at its own `x`, so
    its value and gradient are exact. With fixed contacts an evaluation makes no query and uses the body's tangent
    planes.

    Args:
        potential: the energy terms, and the search for the body's surface.
        step: garments, bodies and state at frame t that the terms are evaluated for.
        contacts: contacts at frame t, and at frame t+1 if they are fixed.
    """

    potential: IncrementalPotential
    step: TimeStep
    contacts: ContactSet

    def gather(self) -> None:
        """Gather what the terms' loops read of the step: on first use they would."""
        for term in self.potential.terms:
            if isinstance(term, CompiledTerm):
                term.gather()

    def contact_at(self, x: Tensor) -> ContactPlanes | None:
        """Planes of the bodies at t+1 nearest to each vertex; None without a body.

        Args:
            x: (vertices, 3) [m].
        """
        bodies = self.step.bodies
        return None if bodies is None else self.potential.search(bodies.following, self.step.garments, x.detach())

    def with_contact_at(self, x: Tensor) -> StepPotential:
        """This potential with the body near `x` (vertices, 3) [m] frozen to its tangent planes.

        Args:
            x: (vertices, 3) [m].
        """
        return self.with_contact(self.contact_at(x))

    def with_contact(self, contact: ContactPlanes | None, opposite: ContactPlanes | None = None) -> StepPotential:
        """This potential with contacts at t+1 frozen.

        Args:
            contact: planes of the bodies at t+1.
            opposite: second planes of vertices caught between two parts of a body.
        """
        return replace(self, contacts=replace(self.contacts, next=self.raised(contact), opposite=opposite))

    def raised(self, planes: ContactPlanes | None) -> ContactPlanes | None:
        """`planes` of the bodies, raised where the cloth between vertices must stay clear of them.

        Args:
            planes: planes of the bodies; None where there are none.
        """
        heights = self.contacts.raised
        return planes if planes is None or heights is None else planes.raised(heights.to(planes.points))

    def reached(self, x: Tensor, wanted: Tensor) -> tuple[StepPotential, Tensor]:
        """This potential for a move, and the positions (vertices, 3) [m] to which it leads where cloth stops cloth.

        The pairs of cloth elements in the potential are fixed to those that come near each other during the move. The
        positions are `wanted` itself if nothing touches.

        Args:
            x: (vertices, 3) [m] from where, crossing nowhere.
            wanted: (vertices, 3) [m].
        """
        contact = self.potential.self_contact
        if contact is None:
            return self, wanted
        met = self._along(x, wanted - x)
        cloth = met.contacts.cloth
        on_the_way = None if cloth is None else cloth.obstacle
        carried, obstacle = contact.collision_free_move(self.step.garments, x, wanted, cloth, obstacle=on_the_way)
        met = replace(met, contacts=replace(met.contacts, obstacle=obstacle))
        return (met if carried is wanted else met._along(x, carried - x)), carried

    def as_far_as_free(self, x: Tensor, moves: Tensor) -> tuple[StepPotential, Tensor]:
        """This potential for a move, as in `reached`, and how far (worlds,) along it, 0 to 1, nothing touches.

        Args:
            x: (vertices, 3) [m] from where, crossing nowhere.
            moves: (vertices, 3) [m], linear.
        """
        contact, met = self.potential.self_contact, self._along(x, moves)
        if contact is None:
            return met, x.new_ones(self.step.garments.world_count)
        return met, contact.shares(self.step.garments, met.contacts.cloth, x, moves)

    def with_cloth(self, cloth: ClothPairs | None) -> StepPotential:
        """This potential with its pairs of cloth elements fixed to `cloth`; None looks them up.

        Args:
            cloth: pairs of cloth elements, or None.
        """
        contact = self.potential.self_contact
        if cloth is None or contact is None:
            return self
        if self.contacts.cloth is not None:
            return replace(self, contacts=replace(self.contacts, cloth=cloth))
        before = self.step.state.positions
        obstacle = self._obstacle(before)
        near = contact.pairs(self.step.garments, before, None, before, obstacle=obstacle)
        return self._with_cloth_from(cloth, near)

    def _with_cloth_from(self, cloth: ClothPairs, start: ClothPairs) -> StepPotential:
        """This potential with `cloth`, and those of the pairs near at the step's `start` that touch there."""
        touching = start.touching(self.step.state.positions)
        return replace(self, contacts=replace(self.contacts, cloth=cloth, cloth_now=touching))

    def without_cloth(self) -> StepPotential:
        """This potential without contact between cloth elements: finite where cloth crosses cloth."""
        return replace(self, potential=self.potential.without_self_contact())

    def _along(self, x: Tensor, moves: Tensor | None) -> StepPotential:
        """This potential with all cloth elements that meet along `moves` (vertices, 3) [m] from `x`; None for none."""
        contact = self.potential.self_contact
        if contact is None:
            return self
        garments, before, known = self.step.garments, self.step.state.positions, self.contacts.cloth
        obstacle = self._obstacle(x)
        cloth = contact.pairs(garments, x, moves, before, known, obstacle)
        # What a move from the step's start meets is all that touches there.
        if known is None and x is before:
            return self._with_cloth_from(cloth, cloth)
        return self.with_cloth(cloth)

    def _obstacle(self, x: Tensor) -> Obstacle | None:
        """The bodies as they move over the step, where cloth starts from its beginning; else at rest where they end.

        Let through what was found to leave them no room.
        """
        step, known, contact = self.step, self.contacts.obstacle, self.potential.self_contact
        if step.bodies is None or contact is None or not contact.pressed_by_bodies:
            return None
        if x is step.state.positions:
            start = step.obstacle
            return start if start is None or known is None else replace(start, passed=start.passed | known.passed)
        return known or Obstacle.at(step.garments, step.bodies.following, x.detach())

    def energies(self, x: Tensor) -> Energies:
        """Energies at `x` (vertices, 3) [m]; differentiable by autograd.

        Args:
            x: (vertices, 3) [m].
        """
        if self.step.is_on_a_processor and not x.requires_grad:
            return self._added(x, gradient=False)[0]
        contacts, terms = self._contacts_at(x), self.potential.terms
        found = self._each(lambda term: term.energies(self.step, contacts, x), terms)
        return Energies({term.name: energies for term, energies in zip(terms, found, strict=True)})

    def energies_and_gradient(self, x: Tensor) -> tuple[Energies, Tensor]:
        """Energies and the gradient (vertices, 3) [N] of their total, without autograd.

        Args:
            x: (vertices, 3) [m] next positions.
        """
        if self.step.is_on_a_processor:
            return self._added(x, gradient=True)
        contacts, terms = self._contacts_at(x), self.potential.terms
        found = [term.energies_and_gradient(self.step, contacts, x) for term in terms]
        gradient = torch.zeros_like(x)
        for _, part in found:
            gradient = gradient + part
        return Energies({term.name: energies for term, (energies, _) in zip(terms, found, strict=True)}), gradient

    def _added(self, x: Tensor, *, gradient: bool) -> tuple[Energies, Tensor]:
        """Energies, and the gradient (vertices, 3) [N] of their total where it is asked for, by the terms' loops."""
        contacts, terms, at = self._contacts_at(x), self.potential.terms, as_float64(x)
        # One for each term, so that the sum is the same in whatever order these are ready; no two share a cache line,
        # which threads would take from one another with every element.
        garment_count = self.step.garments.garment_count
        energies = np.zeros((len(terms), garment_count + _CACHE_LINE))[:, :garment_count]
        slopes = np.zeros((len(terms), len(at) if gradient else 0, 3))
        longest_first = sorted(range(len(terms)), key=lambda k: -terms[k].size(contacts))
        self._each(lambda k: terms[k].add(self.step, contacts, at, energies[k], slopes[k]), longest_first)
        table = torch.from_numpy(energies).to(x.dtype)
        found = Energies({term.name: part for term, part in zip(terms, table.unbind(0), strict=True)}, table)
        return found, torch.from_numpy(slopes.sum(axis=0)).to(x.dtype)

    def struck(self, x: Tensor) -> Tensor:
        """Vertices (vertices,) bool on which contact pushes.

        Args:
            x: (vertices, 3) [m] next positions.
        """
        contacts, at = self._contacts_at(x), as_float64(x)
        push, energies = np.zeros((len(at), 3)), np.zeros(self.step.garments.garment_count)
        for term in self.potential.terms:
            if term.pushes_apart:
                term.add(self.step, contacts, at, energies, push)
        heavier = STANDARD_GRAVITY * _STRUCK * self.step.garments.vertex_masses
        return torch.from_numpy(push).norm(dim=1) > heavier

    def energies_of_worlds(self, xs: Tensor) -> Tensor:
        """Sums (positions, worlds) [J] of all terms at several `xs` (positions, vertices, 3) [m], contacts fixed.

        Args:
            xs: (positions, vertices, 3) [m].
        """

        def at(x: Tensor) -> Tensor:
            return self.energies(x).per_world(self.step.garments)

        return torch.vmap(at)(xs) if self.step.batches else torch.stack([at(x) for x in xs])

    def gradients(self, xs: Tensor) -> tuple[Tensor, Tensor]:
        """The same sums (positions, worlds) [J], and the gradients (positions, vertices, 3) [N].

        Args:
            xs: (positions, vertices, 3) [m].
        """

        def at(x: Tensor) -> tuple[Tensor, Tensor]:
            energies, gradient = self.energies_and_gradient(x)
            return energies.per_world(self.step.garments), gradient

        if self.step.batches:
            return torch.vmap(at)(xs)
        energies, gradients = zip(*map(at, xs), strict=True)
        return torch.stack(energies), torch.stack(gradients)

    def elements(self) -> dict[str, Tensor]:
        """The vertices that the terms couple, as in `EnergyTerm.elements`."""
        parts = {term.name: term.elements(self.step, self.contacts) for term in self.potential.terms}
        return {name: part for name, part in parts.items() if part is not None}

    def begin_stiffness(self, x: Tensor, pattern: StiffnessPattern) -> Callable[[], Stiffness]:
        """Begin to sum what of the `stiffness` no contact changes, while contacts are looked up; called, it is there.

        Args:
            x: (vertices, 3) [m] next positions.
            pattern: of the `elements`.
        """
        return begun(lambda: self._add_stiffness(x, pattern, pattern.empty(), reads_contacts=False))

    def stiffness(
        self, x: Tensor, pattern: StiffnessPattern, begun_sums: Callable[[], Stiffness] | None = None
    ) -> Stiffness:
        """Second derivative, or an approximation, of the terms that couple `elements`.

        Args:
            x: (vertices, 3) [m] next positions.
            pattern: of the `elements`.
            begun_sums: what `begin_stiffness` gave for them; None begins here.
        """
        sums = (begun_sums or self.begin_stiffness(x, pattern))()
        self._add_stiffness(x, pattern, sums, reads_contacts=True)
        pattern.hold(sums)
        return sums

    def _add_stiffness(
        self, x: Tensor, pattern: StiffnessPattern, sums: Stiffness, *, reads_contacts: bool
    ) -> Stiffness:
        """Add to `sums` what the terms give that read contacts, or the others."""
        contacts = self._contacts_at(x) if reads_contacts else self.contacts
        for term in self._coupling(pattern):
            if term.term.reads_contacts == reads_contacts:
                term.add_stiffness(contacts, as_float64(x), pattern.slots[term.name], sums)
        return sums

    def tangents(self, x: Tensor, pattern: StiffnessPattern) -> list[Tangent]:
        """Parts of the model of a Newton step that can be relinearised, as in `EnergyTerm.tangents`.

        Args:
            x: (vertices, 3) [m] at the start of the step.
            pattern: of the `elements`.
        """
        contacts = self._contacts_at(x)
        terms = self._coupling(pattern)
        return [part for term in terms for part in term.tangents_at(self.step, contacts, as_float64(x), pattern)]

    def _coupling(self, pattern: StiffnessPattern) -> list[CompiledTerm]:
        """Terms that couple the elements of a pattern."""
        return [t for t in self.potential.terms if isinstance(t, CompiledTerm) and t.name in pattern.slots]

    def pair_stiffness(self, x: Tensor) -> list[PairStiffness]:
        """Second derivatives over pairs of cloth elements, as in `EnergyTerm.pair_stiffness`.

        Args:
            x: (vertices, 3) [m] next positions.
        """
        contacts = self._contacts_at(x)
        parts = [term.pair_stiffness(self.step, contacts, x) for term in self.potential.terms]
        return [part for part in parts if part is not None]

    def _each(self, function: Callable[[Part], Result], parts: Sequence[Part]) -> list[Result]:
        """`function` of each of the `parts`, in their order; on threads where it is worth it."""
        # Not under autograd, which is another in each thread.
        compiled = isinstance(self.potential.terms[0], CompiledTerm)
        large = compiled and self.step.garments.vertex_count > _FEW
        return parallel_map(function, parts) if large else [function(part) for part in parts]

    def _contacts_at(self, x: Tensor) -> ContactSet:
        contacts = self.contacts
        if self.step.bodies is not None and contacts.next is None:
            contacts = replace(contacts, next=self.raised(self.contact_at(x)))
        if contacts.cloth is None:
            found = self._along(x.detach(), None).contacts
            contacts = replace(contacts, cloth=found.cloth, cloth_now=found.cloth_now)
        return contacts
