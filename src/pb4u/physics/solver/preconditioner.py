"""A preconditioner on two levels: 3x3 diagonal blocks, and affine motions of patches.

The diagonal blocks deal with what is stiff locally; the patches with what moves together over long distances, which is
what makes plain iterations slower on finer meshes. Patches do not depend on the resolution.
"""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from pb4u.collision.jit import compiled_with_fused_products
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.terms.stiffness_matrix import SymmetricBlocks
from pb4u.scene.packed import PackedGarments

_PATCHES_PER_GARMENT = 40
"""Enough for a sleeve to move apart from a front; their dense matrix, 360 wide, still inverts in milliseconds."""

_YOUNG = 4
"""Iterations for which a preconditioner's patches are kept in any case: made again they cost as much as three."""

_AGED, _FEW = 1.3, 5
"""Factor and number by which linear solves are longer than with new patches when these have aged."""

Functions = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A sparse matrix as first entries of its rows, columns and values of its entries."""

PRECISION = np.float32
"""Data type of the linear solves."""

_SMOOTHING_STEPS = 2
"""Averagings over neighbours that take the jumps at the patches' borders out of their motions."""


class PatchBasis:
    """Affine motions of patches of each garment, made once from its rest shape.

    Args:
        garments: static quantities on the CPU.
        free: (vertices,) bool, vertices that move.

    Attributes:
        functions: sparse matrix (vertices, functions) of values that each vertex has along each axis.
        by_vertex: its rows as arrays.
    """

    def __init__(self, garments: PackedGarments, free: np.ndarray) -> None:
        from scipy.sparse import coo_matrix, diags

        rest, offsets = garments.rest_positions.numpy(), garments.vertex_offsets
        edges = garments.edges.numpy()
        blocks = []
        column = 0
        for first, stop in pairwise(offsets):
            values, rows, columns = _affine_functions(rest[first:stop])
            blocks.append((values, rows + first, columns + column))
            column += int(columns.max()) + 1
        values, rows, columns = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        functions = coo_matrix((values, (rows, columns)), shape=(len(rest), column)).tocsr()
        pairs = np.concatenate([edges, edges[:, ::-1]])
        adjacency = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(rest), len(rest))).tocsr()
        average = diags(1.0 / np.maximum(np.asarray(adjacency.sum(axis=1)).reshape(-1), 1.0)) @ adjacency
        for _ in range(_SMOOTHING_STEPS):
            functions = functions / 3.0 + average @ functions * (2.0 / 3.0)
        self.functions = (diags(free.astype(np.float64)) @ functions).tocsr()
        self.by_vertex = _arrays(self.functions)

    @cached_property
    def by_axis(self) -> Any:
        """Sparse matrix (3 vertices, 3 functions) of the functions along each axis."""
        from scipy.sparse import eye, kron

        return kron(self.functions, eye(3))


def _arrays(matrix: Any) -> Functions:
    """A sparse matrix by rows as arrays."""
    return matrix.indptr, matrix.indices, matrix.data


