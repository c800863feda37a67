"""Panels laid out side by side in a unit square: texture coordinates that are the pattern."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_ROOM = 0.02
"""Distance [m] between panels."""


def laid_out(boxes: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, float]:
    """Positions of rectangles packed in rows into a square, the tallest first.

    Args:
        boxes: lowest and highest corner (2,) of each [m].

    Returns:
        Translations (boxes, 2) [m] to their positions, and the side [m] of the square from the origin.
    """
    sizes = np.array([high - low for low, high in boxes]) + _ROOM
    side = max(float(sizes.max()), float(np.sqrt(sizes.prod(axis=1).sum())))
    while True:
        corner, shelf, moves = np.zeros(2), 0.0, np.zeros((len(boxes), 2))
        for box in np.argsort(-sizes[:, 1], kind="stable"):
            if corner[0] + sizes[box, 0] > side:
                corner, shelf = np.array([0.0, corner[1] + shelf]), 0.0
            moves[box] = corner + 0.5 * _ROOM - boxes[box][0]
            corner[0] += sizes[box, 0]
            shelf = max(shelf, float(sizes[box, 1]))
        if corner[1] + shelf <= side:
            return moves, side
        side *= 1.05
