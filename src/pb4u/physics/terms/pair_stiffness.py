"""Second derivatives of contacts between cloth elements: a sum of rank-one matrices, each of four vertices.

Which elements touch changes in every iteration, so they stay out of the pattern of the stiffness matrix; a product
with them costs less than putting them in would.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pb4u.collision.jit import compiled_with_fused_products


@dataclass(frozen=True, eq=False)
class PairStiffness:
    """Sum of g g^T over rows g, each of which acts on the axes of four vertices.

    Args:
        corners: (rows, 4) int64.
        rows: (rows, 4, 3) [(N/m)^0.5].
    """

    corners: np.ndarray
    rows: np.ndarray

    @staticmethod
    def summed(parts: Sequence[PairStiffness], free: np.ndarray) -> PairStiffness:
        """All `parts` as one, without what acts on vertices that are not `free` (vertices,) bool.

        Args:
            parts: matrices over the same vertices.
            free: (vertices,) bool.
        """
        if not parts:
            return PairStiffness(np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4, 3)))
        corners = np.concatenate([part.corners for part in parts])
        rows = np.concatenate([part.rows for part in parts])
        return PairStiffness(corners, rows * free[corners][:, :, None])

    def __len__(self) -> int:
        return len(self.corners)

    def add_diagonal(self, blocks: np.ndarray) -> None:
        """Add the diagonal blocks of this matrix to `blocks` (vertices, 3, 3) [N/m].

        Args:
            blocks: (vertices, 3, 3) [N/m], changed.
        """
        _add_diagonal(self.corners, self.rows, blocks)

    def root(self, vertex_count: int) -> Any:
        """Sparse matrix G (rows, 3 vertices) of which this one is G^T G.

        Args:
            vertex_count: number of vertices.
        """
        from scipy.sparse import csr_matrix

        columns = (3 * self.corners[:, :, None] + np.arange(3)).reshape(-1)
        starts = np.arange(0, 12 * len(self) + 1, 12)
        return csr_matrix((self.rows.reshape(-1), columns, starts), shape=(len(self), 3 * vertex_count))


@compiled_with_fused_products
def add_product(corners: np.ndarray, rows: np.ndarray, vector: np.ndarray, product: np.ndarray) -> None:
    """Add the matrix of `PairStiffness` times `vector` (vertices, 3) [m] to `product` (vertices, 3) [N].

    Args:
        corners: (pairs, 4) int64 vertices of the pairs.
        rows: (pairs, 4, 3) of `PairStiffness`.
        vector: (vertices, 3) [m].
        product: (vertices, 3) [N], changed.
    """
    for row in range(len(corners)):
        total = product.dtype.type(0.0)
        for corner in range(4):
            for axis in range(3):
                total += rows[row, corner, axis] * vector[corners[row, corner], axis]
        for corner in range(4):
            for axis in range(3):
                product[corners[row, corner], axis] += total * rows[row, corner, axis]


@compiled_with_fused_products
def _add_diagonal(corners: np.ndarray, rows: np.ndarray, blocks: np.ndarray) -> None:
    for row in range(len(corners)):
        for corner in range(4):
            for i in range(3):
                for j in range(3):
                    blocks[corners[row, corner], i, j] += rows[row, corner, i] * rows[row, corner, j]