class TwoLevelPreconditioner:
    """An additive preconditioner for one stiffness matrix; its coarse part may serve later matrices of the same step.

    Args:
        basis: patch motions.
        matrix: stiffness.
        pairs: contacts between cloth elements, added to the matrix.
        free: (vertices,) bool, vertices that move.
        precision: data type that it is applied in.

    Attributes:
        basis: patch motions.
    """

    def __init__(
        self,
        basis: PatchBasis,
        matrix: SymmetricBlocks,
        pairs: PairStiffness,
        free: np.ndarray,
        precision: type[np.floating] = PRECISION,
    ) -> None:
        self.basis, self._free, self._precision = basis, free, precision
        functions = basis.functions.astype(precision)
        self._by_function, self._by_vertex = _arrays(functions.T.tocsr()), _arrays(functions)
        self.refresh_patches(matrix, pairs)
        self.refresh_diagonal(matrix, pairs)

    def refresh_patches(self, matrix: SymmetricBlocks, pairs: PairStiffness) -> None:
        """Recompute the coarse part from the stiffness `matrix` and the `pairs`.

        Args:
            matrix: stiffness of the mesh.
            pairs: stiffness of the pairs in contact.
        """
        width = self.basis.functions.shape[1]
        sums = np.zeros((width, width, 9))
        _add_coarse(matrix.starts, matrix.columns, matrix.blocks.reshape(-1, 9), self.basis.by_vertex, sums)
        coarse = sums.reshape(width, width, 3, 3).transpose(0, 2, 1, 3).reshape(3 * width, 3 * width)
        coarse += coarse.T
        if len(pairs):
            root = (pairs.root(len(self._free)) @ self.basis.by_axis).tocsr()
            coarse += (root.T @ root).toarray()
        self._coarse_inverse = _inverse(coarse).astype(self._precision)

    def refresh_diagonal(self, matrix: SymmetricBlocks, pairs: PairStiffness) -> None:
        """Recompute the fine part from the diagonal blocks of the `matrix` and the `pairs`, positive definite.

        Args:
            matrix: stiffness of the mesh.
            pairs: stiffness of the pairs in contact.
        """
        diagonal = matrix.diagonal
        diagonal[~self._free] = np.eye(3)
        pairs.add_diagonal(diagonal)
        self._fine_inverse = np.empty(diagonal.shape, self._precision)
        _invert(diagonal, self._fine_inverse)

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, Functions, Functions]:
        """Inverses (vertices, 3, 3) and (coarse, coarse) [m/N]; the functions by function, and by vertex."""
        return self._fine_inverse, self._coarse_inverse, self._by_function, self._by_vertex

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Approximate solution (vertices, 3) [m] for `residual` (vertices, 3) [N]."""
        result = np.empty(residual.shape, self._precision)
        precondition(*self.parts, residual.astype(self._precision), result)
        return result


class AgeingPreconditioner:
    """The preconditioner of some garments: its diagonal is always new, its patches when they have aged.

    Patches serve several time steps, for the cloth hangs much as it did; they are made again once linear solves take
    longer than they did with new ones.

    Args:
        basis: patch motions.
        free: (vertices,) bool, vertices that move.
    """

    def __init__(self, basis: PatchBasis, free: np.ndarray) -> None:
        self._basis, self._free = basis, free
        self._current: TwoLevelPreconditioner | None = None
        self._age = 0
        self._iterations_when_new = 0
        self._last_iterations = 0

    @property
    def current(self) -> TwoLevelPreconditioner:
        """The preconditioner as last updated."""
        assert self._current is not None
        return self._current

    def update(self, matrix: SymmetricBlocks, pairs: PairStiffness) -> None:
        """Recompute what has aged.

        Args:
            matrix: new stiffness.
            pairs: contacts between cloth elements, added to it.
        """
        if self._current is None:
            self._current = TwoLevelPreconditioner(self._basis, matrix, pairs, self._free)
            return
        self._current.refresh_diagonal(matrix, pairs)
        self._age += 1
        if self._age >= _YOUNG and self._last_iterations > _AGED * self._iterations_when_new + _FEW:
            self._current.refresh_patches(matrix, pairs)
            self._age = 0

    def served(self, iterations: int) -> None:
        """Take note of the iterations of a linear solve.

        Args:
            iterations: number of iterations.
        """
        if self._age == 0:
            self._iterations_when_new = iterations
        self._last_iterations = iterations


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric matrix, directions without positive stiffness left out."""
    tensor = torch.from_numpy(matrix)
    shift = 1e-9 * float(tensor.diagonal().abs().max())
    # Twenty times faster than the eigenvectors, and the usual case; a quarter of what solving for the identity takes.
    factor, failed = torch.linalg.cholesky_ex(tensor + shift * torch.eye(len(tensor), dtype=tensor.dtype))
    if not bool(failed):
        inverse: np.ndarray = torch.cholesky_inverse(factor).numpy()
        return inverse
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-9 * values[-1]
    return (vectors[:, kept] / values[kept]) @ vectors[:, kept].T


