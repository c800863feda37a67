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
from pb4u.collision.lanes import as_doubles, block_at, lane, lanes_at, put_lanes, spread, sum_of_three
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
"""Functions of the patches by vertex, or by patch: first entries of each, the patch or vertex of each entry, and the
values (entries, 3) of the patch's functions at the vertex."""

PRECISION = np.float32
"""Data type of the linear solves."""

_SMOOTHING_STEPS = 2
"""Averagings over neighbours that take the jumps at the patches' borders out of their motions."""


class PatchBasis:
    """Affine motions of patches of each garment, computed once from its rest shape.

    Args:
        garments: static quantities on the CPU.
        free: (vertices,) bool, vertices that move.

    Attributes:
        functions: sparse matrix (vertices, functions) of values that each vertex has along each axis.
        by_vertex: the same by vertex.
        by_patch: the same by patch.
    """

    def __init__(self, garments: PackedGarments, free: np.ndarray) -> None:
        from scipy.sparse import coo_matrix, diags

        rest, offsets = garments.rest_positions.numpy(), garments.vertex_offsets
        edges = garments.edges.numpy()
        blocks = []
        column = 0
        # Of a part of a garment, what does not move is most of it.
        moving = free if garments.part_of is not None and free.any() else np.ones_like(free)
        for first, stop in pairwise(offsets):
            members = first + np.flatnonzero(moving[first:stop])
            if not len(members):
                continue
            values, rows, columns = _affine_functions(rest[members])
            blocks.append((values, members[rows], columns + column))
            column += 3 * (int(columns.max()) // 3 + 1)
        values, rows, columns = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        functions = coo_matrix((values, (rows, columns)), shape=(len(rest), column)).tocsr()
        pairs = np.concatenate([edges, edges[:, ::-1]])
        adjacency = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(rest), len(rest))).tocsr()
        average = diags(1.0 / np.maximum(np.asarray(adjacency.sum(axis=1)).reshape(-1), 1.0)) @ adjacency
        for _ in range(_SMOOTHING_STEPS):
            functions = functions / 3.0 + average @ functions * (2.0 / 3.0)
        self.functions = (diags(free.astype(np.float64)) @ functions).tocsr()
        self.by_vertex, self.by_patch = _by_vertex_and_by_patch(self.functions)

    @cached_property
    def by_axis(self) -> Any:
        """Sparse matrix (3 vertices, 3 functions) of the functions along each axis."""
        from scipy.sparse import eye, kron

        return kron(self.functions, eye(3))


