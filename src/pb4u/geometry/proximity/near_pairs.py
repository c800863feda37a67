"""Pairs of balls that may touch, out of two sets, however much their sizes differ."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MOST_PAIRS = 40_000_000
"""Beyond this a garment has collapsed to a point; its pairs (16 bytes each) would also fill the memory."""
_PAIRS_PER_PIECE = 4_000_000
"""A piece, with the copies made of it, stays below about half a gigabyte."""
_SAMPLED = 16


def near_pairs(
    centres: np.ndarray, radii: np.ndarray, other_centres: np.ndarray, other_radii: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Indices (pairs,) into both sets of all balls that overlap, in pieces that fit in memory.

    Balls are searched octave by octave of their size, so that one large ball does not widen every search. Nothing is
    returned where there are more than about 40 million pairs: such a cloth has collapsed.

    Args:
        centres: (balls, 3) [m], finite.
        radii: (balls,) [m], above 0.
        other_centres: (other balls, 3) [m], finite.
        other_radii: (other balls,) [m], above 0.
    """
    from scipy.spatial import cKDTree

    searches = [
        (chosen, other, cKDTree(other_centres[other]), float(radii[chosen].max() + other_radii[other].max()))
        for other in _octaves(other_radii)
        for chosen in _octaves(radii)
    ]
    counts = [_estimated_count(centres[chosen], tree, reach) for chosen, _, tree, reach in searches]
    if sum(counts) > MOST_PAIRS:
        return
    for (chosen, other, tree, reach), count in zip(searches, counts, strict=True):
        for piece in np.array_split(chosen, 1 + count // _PAIRS_PER_PIECE):
            within = cKDTree(centres[piece]).sparse_distance_matrix(tree, reach, output_type="ndarray")
            one, another = piece[within["i"]], other[within["j"]]
            overlapping = within["v"] <= radii[one] + other_radii[another]
            yield one[overlapping], another[overlapping]


def _estimated_count(points: np.ndarray, tree: cKDTree, reach: float) -> int:
    """How many pairs of `points` and points of the tree are within reach, judged by one point in sixteen."""
    return int(type(tree)(points[::_SAMPLED]).count_neighbors(tree, reach)) * min(_SAMPLED, len(points))


def _octaves(sizes: np.ndarray) -> list[np.ndarray]:
    """Indices of `sizes` grouped by powers of two."""
    octave = np.floor(np.log2(np.maximum(sizes, np.finfo(float).tiny)))
    return [np.flatnonzero(octave == value) for value in np.unique(octave)]
