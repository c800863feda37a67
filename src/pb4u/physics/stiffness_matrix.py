"""The second derivative of the potential as a sparse matrix of 3x3 blocks; its pattern is kept between steps."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.physics.energy_term import corner_pairs
from pb4u.scene.packed import PackedGarments


class StiffnessPattern:
    """Which pairs of vertices the energies couple, by the elements that they declare.

    Pinned vertices, and isolated ones, which have no mass, do not move.

    Args:
        garments: static quantities on the CPU.
        elements: of the terms that have any, name -> vertex indices (elements, corners) int64.

    Attributes:
        free: (vertices,) bool, whether a vertex moves.
        own_entries: (vertices,) int64 index of the entry that is the diagonal block of each vertex.
    """

    def __init__(self, garments: PackedGarments, elements: Mapping[str, Tensor]) -> None:
        self.vertex_count = count = garments.vertex_count
        self.free = ~garments.pinned & (garments.vertex_masses > 0)
        self._elements = elements
        # Every vertex has a block of its own, whatever the energies.
        ends = [_pair_ends(e) for e in (torch.arange(count)[:, None], *elements.values())]
        # Energies are summed once for each two vertices that they couple; the matrix holds the sum and its transpose.
        keys = [torch.minimum(i, j) * count + torch.maximum(i, j) for i, j in ends]
        coupled = torch.unique(torch.cat(keys))
        self._coupled_count = len(coupled)
        self._slots = {
            name: self._axes(torch.searchsorted(coupled, k), i > j).reshape(-1)
            for name, k, (i, j) in zip(elements, keys[1:], ends[1:], strict=True)
        }
        low, high = torch.div(coupled, count, rounding_mode="floor"), coupled % count
        apart = torch.nonzero(low != high)[:, 0]
        rows, columns = torch.cat([low, high[apart]]), torch.cat([high, low[apart]])
        order = torch.argsort(rows * count + columns)
        rows, columns = rows[order], columns[order]
        source = torch.cat([torch.arange(len(coupled)), apart])[order]
        self._mirror = self._axes(source, order >= len(coupled)).permute(2, 0, 1).reshape(-1)
        self.own_entries = torch.nonzero(rows == columns)[:, 0].numpy()
        self._indices = columns.to(torch.int32)
        self._indptr = torch.searchsorted(rows, torch.arange(count + 1)).to(torch.int32)
        self._held = torch.nonzero(~(self.free[rows] & self.free[columns]))[:, 0]

    def couples(self, elements: Mapping[str, Tensor]) -> bool:
        """Whether this is the pattern of `elements`, name of a term -> vertex indices (elements, corners) int64."""
        same = self._elements.keys() == elements.keys()
        return same and all(torch.equal(part, elements[name]) for name, part in self._elements.items())

    def assemble(self, blocks: Mapping[str, Tensor]) -> np.ndarray:
        """Entries (entries, 3, 3) [N/m] of the matrix; those of a vertex that does not move are zero.

        Args:
            blocks: second derivatives of each term by name, (3, 3, pairs, elements) [J/m^2].
        """
        sums = torch.zeros(9 * self._coupled_count, dtype=torch.float64)
        for name, values in blocks.items():
            sums.scatter_add_(0, self._slots[name], values.reshape(-1))
        entries = sums.index_select(0, self._mirror).reshape(-1, 3, 3)
        entries[self._held] = 0.0
        return entries.numpy()

    def _axes(self, pair: Tensor, turned: Tensor) -> Tensor:
        """(3, 3, n) where the sums of a `pair` (n,) are, axis by axis, with the axes exchanged where `turned` (n,)."""
        axes = torch.arange(9).reshape(3, 3)
        return torch.where(turned, axes.T[:, :, None], axes[:, :, None]) * self._coupled_count + pair

    def matrix(self, entries: np.ndarray) -> Any:
        """Scipy BSR matrix (3 vertices, 3 vertices) of assembled `entries` (entries, 3, 3) [N/m]."""
        from scipy.sparse import bsr_matrix

        size = 3 * self.vertex_count
        return bsr_matrix((entries, self._indices.numpy(), self._indptr.numpy()), shape=(size, size))

    def product(self, entries: np.ndarray) -> Any:
        """Matrix of assembled `entries` (entries, 3, 3) [N/m] that multiplies vectors (3 vertices,) fastest."""
        if torch.backends.mkl.is_available():  # type: ignore[no-untyped-call]
            return _MklProduct(self._indptr, self._indices, entries)
        return self.matrix(entries)

    def diagonal(self, entries: np.ndarray) -> np.ndarray:
        """Diagonal blocks (vertices, 3, 3) [N/m] of the matrix; the identity where a vertex does not move.

        Args:
            entries: (entries, 3, 3) [N/m] assembled.
        """
        blocks = entries[self.own_entries]
        blocks[~self.free.numpy()] = np.eye(3)
        return blocks


class _MklProduct:
    """A sparse matrix of 3x3 blocks whose products with vectors are MKL's: twice as fast as scipy's."""

    def __init__(self, indptr: Tensor, indices: Tensor, entries: np.ndarray) -> None:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse BSR tensor support is in beta")
            size = 3 * (len(indptr) - 1)
            self._matrix = torch.sparse_bsr_tensor(
                indptr, indices, torch.from_numpy(entries), size=(size, size), check_invariants=False
            )

    def __matmul__(self, vector: np.ndarray) -> np.ndarray:
        product: np.ndarray = torch.mv(self._matrix, torch.from_numpy(vector)).numpy()
        return product


def _pair_ends(elements: Tensor) -> tuple[Tensor, Tensor]:
    """First and second vertex (pairs elements,) of every pair of corners of `elements` (elements, k)."""
    first, second = zip(*corner_pairs(elements.shape[1]), strict=True)
    return elements[:, list(first)].T.reshape(-1), elements[:, list(second)].T.reshape(-1)