def _by_vertex_and_by_patch(functions: Any) -> tuple[Functions, Functions]:
    """A sparse matrix (vertices, functions) of three functions a patch, by vertex and by patch."""
    entries, (vertices, width) = functions.tocoo(), functions.shape
    keys, place = np.unique(entries.row * (width // 3) + entries.col // 3, return_inverse=True)
    values = np.zeros((len(keys), 3))
    values[place, entries.col % 3] = entries.data
    rows, patches = np.divmod(keys, width // 3)
    order = np.argsort(patches, kind="stable")
    return (
        (_starts(rows, vertices), patches.astype(np.int32), values),
        (_starts(patches[order], width // 3), rows[order].astype(np.int32), values[order]),
    )


def _starts(ascending: np.ndarray, count: int) -> np.ndarray:
    """First places (count + 1,) int32 of the numbers 0, 1, .. in an `ascending` array, and its length."""
    return np.searchsorted(ascending, np.arange(count + 1)).astype(np.int32)


class TwoLevelPreconditioner:
    """An additive preconditioner for one stiffness matrix; its coarse part may serve later matrices.

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
        self._by_patch, self._by_vertex = (
            (starts, indices, values.astype(precision)) for starts, indices, values in (basis.by_patch, basis.by_vertex)
        )
        self.refresh_patches(matrix, pairs)
        self.refresh_diagonal(matrix, pairs)

    def refresh_patches(self, matrix: SymmetricBlocks, pairs: PairStiffness) -> None:
        """Recompute the coarse part from the stiffness `matrix` and the `pairs`.

        Args:
            matrix: stiffness of the mesh.
            pairs: stiffness of the pairs in contact.
        """
        width = self.basis.functions.shape[1]
        sums, functions = np.zeros((width, width, 9)), self.basis.functions
        entries = functions.indptr, functions.indices, functions.data
        _add_coarse(matrix.starts, matrix.columns, matrix.blocks.reshape(-1, 9), entries, sums)
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
        """Inverses (vertices, 3, 3) and (coarse, coarse) [m/N]; the functions by patch, and by vertex."""
        return self._fine_inverse, self._coarse_inverse, self._by_patch, self._by_vertex


class AgeingPreconditioner:
    """The preconditioner of some garments: its diagonal is always new, its patches when they have aged.

    Patches are reused for several time steps, since the cloth changes little; they are recomputed once linear solves
    take longer than with new ones.

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
        """Recompute outdated parts.

        Args:
            matrix: new stiffness.
            pairs: contacts between cloth elements, to add to the matrix.
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
        """Record the iterations of a linear solve.

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
        return torch.cholesky_inverse(factor).numpy()
    values, vectors = np.linalg.eigh(matrix)
    is_regular = values > 1e-9 * values[-1]
    return (vectors[:, is_regular] / values[is_regular]) @ vectors[:, is_regular].T


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
    parts: tuple[np.ndarray, np.ndarray, Functions, Functions], residual: np.ndarray, result: np.ndarray
) -> float:
    """Fill `result` with the preconditioner times `residual`, and give back the inner product of the two.

    Args:
        parts: those of `TwoLevelPreconditioner`.
        residual: (vertices, 4) [N], whatever the fourth is.
        result: (vertices, 4) [m], filled.
    """
    fine, coarse, to_patches, to_vertices = parts
    starts, indices, values = to_patches
    zero, total = spread(coarse.dtype.type(0.0)), spread(0.0)
    # One more each, for the fourth lane of the last one.
    restricted, moved = np.empty(len(coarse) + 1, coarse.dtype), np.empty(len(coarse) + 1, coarse.dtype)
    for patch in range(len(starts) - 1):
        a, b, c = zero, zero, zero
        for k in range(starts[patch], starts[patch + 1]):
            here = lanes_at(residual, 4 * indices[k])
            a = spread(values[k, 0]) * here + a
            b = spread(values[k, 1]) * here + b
            c = spread(values[k, 2]) * here + c
        put_lanes(restricted, 9 * patch, a)
        put_lanes(restricted, 9 * patch + 3, b)
        put_lanes(restricted, 9 * patch + 6, c)
    np.dot(coarse, restricted[:-1], moved[:-1])
    moved[-1] = 0.0
    starts, indices, values = to_vertices
    for row in range(len(residual)):
        here = lanes_at(residual, 4 * row)
        first, second, third = block_at(fine, row)
        own = first * spread(lane(here, 0)) + (second * spread(lane(here, 1)) + third * spread(lane(here, 2)))
        for k in range(starts[row], starts[row + 1]):
            place = 9 * indices[k]
            own = spread(values[k, 0]) * lanes_at(moved, place) + own
            own = spread(values[k, 1]) * lanes_at(moved, place + 3) + own
            own = spread(values[k, 2]) * lanes_at(moved, place + 6) + own
        put_lanes(result, 4 * row, own)
        total = total + as_doubles(here * own)
    return sum_of_three(total)


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
    functions: tuple[np.ndarray, np.ndarray, np.ndarray],
    coarse: np.ndarray,
) -> None:
    """Add half of P^T A P to `coarse` (functions, functions, 9): with its transpose it is the whole.

    A is the matrix of `SymmetricBlocks`, its blocks (blocks, 9) by rows as those of the result; P is a
    sparse matrix, its first entries of rows, columns and values given.
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
