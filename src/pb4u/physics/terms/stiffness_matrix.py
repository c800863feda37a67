"""Second derivative of the potential: a sparse symmetric matrix of 3x3 blocks, its pattern kept between steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import compiled_with_fused_products
from pb4u.scene.packed import PackedGarments


def corner_pairs(corners: int) -> list[tuple[int, int]]:
    """Pairs (i, j), i <= j, of the corners of an element, in row order.

    Args:
        corners: number of corners.
    """
    return list(combinations_with_replacement(range(corners), 2))


class StiffnessPattern:
    """Which pairs of vertices the energies couple, by the elements that they declare.

    A pair is held once, in the row of its lower vertex; that of a vertex with itself comes first in its row. Pinned
    vertices, and isolated ones, which have no mass, do not move.

    Args:
        garments: static quantities on the CPU.
        elements: of the terms that have any, name -> vertex indices (elements, corners) int64.

    Attributes:
        free: (vertices,) bool, whether a vertex moves.
        starts: (vertices + 1,) int32 first pair of each row, and the total.
        columns: (pairs,) int32 higher vertex of each pair.
        slots: name of a term -> (elements, corner pairs) int32 pair to which each of the `corner_pairs` adds.
    """

    def __init__(self, garments: PackedGarments, elements: Mapping[str, Tensor]) -> None:
        self.vertex_count = count = garments.vertex_count
        free = ~garments.pinned & (garments.vertex_masses > 0)
        self.free = free.numpy()
        self._elements = elements
        # Every vertex is coupled with itself, whatever the energies.
        own = torch.arange(count)[:, None]
        keys = {name: _pair_keys(part, count) for name, part in elements.items()}
        pairs = torch.unique(torch.cat([_pair_keys(own, count).reshape(-1), *(k.reshape(-1) for k in keys.values())]))
        rows, columns = torch.div(pairs, count, rounding_mode="floor"), pairs % count
        self.starts = torch.searchsorted(rows, torch.arange(count + 1)).to(torch.int32).numpy()
        self.columns = columns.to(torch.int32).numpy()
        self.slots = {name: torch.searchsorted(pairs, key).to(torch.int32).numpy() for name, key in keys.items()}
        self._held = torch.nonzero(~(free[rows] & free[columns]))[:, 0].numpy()

    def couples(self, elements: Mapping[str, Tensor]) -> bool:
        """Whether this is the pattern of `elements`, name of a term -> vertex indices (elements, corners) int64.

        Args:
            elements: name of a term -> (elements, corners) int64.
        """
        same = self._elements.keys() == elements.keys()
        return same and all(torch.equal(part, elements[name]) for name, part in self._elements.items())

    def empty(self) -> Stiffness:
        """A stiffness of this pattern without any entry."""
        return Stiffness(self, np.zeros((len(self.columns), 3, 3)), np.zeros(len(self.columns)))

    def hold(self, stiffness: Stiffness) -> None:
        """Take out of `stiffness` what acts on vertices that do not move.

        Args:
            stiffness: the matrix, changed.
        """
        stiffness.positive[self._held] = 0.0
        stiffness.compressive[self._held] = 0.0


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Second derivative of the energies in two parts, to which each term adds.

    Args:
        pattern: which pairs of vertices it couples.
        positive: (pairs, 3, 3) [N/m] the positive semi-definite part.
        compressive: (pairs,) [N/m] the negative part, along which cloth buckles: factors of the identity.
    """

    pattern: StiffnessPattern
    positive: np.ndarray
    compressive: np.ndarray

    def matrix(
        self,
        share: float = 0.0,
        extra: np.ndarray | None = None,
        precision: type[np.floating] = np.float64,
        before: SymmetricBlocks | None = None,
    ) -> SymmetricBlocks:
        """The matrix with a `share` of the compressive part and `extra` (vertices,) [N/m] on its diagonal.

        Args:
            share: of the compressive part.
            extra: (vertices,) [N/m].
            precision: data type that the sums are rounded to.
            before: the same, made when no more than the positive part's diagonal blocks was other; changed. None for
                none.
        """
        own = self.pattern.starts[:-1]
        if before is not None:
            shift = share * self.compressive[own]
            _shift(self.positive, shift if extra is None else shift + extra, before.blocks, own)
            return before
        blocks = self.positive
        if share or extra is not None or precision is not np.float64:
            shift = share * self.compressive
            if extra is not None:
                shift[own] += extra
            blocks = np.empty(blocks.shape, precision)
            _shift(self.positive, shift, blocks, np.arange(len(blocks)))
        return SymmetricBlocks(self.pattern.starts, self.pattern.columns, blocks)


