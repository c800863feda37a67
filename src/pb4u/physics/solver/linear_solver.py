"""The linear solves of a Newton step: conjugate gradients that notice negative curvature.

All of it is in float32, half the bytes of float64: Newton's method asks for a direction to a few percent. Forces and
energies, which decide where it ends, stay in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.collision.jit import compiled_with_fused_products
from pb4u.physics.solver.preconditioner import Functions, TwoLevelPreconditioner, precondition
from pb4u.physics.terms.pair_stiffness import PairStiffness, add_product
from pb4u.physics.terms.stiffness_matrix import SymmetricBlocks, multiply


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Result of conjugate gradients.

    Args:
        solution: (vertices, 3) [m], approximate.
        iterations: products with the matrix made.
        negative: (vertices, 3) [m] a direction along which the matrix is not positive, or None.
    """

    solution: np.ndarray
    iterations: int
    negative: np.ndarray | None


def conjugate_gradient(
    matrix: SymmetricBlocks,
    pairs: PairStiffness,
    right: np.ndarray,
    preconditioner: TwoLevelPreconditioner,
    tolerance: float,
    max_iterations: int,
    start: np.ndarray | None = None,
) -> LinearSolution:
    """Solve `matrix` y = `right`; stops at the first direction of negative curvature, with the solution so far.

    Source: Nocedal and Wright, Numerical Optimization, algorithm 7.1.

    Args:
        matrix: (3 vertices, 3 vertices) [N/m]; it is solved in its precision, which is that of the preconditioner.
        pairs: contacts between cloth elements, added to the matrix.
        right: (vertices, 3) [N].
        preconditioner: gives an approximate solution for a residual.
        tolerance: relative, in the norm of the preconditioner.
        max_iterations: products after which it stops.
        start: (vertices, 3) [m] a solution of a system near this one; 0 by default.
    """
    precision = matrix.blocks.dtype
    solution = np.zeros(right.shape, precision) if start is None else start.astype(precision)
    direction = np.empty(right.shape, precision)
    iterations, negative = _iterate(
        (matrix.starts, matrix.columns, matrix.blocks, pairs.corners, pairs.rows.astype(precision)),
        preconditioner.parts,
        right.astype(precision),
        tolerance,
        max_iterations,
        start is not None,
        solution,
        direction,
    )
    return LinearSolution(solution.astype(right.dtype), iterations, direction.astype(right.dtype) if negative else None)


@compiled_with_fused_products
def _inner(a: np.ndarray, b: np.ndarray) -> float:
    """Inner product of `a` (vertices, 3) and `b` (vertices, 3)."""
    x, y, z = 0.0, 0.0, 0.0
    for row in range(len(a)):
        x += a[row, 0] * b[row, 0]
        y += a[row, 1] * b[row, 1]
        z += a[row, 2] * b[row, 2]
    return x + y + z


@compiled_with_fused_products
def _iterate(
    system: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    preconditioner: tuple[np.ndarray, np.ndarray, Functions, Functions],
    right: np.ndarray,
    tolerance: float,
    max_iterations: int,
    started: bool,
    solution: np.ndarray,
    direction: np.ndarray,
) -> tuple[int, bool]:
    """Products made by `conjugate_gradient`, and whether `direction` (vertices, 3) [m] is left as one not positive.

    Changes `solution` (vertices, 3) [m], which begins as 0 unless it is `started`.
    """
    starts, columns, blocks, corners, rows = system
    fine, coarse, to_patches, to_vertices = preconditioner
    residual, product, conditioned = right.copy(), np.empty_like(right), np.empty_like(right)
    precondition(fine, coarse, to_patches, to_vertices, residual, direction)
    measure = _inner(residual, direction)
    target = tolerance * tolerance * measure
    if started:
        multiply(starts, columns, blocks, solution, product)
        add_product(corners, rows, solution, product)
        for row in range(len(right)):
            for axis in range(3):
                residual[row, axis] -= product[row, axis]
        precondition(fine, coarse, to_patches, to_vertices, residual, direction)
        measure = _inner(residual, direction)
    if not measure > target:
        return 0, False
    for iteration in range(1, max_iterations + 1):
        multiply(starts, columns, blocks, direction, product)
        add_product(corners, rows, direction, product)
        curvature = _inner(direction, product)
        if not curvature > 0.0:
            return iteration, True
        step = right.dtype.type(measure / curvature)
        for row in range(len(right)):
            for axis in range(3):
                solution[row, axis] += step * direction[row, axis]
                residual[row, axis] -= step * product[row, axis]
        precondition(fine, coarse, to_patches, to_vertices, residual, conditioned)
        new_measure = _inner(residual, conditioned)
        if new_measure <= target:
            return iteration, False
        share = right.dtype.type(new_measure / measure)
        for row in range(len(right)):
            for axis in range(3):
                direction[row, axis] = conditioned[row, axis] + share * direction[row, axis]
        measure = new_measure
    return max_iterations, False
