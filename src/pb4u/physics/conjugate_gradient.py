"""Preconditioned conjugate gradients that notice negative curvature, for truncated Newton methods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Where conjugate gradients stopped.

    Args:
        solution: (n,) the approximate solution.
        iterations: products with the matrix made.
        negative: (n,) a direction along which the matrix is not positive, or None.
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
    """Solve `matrix` y = `right` to a relative `tolerance` in the norm of the preconditioner.

    Stops at the first direction of negative curvature, with the solution so far (Nocedal and Wright, Numerical
    Optimization, algorithm 7.1).
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