@dataclass(frozen=True, eq=False)
class SymmetricBlocks:
    """A sparse symmetric matrix of 3x3 blocks, of which the upper half is held.

    Args:
        starts: (vertices + 1,) int32 first block of each row, its diagonal one; the last entry is the number of blocks.
        columns: (blocks,) int32.
        blocks: (blocks, 3, 3) [N/m].
    """

    starts: np.ndarray
    columns: np.ndarray
    blocks: np.ndarray

    @property
    def diagonal(self) -> np.ndarray:
        """Diagonal blocks (vertices, 3, 3) [N/m], a copy."""
        own: np.ndarray = self.blocks[self.starts[:-1]]
        return own

    def __matmul__(self, vector: np.ndarray) -> np.ndarray:
        """Product (vertices, 3) [N] with a `vector` (vertices, 3) [m]."""
        product = np.empty_like(vector)
        multiply(self.starts, self.columns, self.blocks, vector, product)
        return product

    def toarray(self) -> Any:
        """The whole matrix (3 vertices, 3 vertices) [N/m]."""
        count = len(self.starts) - 1
        rows = np.repeat(np.arange(count), np.diff(self.starts))
        whole = np.zeros((count, 3, count, 3))
        whole[self.columns, :, rows] = self.blocks.transpose(0, 2, 1)
        whole[rows, :, self.columns] = self.blocks
        return whole.reshape(3 * count, 3 * count)


def _pair_keys(elements: Tensor, count: int) -> Tensor:
    """Numbers (elements, corner pairs) that are the same for the same two of `count` vertices, ascending by row."""
    first, second = zip(*corner_pairs(elements.shape[1]), strict=True)
    i, j = elements[:, list(first)], elements[:, list(second)]
    return torch.minimum(i, j) * count + torch.maximum(i, j)


@compiled_with_fused_products
def _shift(blocks: np.ndarray, shift: np.ndarray, result: np.ndarray, chosen: np.ndarray) -> None:
    """Fill the `chosen` of `result` with `blocks` (blocks, 3, 3) and multiples `shift` (chosen,) of the identity."""
    for row in range(len(chosen)):
        block = chosen[row]
        for i in range(3):
            for j in range(3):
                result[block, i, j] = blocks[block, i, j] + (shift[row] if i == j else 0.0)


@compiled_with_fused_products
def multiply(
    starts: np.ndarray, columns: np.ndarray, blocks: np.ndarray, vector: np.ndarray, product: np.ndarray
) -> None:
    """Fill `product` (vertices, 3) [N] with the `SymmetricBlocks` times `vector` (vertices, 3) [m].

    Args:
        starts: (vertices + 1,) int64 first entry of each row.
        columns: (entries,) int64 column of each entry.
        blocks: (entries, 3, 3) [N/m].
        vector: (vertices, 3) [m].
        product: (vertices, 3) [N], filled.
    """
    for row in range(len(product)):
        for axis in range(3):
            product[row, axis] = 0.0
    for row in range(len(product)):
        own = starts[row]
        x, y, z = vector[row, 0], vector[row, 1], vector[row, 2]
        a = blocks[own, 0, 0] * x + blocks[own, 0, 1] * y + blocks[own, 0, 2] * z
        b = blocks[own, 1, 0] * x + blocks[own, 1, 1] * y + blocks[own, 1, 2] * z
        c = blocks[own, 2, 0] * x + blocks[own, 2, 1] * y + blocks[own, 2, 2] * z
        for block in range(own + 1, starts[row + 1]):
            column = columns[block]
            u, v, w = vector[column, 0], vector[column, 1], vector[column, 2]
            a += blocks[block, 0, 0] * u + blocks[block, 0, 1] * v + blocks[block, 0, 2] * w
            b += blocks[block, 1, 0] * u + blocks[block, 1, 1] * v + blocks[block, 1, 2] * w
            c += blocks[block, 2, 0] * u + blocks[block, 2, 1] * v + blocks[block, 2, 2] * w
            product[column, 0] += blocks[block, 0, 0] * x + blocks[block, 1, 0] * y + blocks[block, 2, 0] * z
            product[column, 1] += blocks[block, 0, 1] * x + blocks[block, 1, 1] * y + blocks[block, 2, 1] * z
            product[column, 2] += blocks[block, 0, 2] * x + blocks[block, 1, 2] * y + blocks[block, 2, 2] * z
        product[row, 0] += a
        product[row, 1] += b
        product[row, 2] += c
