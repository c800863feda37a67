"""Lengths of vectors in loops, rounded as torch rounds them: where one is written for the other, no bit changes."""

from __future__ import annotations

import numpy as np

from pb4u.collision.jit import compiled, compiled_with_fused_products


@compiled
def _square(value: float) -> float:
    return value * value


@compiled_with_fused_products
def length(x: float, y: float, z: float) -> float:
    """Length of a vector, in its unit.

    Args:
        x: first component.
        y: second one.
        z: third one.
    """
    # The first product is rounded by itself, the other two with the sums that they enter.
    return np.sqrt(z * z + (y * y + _square(x)))
