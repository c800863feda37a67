"""The search for crossing faces finds what a search among all faces finds."""

from __future__ import annotations

import numpy as np
import pytest
from tests.garment.cloth_shapes import tube_arrays

from pb4u.collision.crossing_search import CrossingSearch
from pb4u.collision.crossings import self_crossings
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.geometry.topology import Topology


def tube() -> tuple[np.ndarray, np.ndarray]:
    vertices, quads = tube_arrays(around=30, rows=14)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def unordered(pairs: np.ndarray) -> set[tuple[int, ...]]:
    return set(map(tuple, np.sort(pairs, axis=1).tolist()))


@pytest.mark.parametrize("seed", range(6))
def test_crossing_faces_are_those_of_the_exact_search(seed: int) -> None:
    """A tube whose vertices are thrown about by up to four edges: from no crossing to a heap of them."""
    vertices, faces = tube()
    topology = Topology(faces, len(vertices))
    search = CrossingSearch(SurfaceTree(vertices, faces, topology.edges, np.zeros(len(vertices), dtype=int), [0]))
    rng = np.random.default_rng(seed)
    moved = vertices + 0.05 * seed * rng.uniform(-1.0, 1.0, vertices.shape) + [1000.0 * (seed % 2), 0.0, 0.0]
    expected = unordered(self_crossings(moved, faces))
    assert bool(expected) == (seed > 0)
    assert unordered(search.pairs(moved)) == expected
    sharing = unordered(self_crossings(moved, faces, sharing=True))
    assert (len(sharing) > len(expected)) == (seed > 0)
    assert unordered(search.pairs(moved, sharing=True)) == sharing


def test_faces_that_only_touch_are_left_to_the_exact_predicates() -> None:
    """Two triangles in one plane that share part of a side, and one that stands on another with its tip."""
    vertices = np.array(
        [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0, 0], [1.5, 0, 0], [1, -1, 0], [0.5, 0.5, 0], [0, 0, 1], [1, 0, 1]],
        float,
    )
    faces = np.arange(9).reshape(3, 3)
    topology = Topology(faces, 9)
    search = CrossingSearch(SurfaceTree(vertices, faces, topology.edges, np.zeros(9, dtype=int), [0]))
    assert unordered(search.pairs(vertices)) == unordered(self_crossings(vertices, faces))
