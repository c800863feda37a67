"""Loops over the elements of an energy: what one element computes, summed over faces, hinges or vertices."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import compiled_into_callers, compiled_with_fused_products
from pb4u.physics.terms.stiffness_matrix import corner_pairs
from pb4u.scene.packed import PackedGarments

VALUE, GRADIENT, SECOND = 0, 1, 2
"""What a law computes for an element: its energy, its gradient as well, or its second derivative in place of that."""


class Record(NamedTuple):
    """All that a loop reads, in float64 on a processor: elements and their numbers.

    Args:
        corners: (elements, corners) int64 vertices.
        garment: (elements,) int64 to which each belongs.
        numbers: (elements, columns) float64, what the law of the term reads of each.
    """

    corners: np.ndarray
    garment: np.ndarray
    numbers: np.ndarray


class ElementLoops(NamedTuple):
    """The two compiled loops of a term.

    Args:
        add: called with vertices (vertices, 3) [m], the three fields of a `Record`, energies (garments,) [J] and a
            gradient (vertices, 3) [N], which may have no rows; adds to both.
        add_stiffness: called with vertices, corners, numbers, the places (elements, corner pairs) of the blocks, and
            both parts of a `Stiffness`, to which it adds.
    """

    add: Callable[..., None]
    add_stiffness: Callable[..., None]


def element_loops(law: Callable[..., float], corner_count: int) -> ElementLoops:
    """Compile the loops of a term from its law for one element.

    `law(x, corners, numbers, element, wanted, forces, blocks, factors)` returns the energy [J] of one element, whose
    numbers are the row `element`. Where GRADIENT is wanted it fills `forces` (corners, 3), dE/dx [N]; where SECOND is,
    `blocks` (corner pairs, 3, 3), the positive part of the second derivative [N/m], and, where there is a negative
    part, its multiples `factors` (corner pairs,) [N/m] of the identity.

    Args:
        law: the function of one element.
        corner_count: vertices of an element.
    """
    pair_count = len(corner_pairs(corner_count))
    compiled_law = compiled_into_callers(law)

    @compiled_with_fused_products
    def add(
        vertices: np.ndarray,
        corners: np.ndarray,
        garment: np.ndarray,
        numbers: np.ndarray,
        energies: np.ndarray,
        gradient: np.ndarray,
    ) -> None:
        forces, blocks, factors = np.zeros((corner_count, 3)), np.zeros((1, 3, 3)), np.zeros(1)
        wanted = GRADIENT if len(gradient) else VALUE
        for element in range(len(corners)):
            energy = compiled_law(vertices, corners, numbers, element, wanted, forces, blocks, factors)
            energies[garment[element]] += energy
            if wanted == GRADIENT:
                for corner in range(corner_count):
                    for axis in range(3):
                        gradient[corners[element, corner], axis] += forces[corner, axis]

    @compiled_with_fused_products
    def add_stiffness(
        vertices: np.ndarray,
        corners: np.ndarray,
        numbers: np.ndarray,
        slots: np.ndarray,
        positive: np.ndarray,
        compressive: np.ndarray,
    ) -> None:
        forces, blocks, factors = np.zeros((corner_count, 3)), np.zeros((pair_count, 3, 3)), np.zeros(pair_count)
        for element in range(len(corners)):
            compiled_law(vertices, corners, numbers, element, SECOND, forces, blocks, factors)
            pair = 0
            for first in range(corner_count):
                for second in range(first, corner_count):
                    slot = slots[element, pair]
                    compressive[slot] += factors[pair]
                    # The matrix holds one block of two vertices, that of the lower one's row.
                    if corners[element, first] > corners[element, second]:
                        for i in range(3):
                            for j in range(3):
                                positive[slot, j, i] += blocks[pair, i, j]
                    else:
                        for i in range(3):
                            for j in range(3):
                                positive[slot, i, j] += blocks[pair, i, j]
                    pair += 1

    return ElementLoops(add, add_stiffness)


def each_vertex(garments: PackedGarments) -> Tensor:
    """Indices (vertices, 1) int64 of every vertex as an element of its own, for terms that couple no two vertices.

    Args:
        garments: the packed garments.
    """
    return torch.arange(garments.vertex_count, device=garments.device)[:, None]


def vertex_record(garments: PackedGarments, *columns: np.ndarray | float) -> Record:
    """Every vertex as an element of its own.

    Args:
        garments: the packed garments.
        columns: numbers of the vertices, (vertices,) or (vertices, columns) of any unit, or one for all.
    """
    return Record(each_vertex(garments).numpy(), garments.vertex_garment.numpy(), rows(garments.vertex_count, *columns))


def rows(count: int, *columns: np.ndarray | float) -> np.ndarray:
    """Numbers (count, columns) side by side.

    Args:
        count: number of rows.
        columns: (count,) or (count, columns) of any unit, or one for all rows.
    """
    widths = [1 if np.ndim(part) < 2 else np.shape(part)[1] for part in columns]
    numbers, first = np.empty((count, sum(widths))), 0
    for part, width in zip(columns, widths, strict=True):
        numbers[:, first : first + width] = np.reshape(part, (-1, width))
        first += width
    return numbers
