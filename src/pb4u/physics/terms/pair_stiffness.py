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
from pb4u.collision.lanes import lanes_at, put_lanes, spread, sum_of_three


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
        """All `parts` as one, without entries of vertices that are not `free` (vertices,) bool.

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
def add_product(corners: np.ndarray, rows: np.ndarray, vector: np.ndarray, product: np.ndarray) -> float:
    """Add the matrix of `PairStiffness` times `vector` to `product`; returns the squared norm of G times `vector`.

    Args:
        corners: (pairs, 4) int64 vertices of the pairs.
        rows: (4 pairs, 4) [(N/m)^0.5] rows of `PairStiffness`, and 0.
        vector: (vertices, 4) [m], whatever the fourth is.
        product: (vertices, 4) [N], changed.
    """
    squared = 0.0
    for pair in range(len(corners)):
        place = 16 * pair
        a, b, c, d = (
            lanes_at(rows, place),
            lanes_at(rows, place + 4),
            lanes_at(rows, place + 8),
            lanes_at(rows, place + 12),
        )
        i, j, k, m = 4 * corners[pair, 0], 4 * corners[pair, 1], 4 * corners[pair, 2], 4 * corners[pair, 3]
        sums = (a * lanes_at(vector, i) + b * lanes_at(vector, j)) + (c * lanes_at(vector, k) + d * lanes_at(vector, m))
        total = sum_of_three(sums)
        share = spread(total)
        put_lanes(product, i, lanes_at(product, i) + a * share)
        put_lanes(product, j, lanes_at(product, j) + b * share)
        put_lanes(product, k, lanes_at(product, k) + c * share)
        put_lanes(product, m, lanes_at(product, m) + d * share)
        squared += total * total
    return squared


@compiled_with_fused_products
def _add_diagonal(corners: np.ndarray, rows: np.ndarray, blocks: np.ndarray) -> None:
    for row in range(len(corners)):
        for corner in range(4):
            for i in range(3):
                for j in range(3):
                    blocks[corners[row, corner], i, j] += rows[row, corner, i] * rows[row, corner, j]
