"""Energy terms of the incremental potential: functions of the next positions with gradient and second derivative."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.element_loops import ElementLoops, Record
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern
from pb4u.physics.time_step import TimeStep

Tangent = Callable[[np.ndarray, Stiffness, np.ndarray, np.ndarray], None]
"""A term's part of the quadratic model of a Newton step, which is relinearised where the step leads.

Contact that begins, and friction that holds, change their force within a step far more than their second derivative
where it begins can tell. Called with the moves (vertices, 3) [m] of the step, the stiffness and the gradient
(vertices, 3) [N] of the model, both changed, and forces (vertices, 3) [N] to which is added by how much the model was
wrong where the moves lead.
"""


class EnergyTerm(ABC):
    """One term of the potential; implementations are stateless.

    It is written twice: `energies` in torch, for an accelerator, and `loops` over its `records` a step, compiled,
    for everything on a processor.

    Attributes:
        name: by which results and tables refer to it.
        loops: its compiled loops; None for a term whose `add` is its own, or that of torch.
        reads_contacts: whether its `records` read the contacts at a step's start.
        pushes_apart: whether it is a contact force, which changes velocities abruptly.
    """

    name: str
    loops: ClassVar[ElementLoops | None] = None
    reads_contacts: ClassVar[bool] = True
    pushes_apart: bool = False

    @abstractmethod
    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        """Energies (garments,) [J] at `x`, in its dtype and on its device; differentiable by autograd.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """

    def acts_on(self, step: TimeStep) -> bool:
        """Whether it is anything but zero wherever the step may lead.

        Args:
            step: the time step.
        """
        return True

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        """Energies (garments,) [J] and the gradient (vertices, 3) [N] of their sum; not differentiable.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """
        energies, pulled_back, *_ = torch.func.vjp(lambda at: self.energies(step, contacts, at), x.detach())
        return energies, pulled_back(torch.ones_like(energies))[0]

    def add(
        self, step: TimeStep, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray
    ) -> None:
        """Add the energies at `x`, and the gradient of their sum; not differentiable.

        Args:
            step: the time step, on a processor.
            contacts: contacts of the step.
            x: (vertices, 3) float64 [m] next positions.
            energies: (garments,) [J], added to.
            gradient: (vertices, 3) [N], added to; without rows if not requested.
        """
        at = torch.from_numpy(x)
        if len(gradient):
            values, slope = self.energies_and_gradient(step, contacts, at)
            gradient += as_float64(slope)
        else:
            values = self.energies(step, contacts, at)
        energies += as_float64(values)

    def size(self, contacts: ContactSet) -> int:
        """How much its loops go through, in corners of elements; 0 of a term without.

        Args:
            contacts: contacts of the step.
        """
        return 0

    def _added(
        self, step: TimeStep, contacts: ContactSet, x: Tensor, *, gradient: bool = True
    ) -> tuple[Tensor, Tensor]:
        """Energies (garments,) [J] and the gradient (vertices, 3) [N] of a term that has an `add` of its own."""
        energies = np.zeros(step.garments.garment_count)
        slope = np.zeros((len(x) if gradient else 0, 3))
        self.add(step, contacts, as_float64(x), energies, slope)
        return torch.from_numpy(energies).to(x.dtype), torch.from_numpy(slope).to(x.dtype)

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor | None:
        """Vertices (elements, corners) int64 that the term couples; None where its second derivative is zero.

        Args:
            step: the time step.
            contacts: contacts of the step.
        """
        return None

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        """What the `loops` read, gathered once a step, as a function of the contacts where the term is evaluated.

        Args:
            step: the time step, on a processor.
            contacts: contacts at its start.
        """
        raise NotImplementedError(f"the term {self.name} has no compiled loops")

    def tangents(
        self, step: TimeStep, x: np.ndarray, records: Sequence[Record], pattern: StiffnessPattern
    ) -> list[Tangent]:
        """Its parts of the model of a Newton step that can be relinearised.

        Args:
            step: the time step.
            x: (vertices, 3) [m] at the start of the Newton step.
            records: what the `loops` read there.
            pattern: of the stiffness.
        """
        return []

    def compiled(self, step: TimeStep, contacts: ContactSet) -> EnergyTerm:
        """This term for one step on a processor: compiled, in float64, its gradient known to autograd.

        Args:
            step: the time step.
            contacts: contacts at its start.
        """
        return self if self.loops is None else CompiledTerm(self, self.loops, step, contacts)

    def pair_stiffness(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> PairStiffness | None:
        """Positive semi-definite second derivative over pairs of cloth elements that change with `x`; None where zero.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """
        return None


class CompiledTerm(EnergyTerm):
    """A term for one particular step: its loops over its records.

    Args:
        term: the term.
        loops: of the term.
        step: the time step.
        contacts: contacts at its start.
    """

    def __init__(self, term: EnergyTerm, loops: ElementLoops, step: TimeStep, contacts: ContactSet) -> None:
        self.term, self.name, self._loops = term, term.name, loops
        self.pushes_apart = term.pushes_apart
        self._made_for = step, contacts
        self._size = 0

    @cached_property
    def _records_at(self) -> Callable[[ContactSet], Sequence[Record]]:
        step, contacts = self._made_for
        # Several potentials of one step, as those of its start and of its end, have most terms in common.
        key = self.term, contacts if self.term.reads_contacts else None
        if key not in step.records:
            step.records[key] = self.term.records(step, contacts)
        return step.records[key]

    def gather(self) -> None:
        """Gather what the loops read of the step."""
        self._records_at  # noqa: B018

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        if not x.requires_grad:
            return self._added(step, contacts, x, gradient=False)[0]
        return _KnownGradient.apply(x, self, step, contacts)  # type: ignore[no-untyped-call]

    energies_and_gradient = EnergyTerm._added

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor | None:
        return self.term.elements(step, contacts)

    def add(
        self, step: TimeStep, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray
    ) -> None:
        for record in self._records_at(contacts):
            self._loops.add(x, *record, energies, gradient)

    def size(self, contacts: ContactSet) -> int:
        # Elements are the same all step; some records are made for each of the contacts.
        self._size = self._size or sum(record.corners.size for record in self._records_at(contacts))
        return self._size

    def add_stiffness(self, contacts: ContactSet, x: np.ndarray, slots: np.ndarray, stiffness: Stiffness) -> None:
        """Add the second derivative, or an approximation.

        Args:
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
            slots: (elements, corner pairs) int32 positions of its blocks in the stiffness.
            stiffness: added to.
        """
        for corners, _, numbers in self._records_at(contacts):
            self._loops.add_stiffness(x, corners, numbers, slots, stiffness.positive, stiffness.compressive)

    def tangents_at(
        self, step: TimeStep, contacts: ContactSet, x: np.ndarray, pattern: StiffnessPattern
    ) -> list[Tangent]:
        """Its parts of the model of a Newton step that can be relinearised.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] at the start of the Newton step.
            pattern: of the stiffness.
        """
        return self.term.tangents(step, x, self._records_at(contacts), pattern)


class _KnownGradient(torch.autograd.Function):
    """The energies of a compiled term, whose gradient its loops know."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, term: CompiledTerm, step: TimeStep, contacts: ContactSet) -> Tensor:
        energies, gradient = term.energies_and_gradient(step, contacts, x)
        ctx.save_for_backward(gradient, step.garments.vertex_garment)
        return energies

    @staticmethod
    def backward(ctx: Any, slopes: Tensor) -> tuple[Tensor, None, None, None]:
        gradient, garment = ctx.saved_tensors
        return slopes[garment, None] * gradient, None, None, None


@lru_cache
def constant(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Tensor of `values`, in their unit, created once, since an accelerator waits for each creation.

    Args:
        values: any numbers.
        dtype: of the tensor.
        device: of the tensor.
    """
    with torch.inference_mode(False):
        return torch.tensor(values, dtype=dtype, device=device)


def sum_by_garment(values: Tensor, garment: Tensor, garment_count: int) -> Tensor:
    """Sums (garments,) of `values` over the rows that belong to each garment, in their unit.

    Args:
        values: (rows,) of any unit.
        garment: (rows,) int64 to which each belongs.
        garment_count: number of garments.
    """
    if garment_count == 1:
        return values.sum().reshape(1)
    return values.new_zeros(garment_count).index_add(0, garment, values)


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Inner products (...,) of vectors row by row, in the product of their units.

    Args:
        a: (..., 3) vectors of any unit.
        b: (..., 3) vectors of any unit.
    """
    # Four times faster than a sum over so short an axis.
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
