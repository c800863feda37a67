"""The second derivative of the potential as a sparse matrix of 3x3 blocks; its pattern is found once per pack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.physics.energy_term import ElementBlocks
from pb4u.scene.packed import PackedGarments


class StiffnessPattern:
    """Which pairs of vertices any energy couples: those that share a face or a hinge.

    Pinned vertices, and isolated ones, which have no mass, do not move.

    Args:
        garments: static quantities on the CPU.

    Attributes:
        free: (vertices,) bool, whether a vertex moves.
        own_entries: (vertices,) which entry is the diagonal block of each vertex.
    """

    def __init__(self, garments: PackedGarments) -> None:
        self.vertex_count = garments.vertex_count
        self.free = ~garments.pinned & (garments.vertex_masses > 0)
        self._elements = (garments.faces, garments.hinges)
        own = torch.arange(self.vertex_count) * (self.vertex_count + 1)
        keys = [own, *(self._pair_keys(e) for e in self._elements)]
        self._keys = torch.unique(torch.cat(keys))
        self._slots = [torch.searchsorted(self._keys, key) for key in keys]
        self.own_entries = self._slots[0].numpy()
        rows = torch.div(self._keys, self.vertex_count, rounding_mode="floor")
        columns = self._keys % self.vertex_count
        self._indices = columns.to(torch.int32).numpy()
        starts = torch.arange(self.vertex_count + 1) * self.vertex_count
        self._indptr = torch.searchsorted(self._keys, starts).to(torch.int32).numpy()
        self._moves = (self.free[rows] & self.free[columns]).to(torch.float64)

    def assemble(self, elements: Sequence[ElementBlocks]) -> np.ndarray:
        """(entries, 3, 3) sum of element blocks; those of a vertex that does not move are zero."""
        data = torch.zeros((len(self._keys), 9), dtype=torch.float64)
        for element in elements:
            data.index_add_(0, self._slots_of(element.vertices), element.blocks.reshape(-1, 9))
        data *= self._moves[:, None]
        return data.reshape(-1, 3, 3).numpy()

    def matrix(self, entries: np.ndarray) -> Any:
        """Assembled `entries` as a scipy BSR matrix (3 vertices, 3 vertices)."""
        from scipy.sparse import bsr_matrix

        size = 3 * self.vertex_count
        return bsr_matrix((entries, self._indices, self._indptr), shape=(size, size))

    def diagonal(self, entries: np.ndarray) -> np.ndarray:
        """(vertices, 3, 3) diagonal blocks of assembled `entries`; the identity where a vertex does not move."""
        blocks = entries[self.own_entries]
        blocks[~self.free.numpy()] = np.eye(3)
        return blocks

    def _pair_keys(self, element: Tensor) -> Tensor:
        k = element.shape[1]
        rows, columns = element[:, :, None].expand(-1, k, k), element[:, None, :].expand(-1, k, k)
        return (rows * self.vertex_count + columns).reshape(-1)

    def _slots_of(self, vertices: Tensor) -> Tensor:
        if vertices.shape[1] == 1:
            return self._slots[0][vertices[:, 0]]
        for element, slots in zip(self._elements, self._slots[1:], strict=True):
            if element is vertices:
                return slots
        return torch.searchsorted(self._keys, self._pair_keys(vertices))
