"""The sum of all energies over one time step: the training objective, the solver's objective and the metric."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.physics.bending import Bending
from pb4u.physics.collision import Collision, ReleasedCollision
from pb4u.physics.contact_planes import ContactPlanes, PosedColliders, collider_surfaces
from pb4u.physics.energy_term import ElementBlocks, EnergyTerm, TimeStep
from pb4u.physics.friction import Friction, ReleasedFriction
from pb4u.physics.gravity import Gravity
from pb4u.physics.inertia import Inertia
from pb4u.physics.integrator import require_time_step
from pb4u.physics.stretch import Stretch
from pb4u.scene.packed import ColliderFrame, PackedGarments
from pb4u.scene.state import State


@dataclass(frozen=True, eq=False)
class Energies:
    """Energies of each garment of a pack [J].

    Args:
        terms: name of the term -> (garments,).
    """

    terms: Mapping[str, Tensor]

    @property
    def per_garment(self) -> Tensor:
        """(garments,) sums of all terms."""
        return torch.stack(list(self.terms.values())).sum(0)

    @property
    def total(self) -> Tensor:
        """Sum over terms and garments, a scalar."""
        return self.per_garment.sum()

    def floats(self, garment: int = 0) -> dict[str, float]:
        """Every term and their `total` for one garment."""
        values = {name: float(value[garment]) for name, value in self.terms.items()}
        return {**values, "total": sum(values.values())}


@dataclass(frozen=True, eq=False)
class IncrementalPotential:
    """Energies to sum, and how a vertex finds the body near it.

    Args:
        stretch, bending, gravity, inertia, collision, friction: the terms; a NullTerm switches one off.
        face_centres: True for the family's nearest face centre instead of the nearest point of the true surface.
    """

    stretch: EnergyTerm = field(default_factory=Stretch)
    bending: EnergyTerm = field(default_factory=Bending)
    gravity: EnergyTerm = field(default_factory=Gravity)
    inertia: EnergyTerm = field(default_factory=Inertia)
    collision: EnergyTerm = field(default_factory=Collision)
    friction: EnergyTerm = field(default_factory=lambda: Friction(load=Collision()))
    face_centres: bool = False

    @staticmethod
    def paper_release() -> IncrementalPotential:
        """The released convention, for tables: collision per vertex at face centres, absolute height, wide friction."""
        return IncrementalPotential(
            gravity=Gravity(absolute=True),
            collision=ReleasedCollision(),
            friction=ReleasedFriction(),
            face_centres=True,
        )

    @property
    def terms(self) -> tuple[EnergyTerm, ...]:
        return self.stretch, self.bending, self.gravity, self.inertia, self.collision, self.friction

    def prepare(
        self,
        garments: PackedGarments,
        state: State,
        collider: ColliderFrame | None,
        dt: float,
        gravity: Tensor | None = None,
        contact_now: ContactPlanes | None = None,
    ) -> StepPotential:
        """The potential of the step that leaves `state`, with contacts at the step's start found once.

        Args:
            garments: static quantities.
            state: positions and velocities before the step, in the dtype of `garments`.
            collider: the bodies around the step, or None.
            dt: length of the step [s].
            gravity: (3,) [m/s^2]; standard gravity along -Y by default.
            contact_now: contacts of `state` with the bodies now, where already known.

        Raises InputError for a time step that is not positive or shapes that do not match.
        """
        require_time_step(dt)
        x = state.positions
        if x.shape != (garments.vertex_count, 3):
            raise InputError(f"Garments of {garments.vertex_count} vertices were given positions {tuple(x.shape)}.")
        pull = x.new_tensor([0.0, -9.81, 0.0]) if gravity is None else gravity.to(x)
        step = TimeStep(garments, state, collider, dt, pull, _height_origins(garments, collider, x))
        if collider is None or not len(collider.faces):
            return StepPotential(self, step, None)
        surfaces = collider_surfaces(garments, collider, whole=self.face_centres)
        if contact_now is None:
            contact_now = self.find(surfaces.at(collider.now), x.detach())
        motion = contact_now.carried(collider.following - collider.now, collider.faces)
        normals = contact_now.carried_normals(collider.following, collider.faces)
        step = replace(step, contact_now=contact_now, carried=x + motion.to(x), carried_normals=normals.to(x))
        return StepPotential(self, step, surfaces.at(collider.following))

    def find(self, posed: PosedColliders, x: Tensor) -> ContactPlanes:
        """Contacts of the vertices `x` (vertices, 3) [m] with posed bodies."""
        return posed.nearest_face_centres(x) if self.face_centres else posed.nearest(x)


@dataclass(frozen=True, eq=False)
class StepPotential:
    """The potential of one time step as a function of the next positions `x` (vertices, 3) [m].

    Unless contacts were fixed by `with_contact_at`, every evaluation finds the nearest surface at its own `x`, so its
    value and gradient are exact. With fixed contacts an evaluation makes no query and sees the body's tangent planes.

    Args:
        potential: the energies. step: what they may know. body: the bodies at t+1, or None.
    """

    potential: IncrementalPotential
    step: TimeStep
    body: PosedColliders | None

    def contact_at(self, x: Tensor) -> ContactPlanes | None:
        """The planes of the bodies at t+1 nearest to `x` (vertices, 3) [m]; None without a body."""
        if self.body is None:
            return None
        return self.potential.find(self.body, x.detach())

    def with_contact_at(self, x: Tensor) -> StepPotential:
        """This potential with the body near `x` frozen to its tangent planes."""
        return self.with_contact(self.contact_at(x))

    def with_contact(self, contact: ContactPlanes | None, opposite: ContactPlanes | None = None) -> StepPotential:
        """This potential with frozen `contact`, and planes `opposite` to it where a vertex is caught between two."""
        return replace(self, step=replace(self.step, contact_next=contact, contact_opposite=opposite))

    def energies(self, x: Tensor) -> Energies:
        """Energies at `x`; differentiable by autograd."""
        step = self._step_at(x)
        return Energies({term.name: term.energies(step, x) for term in self.potential.terms})

    def energies_and_gradient(self, x: Tensor) -> tuple[Energies, Tensor]:
        """Energies and the gradient (vertices, 3) [N] of their total, without autograd."""
        step = self._step_at(x)
        energies, gradient = {}, torch.zeros_like(x)
        for term in self.potential.terms:
            energies[term.name], part = term.energies_and_gradient(step, x)
            gradient = gradient + part
        return Energies(energies), gradient

    def curvature(self, x: Tensor) -> list[ElementBlocks]:
        """Positive semi-definite second derivatives, term by term."""
        step = self._step_at(x)
        blocks = [term.curvature(step, x) for term in self.potential.terms]
        return [b for b in blocks if b is not None]

    def buckling(self, x: Tensor) -> list[ElementBlocks]:
        """What `curvature` leaves out of the second derivatives for being negative."""
        step = self._step_at(x)
        blocks = [term.buckling(step, x) for term in self.potential.terms]
        return [b for b in blocks if b is not None]

    def _step_at(self, x: Tensor) -> TimeStep:
        if self.body is None or self.step.contact_next is not None:
            return self.step
        return replace(self.step, contact_next=self.contact_at(x))


def _height_origins(garments: PackedGarments, collider: ColliderFrame | None, x: Tensor) -> Tensor:
    """(garments, 3) the middle of each garment's body at t+1, so that heights stay small; zero without a body."""
    origins = x.new_zeros((garments.garment_count, 3))
    if collider is None or not len(collider.following):
        return origins
    owner = collider.vertex_garment
    counts = torch.bincount(owner, minlength=garments.garment_count).clamp_min(1)
    return origins.index_add(0, owner, collider.following.to(x)) / counts[:, None]
