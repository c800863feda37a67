"""Points within a radius of others, by a grid of cells as wide as the radius."""

from __future__ import annotations

import numpy as np

from pb4u.collision.jit import compiled

_MOST_CELLS = 64
"""Cells along an axis at most, however far points lie apart."""


@compiled
def nearest_vertices(points: np.ndarray, targets: np.ndarray, radius: float, index: np.ndarray) -> None:
    """Fill `index` (points, neighbours) with the nearest targets within the radius, nearest first, and -1 where none.

    Args:
        points: (points, 3) [m]; one that is not finite is near nothing.
        targets: (targets, 3) [m], finite.
        radius: largest distance [m].
        index: int64, overwritten.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for point in points:
        if np.isfinite(point[0]) and np.isfinite(point[1]) and np.isfinite(point[2]):
            for axis in range(3):
                low[axis], high[axis] = min(low[axis], point[axis] - radius), max(high[axis], point[axis] + radius)
    index[:] = -1
    if not low[0] <= high[0]:
        return
    counts, sizes = np.empty(3, np.int64), np.empty(3)
    for axis in range(3):
        sizes[axis] = max(radius, (high[axis] - low[axis]) / _MOST_CELLS)
        counts[axis] = int((high[axis] - low[axis]) / sizes[axis]) + 1
    # Targets in the order of their cells: those of a row of cells are one after another.
    cells = np.full(len(targets), -1)
    first = np.zeros(counts[0] * counts[1] * counts[2] + 1, np.int64)
    for number, target in enumerate(targets):
        if low[0] <= target[0] <= high[0] and low[1] <= target[1] <= high[1] and low[2] <= target[2] <= high[2]:
            cell = 0
            for axis in range(3):
                cell = cell * counts[axis] + int((target[axis] - low[axis]) / sizes[axis])
            cells[number] = cell
            first[cell + 1] += 1
    for cell in range(1, len(first)):
        first[cell] += first[cell - 1]
    names, places, filled = np.empty(first[-1], np.int64), np.empty((first[-1], 3)), first[:-1].copy()
    for number, target in enumerate(targets):
        if cells[number] >= 0:
            row = filled[cells[number]]
            filled[cells[number]] += 1
            names[row] = number
            for axis in range(3):
                places[row, axis] = target[axis]
    squares, begin, end = np.empty(index.shape[1]), np.empty(3, np.int64), np.empty(3, np.int64)
    for number, point in enumerate(points):
        if not (np.isfinite(point[0]) and np.isfinite(point[1]) and np.isfinite(point[2])):
            continue
        squares[:] = radius * radius
        for axis in range(3):
            begin[axis] = int(max(point[axis] - radius - low[axis], 0.0) / sizes[axis])
            end[axis] = min(int((point[axis] + radius - low[axis]) / sizes[axis]), counts[axis] - 1)
        for i in range(begin[0], end[0] + 1):
            for j in range(begin[1], end[1] + 1):
                row = (i * counts[1] + j) * counts[2]
                for near in range(first[row + begin[2]], first[row + end[2] + 1]):
                    x, y, z = (places[near, 0] - point[0], places[near, 1] - point[1], places[near, 2] - point[2])
                    square = x * x + y * y + z * z
                    if square >= squares[-1]:
                        continue
                    rank = len(squares) - 1
                    while rank > 0 and square < squares[rank - 1]:
                        squares[rank], index[number, rank] = squares[rank - 1], index[number, rank - 1]
                        rank -= 1
                    squares[rank], index[number, rank] = square, names[near]
