"""The linear solves of a Newton step: conjugate gradients that notice negative curvature.

All of it is in float32, half the bytes of float64: Newton's method asks for a direction to a few percent. Forces and
energies, which decide where it ends, stay in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.collision.jit import compiled_with_fused_products
from pb4u.collision.lanes import lanes_at, padded, put_lanes, spread
from pb4u.physics.solver.preconditioner import Functions, TwoLevelPreconditioner, precondition
from pb4u.physics.terms.pair_stiffness import PairStiffness, add_product
from pb4u.physics.terms.stiffness_matrix import SymmetricBlocks, multiply


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Result of conjugate gradients.

    Args:
        solution: (vertices, 3) [m], approximate.
        iterations: number of products with the matrix.
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
        start: (vertices, 3) [m] solution of a similar system; 0 by default.
    """
    solution, negative = np.empty(right.shape), np.empty(right.shape)
    iterations, is_negative = _iterate(
        (matrix.starts, matrix.columns, matrix.blocks, pairs.corners, pairs.rows.reshape(-1, 3)),
        preconditioner.parts,
        right,
        tolerance,
        max_iterations,
        right[:0] if start is None else start,
        solution,
        negative,
    )
    return LinearSolution(solution, iterations, negative if is_negative else None)


@compiled_with_fused_products
def _iterate(
    system: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    preconditioner: tuple[np.ndarray, np.ndarray, Functions, Functions],
    right: np.ndarray,
    tolerance: float,
    max_iterations: int,
    start: np.ndarray,
    solution: np.ndarray,
    negative: np.ndarray,
) -> tuple[int, bool]:
    """Products made by `conjugate_gradient`, and whether it stopped at a direction that is not positive.

    Fills `solution` (vertices, 3) [m], and `negative` (vertices, 3) [m] with that direction. It begins with `start`, or
    0 where that is empty. The loops have vectors (vertices, 4), as `pb4u.collision.lanes` does.
    """
    starts, columns, blocks, corners, pairs = system
    number = blocks.dtype.type
    rows, residual = padded(pairs, number), padded(right, number)
    direction, product, conditioned = np.zeros_like(residual), np.empty_like(residual), np.empty_like(residual)
    reached = padded(start, number) if len(start) else np.zeros_like(residual)
    measure = precondition(preconditioner, residual, direction)
    target = tolerance * tolerance * measure
    if len(start):
        multiply(starts, columns, blocks, reached, product)
        add_product(corners, rows, reached, product)
        _add(number(-1.0), product, residual)
        measure = precondition(preconditioner, residual, direction)
    iteration, is_negative, is_solved = 0, False, not measure > target
    while not is_solved and iteration < max_iterations:
        iteration += 1
        curvature = multiply(starts, columns, blocks, direction, product)
        curvature += add_product(corners, rows, direction, product)
        if not curvature > 0.0:
            is_negative = True
            break
        step = measure / curvature
        _add(number(step), direction, reached)
        _add(number(-step), product, residual)
        before, measure = measure, precondition(preconditioner, residual, conditioned)
        is_solved = measure <= target
        _add(number(measure / before), direction, conditioned)
        direction, conditioned = conditioned, direction
    for row in range(len(right)):
        for axis in range(3):
            solution[row, axis], negative[row, axis] = reached[row, axis], direction[row, axis]
    return iteration, is_negative


@compiled_with_fused_products
def _add(share: float, vector: np.ndarray, total: np.ndarray) -> None:
    """Add a `share` of `vector` (vertices, 4) to `total` (vertices, 4)."""
    shares = spread(share)
    for row in range(len(total)):
        place = 4 * row
        put_lanes(total, place, lanes_at(total, place) + shares * lanes_at(vector, place))
