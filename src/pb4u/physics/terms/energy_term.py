"""Energy terms of the incremental potential: functions of the next positions with gradient and curvature."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments

Tangent = Callable[[np.ndarray, Stiffness, np.ndarray, np.ndarray], None]
"""A term's part of the quadratic model of a Newton step, which is relinearised where the step leads.

Contact that begins, and friction that holds, change their force within a step far more than their second derivative
where it begins can tell. Called with the moves (vertices, 3) [m] of the step, the stiffness and the gradient
(vertices, 3) [N] of the model, both changed, and forces (vertices, 3) [N] to which is added by how much the model was
wrong where the moves lead.
"""


class EnergyTerm(ABC):
    """One term of the potential. Implementations are stateless and follow the dtype and device of `x`.

    Attributes:
        name: by which results and tables refer to it.
    """

    name: str

    @abstractmethod
    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        """Energies (garments,) [J] at `x`; differentiable by autograd.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """

    @abstractmethod
    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        """Energies (garments,) [J] and the gradient (vertices, 3) [N] of their sum, by hand, without autograd.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor | None:
        """Vertex indices (elements, corners) int64 that the term couples; None where its second derivative is zero.

        Args:
            step: the time step.
            contacts: contacts of the step.
        """
        return None

    def compiled(self, step: TimeStep, contacts: ContactSet) -> EnergyTerm:
        """This term as the solver evaluates it: compiled for one step, without autograd.

        Args:
            step: the time step, its garments in float64 on the CPU.
            contacts: contacts at its start.
        """
        return self

    def pair_stiffness(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> PairStiffness | None:
        """Positive semi-definite second derivative over pairs of cloth elements that change with `x`; None where zero.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
        """
        return None


class CompiledTerm(EnergyTerm):
    """A term as the solver evaluates it: compiled for the step that it was made for, in float64, without autograd."""

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        return self._evaluated(step, contacts, x, 0)[0]

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        return self._evaluated(step, contacts, x, len(x))

    def _evaluated(self, step: TimeStep, contacts: ContactSet, x: Tensor, rows: int) -> tuple[Tensor, Tensor]:
        energies, gradient = np.zeros(step.garments.garment_count), np.zeros((rows, 3))
        self.add(contacts, as_float64(x), energies, gradient)
        return torch.from_numpy(energies), torch.from_numpy(gradient)

    @abstractmethod
    def add(self, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray) -> None:
        """Add to energies that are 0, and to their gradient.

        Args:
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
            energies: (garments,) [J].
            gradient: (vertices, 3) [N], dE/dx; without rows where the energies alone are wanted.
        """

    def add_stiffness(self, contacts: ContactSet, x: np.ndarray, slots: np.ndarray, stiffness: Stiffness) -> None:
        """Add the second derivative, or one near it; a term without `elements` has none.

        Args:
            contacts: contacts of the step.
            x: (vertices, 3) [m] next positions.
            slots: (elements, corner pairs) int32 where the `corner_pairs` of the `elements` are in the stiffness.
            stiffness: added to.
        """

    def tangents(self, step: TimeStep, contacts: ContactSet, x: np.ndarray, pattern: StiffnessPattern) -> list[Tangent]:
        """Its parts of the model of a Newton step that can be relinearised.

        Args:
            step: the time step.
            contacts: contacts of the step.
            x: (vertices, 3) [m] where the step begins.
            pattern: of the stiffness.
        """
        return []


@lru_cache
def constant(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Tensor of `values`, in their unit, made once: an accelerator would wait for each.

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


def columns(x: Tensor, index: Tensor) -> Tensor:
    """Rows of `x` at `index`, laid out axis by axis: (3, n) [m].

    Args:
        x: (vertices, 3) [m].
        index: (n,) int64 vertices.
    """
    return x.T.contiguous().gather(1, index.expand(3, -1))


def vertex_elements(garments: PackedGarments) -> Tensor:
    """Indices (vertices, 1) int64 of every vertex as an element of its own, for terms that couple no two vertices.

    Args:
        garments: the packed garments.
    """
    return torch.arange(garments.vertex_count, device=garments.device)[:, None]


def sum_by_vertex(values: Tensor, index: Tensor, vertex_count: int) -> Tensor:
    """Sums (vertices, 3) of `values` over the columns that belong to each vertex, in their unit.

    Args:
        values: (3, columns) of any unit.
        index: (columns,) int64 vertex of each.
        vertex_count: number of vertices.
    """
    total = values.new_zeros((3, vertex_count))
    return total.scatter_add(1, index.expand(3, -1), values).T.contiguous()
