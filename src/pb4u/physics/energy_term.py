"""What every energy of the incremental potential is: a function of the next positions, its gradient and curvature."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from itertools import combinations_with_replacement

import torch
from torch import Tensor

from pb4u.physics.contact_planes import ContactPlanes
from pb4u.scene.packed import ColliderFrame, PackedGarments
from pb4u.scene.state import State


@dataclass(frozen=True, eq=False)
class TimeStep:
    """All that an energy may know about the step from frame t to t+1.

    Args:
        garments: static quantities.
        state: positions [m] and velocities [m/s] at frame t.
        collider: the bodies around the step, or None.
        dt: length of the step [s].
        gravity: (3,) [m/s^2].
        height_origin: (garments, 3) point where each garment's height energy is zero [m].
        contact_now: for each vertex at frame t, the plane of the body that it may slide on, or None.
        contact_next: for each vertex at frame t+1, the plane of the body that it may enter, or None.
        contact_opposite: a second plane for vertices caught between two parts of the body, or None.
        carried: (vertices, 3) where the body under each vertex takes it over the step [m], or None.
        carried_normals: (vertices, 3) the body's normals there, or None.
    """

    garments: PackedGarments
    state: State
    collider: ColliderFrame | None
    dt: float
    gravity: Tensor
    height_origin: Tensor
    contact_now: ContactPlanes | None = field(default=None)
    contact_next: ContactPlanes | None = field(default=None)
    contact_opposite: ContactPlanes | None = field(default=None)
    carried: Tensor | None = field(default=None)
    carried_normals: Tensor | None = field(default=None)

    @property
    def ground_height(self) -> float | None:
        return None if self.collider is None else self.collider.ground_height


@dataclass(frozen=True, eq=False)
class ElementBlocks:
    """Second derivatives of an energy, one symmetric matrix per element; elements come last, which is fastest.

    Args:
        vertices: (elements, k) int64.
        blocks: (3, 3, pairs, elements) [J/m^2], one for each of the `corner_pairs`; those of (j, i) are those of (i, j)
            with their axes exchanged.
    """

    vertices: Tensor
    blocks: Tensor


class EnergyTerm(ABC):
    """One term of the potential. Implementations are stateless and follow the dtype and device of `x`."""

    name: str

    @abstractmethod
    def energies(self, step: TimeStep, x: Tensor) -> Tensor:
        """(garments,) energies [J] at the next positions `x` (vertices, 3) [m]; differentiable."""

    @abstractmethod
    def energies_and_gradient(self, step: TimeStep, x: Tensor) -> tuple[Tensor, Tensor]:
        """The energies and the gradient (vertices, 3) [N] of their sum, by hand, without autograd."""

    @abstractmethod
    def curvature(self, step: TimeStep, x: Tensor) -> ElementBlocks | None:
        """The second derivative or a good approximation, positive semi-definite; None where it is zero."""

    def buckling(self, step: TimeStep, x: Tensor) -> ElementBlocks | None:
        """What `curvature` leaves out for being negative; None where that is nothing."""
        return None


class NullTerm(EnergyTerm):
    """A term switched off: zero everywhere, under the name of the one that it stands for."""

    def __init__(self, name: str) -> None:
        self.name = name

    def energies(self, step: TimeStep, x: Tensor) -> Tensor:
        return x.new_zeros(step.garments.garment_count)

    def energies_and_gradient(self, step: TimeStep, x: Tensor) -> tuple[Tensor, Tensor]:
        return self.energies(step, x), torch.zeros_like(x)

    def curvature(self, step: TimeStep, x: Tensor) -> ElementBlocks | None:
        return None


def gradient_by_autograd(term: EnergyTerm, step: TimeStep, x: Tensor) -> tuple[Tensor, Tensor]:
    """Energies and gradient of a term that is measured rather than minimised."""
    with torch.enable_grad():
        variable = x.detach().requires_grad_(True)
        energies = term.energies(step, variable)
        if not energies.requires_grad:
            return energies, torch.zeros_like(x)
        (gradient,) = torch.autograd.grad(energies.sum(), variable)
    return energies.detach(), gradient


def sum_by_garment(values: Tensor, garment: Tensor, garment_count: int) -> Tensor:
    """(garments,) sums of `values` (n,) over the rows that belong to each garment."""
    if garment_count == 1:
        return values.sum().reshape(1)
    return values.new_zeros(garment_count).index_add(0, garment, values)


def corner_pairs(corners: int) -> list[tuple[int, int]]:
    """Pairs (i, j), i <= j, of the corners of an element, in row order."""
    return list(combinations_with_replacement(range(corners), 2))


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Row-wise inner product (...,) of (..., 3) vectors."""
    # Four times faster than a sum over so short an axis.
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def columns(x: Tensor, index: Tensor) -> Tensor:
    """(3, n) the rows of `x` (vertices, 3) at `index` (n,), laid out axis by axis."""
    return x.T.contiguous().gather(1, index.expand(3, -1))


def outer(a: Tensor, b: Tensor) -> Tensor:
    """Outer products (3, 3, n) of (3, n) vectors."""
    return a[:, None] * b[None]


def sum_by_vertex(values: Tensor, index: Tensor, vertex_count: int) -> Tensor:
    """(vertices, 3) sums of `values` (3, n) over the columns that belong to each vertex `index` (n,)."""
    total = values.new_zeros((3, vertex_count))
    return total.scatter_add_(1, index.expand(3, -1), values).T.contiguous()
