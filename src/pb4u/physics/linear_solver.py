"""The linear solves of a Newton step: conjugate gradients that notice negative curvature, preconditioned on two levels.

The preconditioner has 3x3 diagonal blocks and affine motions of patches. The diagonal blocks deal with what is stiff
locally; the patches with what moves together over long distances, which is what makes plain iterations slower on finer
meshes. Patches do not depend on the resolution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from pb4u.physics.pair_stiffness import PairStiffness
from pb4u.scene.packed import PackedGarments

_PATCHES_PER_GARMENT = 40
"""Enough for a sleeve to move apart from a front; their dense matrix, 360 wide, still inverts in milliseconds."""

_SMOOTHING_STEPS = 2
"""Averagings over neighbours that take the jumps at the patches' borders out of their motions."""


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Result of conjugate gradients.

    Args:
        solution: (n,) the approximate solution [m].
        iterations: products with the matrix made.
        negative: (n,) [m] a direction along which the matrix is not positive, or None.
    """

    solution: np.ndarray
    iterations: int
    negative: np.ndarray | None


def conjugate_gradient(
    matrix: Any,
    right: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    tolerance: float,
    max_iterations: int,
) -> LinearSolution:
    """Solve `matrix` y = `right`; stops at the first direction of negative curvature, with the solution so far.

    Source: Nocedal and Wright, Numerical Optimization, algorithm 7.1.

    Args:
        matrix: (n, n) [N/m], anything that multiplies vectors (n,).
        right: (n,) [N].
        precondition: gives an approximate solution (n,) [m] for a residual (n,) [N].
        tolerance: relative, in the norm of the preconditioner.
        max_iterations: products after which it stops.
    """
    solution, residual = np.zeros_like(right), right.copy()
    direction = precondition(residual)
    measure = residual @ direction
    target = tolerance * tolerance * measure
    if not measure > 0:
        return LinearSolution(solution, 0, None)
    for iteration in range(1, max_iterations + 1):
        product = matrix @ direction
        curvature = direction @ product
        if not curvature > 0:
            return LinearSolution(solution, iteration, direction)
        step = measure / curvature
        solution = solution + step * direction
        residual = residual - step * product
        conditioned = precondition(residual)
        new_measure = residual @ conditioned
        if new_measure <= target:
            return LinearSolution(solution, iteration, None)
        direction = conditioned + (new_measure / measure) * direction
        measure = new_measure
    return LinearSolution(solution, max_iterations, None)


class PatchBasis:
    """Affine motions of patches of each garment, made once from its rest shape.

    Args:
        garments: static quantities on the CPU.
        free: (vertices,) bool, vertices that move.
    """

    def __init__(self, garments: PackedGarments, free: np.ndarray) -> None:
        from scipy.sparse import coo_matrix, diags, eye, kron

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
        self.prolongation = kron(diags(free.astype(np.float64)) @ functions, eye(3)).tocsr()
        self.restriction = self.prolongation.T.tocsr()


class TwoLevelPreconditioner:
    """An additive preconditioner for one stiffness matrix; its coarse part may serve later matrices of the same step.

    Args:
        basis: patch motions.
        matrix: (3 vertices, 3 vertices) [N/m] stiffness, rows and columns as (vertex, axis).
        diagonal: (vertices, 3, 3) [N/m] its diagonal blocks, those of `pairs` included.
        pairs: contacts between cloth elements, to be added to the matrix.
    """

    def __init__(self, basis: PatchBasis, matrix: Any, diagonal: np.ndarray, pairs: PairStiffness) -> None:
        self._basis = basis
        self.refresh_patches(matrix, pairs)
        self.refresh_diagonal(diagonal)

    def refresh_patches(self, matrix: Any, pairs: PairStiffness) -> None:
        """Recompute the coarse part from the stiffness `matrix` (3 vertices, 3 vertices) [N/m] and the `pairs`."""
        coarse = (self._basis.restriction @ (matrix.tocsr() @ self._basis.prolongation)).toarray()
        if len(pairs):
            root = (pairs.root(matrix.shape[0] // 3) @ self._basis.prolongation).tocsr()
            coarse += (root.T @ root).toarray()
        self._coarse_inverse = _inverse(0.5 * (coarse + coarse.T))

    def refresh_diagonal(self, diagonal: np.ndarray) -> None:
        """Recompute the fine part from the positive definite blocks `diagonal` (vertices, 3, 3) [N/m]."""
        from scipy.sparse import bsr_matrix

        count = len(diagonal)
        inverse = torch.linalg.inv(torch.from_numpy(diagonal)).numpy()
        self._fine = bsr_matrix((inverse, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count))

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Approximate solution (3 vertices,) [m] for `residual` (3 vertices,) [N]."""
        coarse = self._coarse_inverse @ (self._basis.restriction @ residual)
        return self._fine @ residual + self._basis.prolongation @ coarse


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric matrix, directions without positive stiffness left out."""
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    shift = 1e-9 * np.abs(np.diagonal(matrix)).max() * np.eye(len(matrix))
    try:
        # Twenty times faster than the eigenvectors, and the usual case.
        return cho_solve(cho_factor(matrix + shift), np.eye(len(matrix)))
    except LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        kept = values > 1e-9 * values[-1]
        return (vectors[:, kept] / values[kept]) @ vectors[:, kept].T


def _affine_functions(rest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, vertices and columns of 1, u and v on each patch, u and v being its main axes, scaled to order 1."""
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
