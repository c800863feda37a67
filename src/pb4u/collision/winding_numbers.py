"""How often a posed surface winds around points, counted where a ray from each goes through it; compiled by Numba.

Where an edge is shared, both its faces see a ray on the same side of it: no ray slips through between them, and none
counts twice. So the numbers are whole and exact, which a sum of solid angles is not.
"""

from __future__ import annotations

import numpy as np

from pb4u.collision.jit import compiled
from pb4u.collision.nearest_points import Searched
from pb4u.collision.wide_tree import WIDTH

_DEEPEST = 512
"""Entries of the stack of a search, as in `nearest_points`."""


@compiled
def winding_numbers(surface: Searched, points: np.ndarray) -> np.ndarray:
    """How often the surface winds around each of some points: (points,) int64.

    0 outside, 1 inside, 2 where two of its parts overlap. Of an open surface the number depends on the ray's direction,
    which is that of x.

    Args:
        surface: arrays of the surface and of its tree.
        points: (points, 3) [m], none of them on the surface.
    """
    children, bottoms, corners, boxes = surface.children, surface.bottoms, surface.corners, surface.boxes
    numbers, stack = np.zeros(len(points), dtype=np.int64), np.empty(_DEEPEST, dtype=np.int64)
    meets = np.empty(WIDTH, dtype=np.bool_)
    for row in range(len(points)):
        x, y, z = points[row]
        stack[0], depth = len(children) - 1, 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            box, first = boxes[node], children[node]
            for lane in range(len(meets)):
                beside = (box[1, lane] > y) | (box[4, lane] < y) | (box[2, lane] > z) | (box[5, lane] < z)
                meets[lane] = not (beside | (box[3, lane] < x))
            for lane in range(len(meets)):
                if not meets[lane]:
                    continue
                if node < bottoms:
                    numbers[row] += _through(corners[first + lane], x, y, z)
                else:
                    stack[depth] = first + lane
                    depth += 1
    return numbers


@compiled
def _through(corners: np.ndarray, x: float, y: float, z: float) -> int:
    """1 where a ray from (x, y, z) [m] along x leaves through a face with `corners` (9,) [m], -1 where it enters."""
    ab = _beside(corners[1] - y, corners[2] - z, corners[4] - y, corners[5] - z)
    bc = _beside(corners[4] - y, corners[5] - z, corners[7] - y, corners[8] - z)
    ca = _beside(corners[7] - y, corners[8] - z, corners[1] - y, corners[2] - z)
    if (ab > 0.0) != (bc > 0.0) or (bc > 0.0) != (ca > 0.0):
        return 0
    if bc * (corners[0] - x) + ca * (corners[3] - x) + ab * (corners[6] - x) > 0.0:
        return 1 if ab > 0.0 else 0
    return -1 if ab < 0.0 else 0


@compiled
def _beside(ay: float, az: float, by: float, bz: float) -> float:
    """Twice the area [m^2] of a triangle in the plane with a corner at the origin; of a, b that of b, a with its sign.

    Where the origin lies on the line through both, the sign is that of their order.
    """
    area = ay * bz - az * by
    if area != 0.0:
        return area
    return 1e-300 if ay < by or (ay == by and az < bz) else -1e-300
