"""Second derivative of the potential: a sparse symmetric matrix of 3x3 blocks, its pattern kept between steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import compiled_with_fused_products
from pb4u.collision.lanes import (
    as_doubles,
    block_at,
    lane,
    lanes_at,
    put_lanes,
    spread,
    sum_of_three,
    sums_of_three,
)
from pb4u.scene.packed import PackedGarments


def corner_pairs(corners: int) -> list[tuple[int, int]]:
    """Pairs (i, j), i <= j, of the corners of an element, in row order.

    Args:
        corners: number of corners.
    """
    return list(combinations_with_replacement(range(corners), 2))


class StiffnessPattern:
    """Which pairs of vertices the energies couple, by the elements that they declare.

    A pair is stored once, in the row of its lower vertex; the diagonal block comes first in its row. Pinned
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
        """Remove from `stiffness` the entries of vertices that do not move.

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
            before: an earlier matrix that differs only in the diagonal blocks of the positive part; changed. None for
                none.
        """
        if not share and extra is None and precision is np.float64:
            return SymmetricBlocks(self.pattern.starts, self.pattern.columns, self.positive)
        blocks = np.empty(self.positive.shape, precision) if before is None else before.blocks
        extra = np.zeros(0) if extra is None else extra
        _fill(self.positive, self.compressive, self.pattern.starts, share, extra, before is not None, blocks)
        return SymmetricBlocks(self.pattern.starts, self.pattern.columns, blocks)


@dataclass(frozen=True, eq=False)
class SymmetricBlocks:
    """A sparse symmetric matrix of 3x3 blocks, of which the upper half is stored.

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
        return self.blocks[self.starts[:-1]]


def _pair_keys(elements: Tensor, count: int) -> Tensor:
    """Numbers (elements, corner pairs) that are the same for the same two of `count` vertices, ascending by row."""
    first, second = zip(*corner_pairs(elements.shape[1]), strict=True)
    i, j = elements[:, list(first)], elements[:, list(second)]
    return torch.minimum(i, j) * count + torch.maximum(i, j)


@compiled_with_fused_products
def _fill(
    positive: np.ndarray,
    compressive: np.ndarray,
    starts: np.ndarray,
    share: float,
    extra: np.ndarray,
    own: bool,
    result: np.ndarray,
) -> None:
    """Fill `result` with the `positive` blocks (blocks, 3, 3), a `share` of the `compressive` ones and `extra`.

    `own`: of no more than the diagonal ones. Without `extra` (vertices,) there is none.
    """
    for row in range(len(starts) - 1):
        for block in range(starts[row], starts[row] + 1 if own else starts[row + 1]):
            shift = share * compressive[block]
            if block == starts[row] and len(extra):
                shift += extra[row]
            for i in range(3):
                for j in range(3):
                    result[block, i, j] = positive[block, i, j] + (shift if i == j else 0.0)


@compiled_with_fused_products
def multiply(
    starts: np.ndarray, columns: np.ndarray, blocks: np.ndarray, vector: np.ndarray, product: np.ndarray
) -> float:
    """Fill `product` with the `SymmetricBlocks` times `vector`, and give back the inner product of the two.

    Args:
        starts: (vertices + 1,) int32 first entry of each row.
        columns: (entries,) int32 column of each entry.
        blocks: (entries, 3, 3) [N/m].
        vector: (vertices, 4) [m], whatever the fourth is.
        product: (vertices, 4) [N], filled.
    """
    zero, total = spread(blocks.dtype.type(0.0)), spread(0.0)
    for row in range(len(product)):
        put_lanes(product, 4 * row, zero)
    for row in range(len(product)):
        own, here = starts[row], lanes_at(vector, 4 * row)
        x, y, z = spread(lane(here, 0)), spread(lane(here, 1)), spread(lane(here, 2))
        a, b, c = zero, zero, zero
        for block in range(own + 1, starts[row + 1]):
            there = 4 * columns[block]
            other = lanes_at(vector, there)
            # Behind a block the array goes on: that of the last vertex comes last, and is its own.
            first, second, third = (
                lanes_at(blocks, 9 * block),
                lanes_at(blocks, 9 * block + 3),
                lanes_at(blocks, 9 * block + 6),
            )
            a, b, c = first * other + a, second * other + b, third * other + c
            put_lanes(product, there, lanes_at(product, there) + (first * x + (second * y + third * z)))
        first, second, third = block_at(blocks, own)
        upper, diagonal = sums_of_three(a, b, c), first * x + (second * y + third * z)
        put_lanes(product, 4 * row, lanes_at(product, 4 * row) + (upper + diagonal))
        total = total + as_doubles(here * (diagonal + (upper + upper)))
    return sum_of_three(total)