def _affine_functions(rest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The functions 1, u and v of each patch (u and v: its main axes, scaled to order 1): values, vertices, columns."""
    from scipy.cluster.vq import kmeans2

    count = min(_PATCHES_PER_GARMENT, max(1, len(rest) // 12))
    _, label = kmeans2(rest, count, iter=5, minit="++", seed=np.random.default_rng(0))
    values, rows, columns = [], [], []
    for patch, name in enumerate(np.unique(label)):
        members = np.flatnonzero(label == name)
        offset = rest[members] - rest[members].mean(axis=0)
        axes = np.linalg.svd(offset, full_matrices=False)[2]
        size = max(float(np.linalg.norm(offset)) / np.sqrt(len(members)), 1e-9)
        functions = np.column_stack([np.ones(len(members)), offset @ axes[:2].T / size])
        values.append(functions.reshape(-1))
        rows.append(np.repeat(members, functions.shape[1]))
        columns.append(np.tile(3 * patch + np.arange(functions.shape[1]), len(members)))
    return np.concatenate(values), np.concatenate(rows), np.concatenate(columns)


@compiled_with_fused_products
def precondition(
    fine: np.ndarray,
    coarse: np.ndarray,
    to_patches: Functions,
    to_vertices: Functions,
    residual: np.ndarray,
    result: np.ndarray,
) -> None:
    """Fill `result` (vertices, 3) [m] with the preconditioner times `residual` (vertices, 3) [N].

    Args:
        fine: inverse diagonal blocks of the vertices [m/N].
        coarse: inverse stiffness of the patch motions.
        to_patches: functions that sum vertices to patches.
        to_vertices: functions that spread patches to vertices.
        residual: (vertices, 3) [N].
        result: (vertices, 3) [m], filled.
    """
    starts, indices, values = to_patches
    restricted, zero = np.empty(len(coarse), coarse.dtype), coarse.dtype.type(0.0)
    for function in range(len(starts) - 1):
        # Two sums each, since an addition waits for the one before it.
        x0, y0, z0, x1, y1, z1 = zero, zero, zero, zero, zero, zero
        first, stop = starts[function], starts[function + 1]
        if (stop - first) % 2:
            row = indices[first]
            x1, y1, z1 = (
                values[first] * residual[row, 0],
                values[first] * residual[row, 1],
                values[first] * residual[row, 2],
            )
            first += 1
        for k in range(first, stop, 2):
            row, other = indices[k], indices[k + 1]
            x0 += values[k] * residual[row, 0]
            y0 += values[k] * residual[row, 1]
            z0 += values[k] * residual[row, 2]
            x1 += values[k + 1] * residual[other, 0]
            y1 += values[k + 1] * residual[other, 1]
            z1 += values[k + 1] * residual[other, 2]
        restricted[3 * function], restricted[3 * function + 1], restricted[3 * function + 2] = x0 + x1, y0 + y1, z0 + z1
    moved = np.dot(coarse, restricted)
    starts, indices, values = to_vertices
    for row in range(len(residual)):
        x, y, z = residual[row, 0], residual[row, 1], residual[row, 2]
        a = fine[row, 0, 0] * x + fine[row, 0, 1] * y + fine[row, 0, 2] * z
        b = fine[row, 1, 0] * x + fine[row, 1, 1] * y + fine[row, 1, 2] * z
        c = fine[row, 2, 0] * x + fine[row, 2, 1] * y + fine[row, 2, 2] * z
        for k in range(starts[row], starts[row + 1]):
            function = 3 * indices[k]
            a += values[k] * moved[function]
            b += values[k] * moved[function + 1]
            c += values[k] * moved[function + 2]
        result[row, 0], result[row, 1], result[row, 2] = a, b, c


@compiled_with_fused_products
def _invert(blocks: np.ndarray, inverses: np.ndarray) -> None:
    """Fill `inverses` with those of symmetric `blocks` (blocks, 3, 3), by their cofactors."""
    for block in range(len(blocks)):
        a, b, c = blocks[block, 0]
        d, e, f = blocks[block, 1, 1], blocks[block, 1, 2], blocks[block, 2, 2]
        first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
        scale = 1.0 / (a * first + b * second + c * third)
        inverses[block, 0, 0], inverses[block, 1, 1] = scale * first, scale * (a * f - c * c)
        inverses[block, 2, 2] = scale * (a * d - b * b)
        inverses[block, 0, 1] = inverses[block, 1, 0] = scale * second
        inverses[block, 0, 2] = inverses[block, 2, 0] = scale * third
        inverses[block, 1, 2] = inverses[block, 2, 1] = scale * (b * c - a * e)


@compiled_with_fused_products
def _add_coarse(
    starts: np.ndarray,
    columns: np.ndarray,
    blocks: np.ndarray,
    functions: Functions,
    coarse: np.ndarray,
) -> None:
    """Add half of P^T A P to `coarse` (functions, functions, 9): with its transpose it is the whole.

    A is the matrix of `SymmetricBlocks`, its blocks (blocks, 9) by rows as those of the result; P has the values of the
    `functions` by vertex.
    """
    first, indices, values = functions
    touched, known = np.empty(coarse.shape[0], dtype=np.int64), np.full(coarse.shape[0], -1)
    sums = np.empty((coarse.shape[0], 9))
    for row in range(len(starts) - 1):
        # The blocks of this row times P, function by function, then these times P^T.
        count = 0
        for block in range(starts[row], starts[row + 1]):
            column = columns[block]
            share = 0.5 if column == row else 1.0
            for k in range(first[column], first[column + 1]):
                function = indices[k]
                if known[function] < 0:
                    known[function], touched[count] = count, function
                    for entry in range(9):
                        sums[count, entry] = 0.0
                    count += 1
                place, scale = known[function], share * values[k]
                for entry in range(9):
                    sums[place, entry] += scale * blocks[block, entry]
        for k in range(first[row], first[row + 1]):
            function, scale = indices[k], values[k]
            for n in range(count):
                other = touched[n]
                for entry in range(9):
                    coarse[function, other, entry] += scale * sums[n, entry]
        for n in range(count):
            known[touched[n]] = -1
