"""Triangles that cross: as a slow readable test of every pair finds them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pb4u.collision.crossings import crossings, self_crossings


def pierces(start: np.ndarray, end: np.ndarray, triangle: np.ndarray) -> bool:
    """Whether a segment passes through the inside of a triangle."""
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    before, after = (start - a) @ normal, (end - a) @ normal
    if before * after >= 0:
        return False
    hit = start + (end - start) * before / (before - after)
    return all(np.cross(q - p, hit - p) @ normal > 0 for p, q in ((a, b), (b, c), (c, a)))


def cross(one: np.ndarray, other: np.ndarray) -> bool:
    edges = ((0, 1), (1, 2), (2, 0))
    return any(pierces(one[i], one[j], other) or pierces(other[i], other[j], one) for i, j in edges)


@pytest.mark.parametrize("seed", range(4))
def test_crossing_pairs_are_those_of_the_readable_test(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = rng.normal(size=(72, 3)), np.arange(72).reshape(24, 3)
    corners = vertices[faces]
    expected = {(i, j) for i in range(24) for j in range(i + 1, 24) if cross(corners[i], corners[j])}
    assert len(expected) > 20
    assert {tuple(sorted(pair)) for pair in self_crossings(vertices, faces).tolist()} == expected
    between = {(i, j - 12) for i in range(12) for j in range(12, 24) if cross(corners[i], corners[j])}
    assert set(map(tuple, crossings(vertices, faces[:12], vertices, faces[12:]).tolist())) == between


def test_faces_that_share_a_vertex_are_not_counted() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.6, 0.2, 1], [0.2, 0.2, -1.0], [5, 5, 5]], dtype=float)
    # The second face passes through the first, in which it also has a corner; the third only through it.
    assert not len(self_crossings(vertices, np.array([[0, 1, 2], [0, 3, 4]])))
    assert self_crossings(vertices, np.array([[0, 1, 2], [3, 4, 5]])).tolist() == [[0, 1]]


@pytest.mark.parametrize("seed", range(4))
def test_pairs_that_share_a_vertex_are_counted_where_asked(seed: int) -> None:
    """They cross where the edge of one across from that vertex passes through the other."""
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(14, 3))
    faces = np.array(list(combinations(range(14), 3)))[rng.choice(364, 24, replace=False)]
    expected = set()
    for i, j in combinations(range(len(faces)), 2):
        shared = set(faces[i].tolist()) & set(faces[j].tolist())
        if len(shared) == 1:
            ends = [[v for v in faces[k].tolist() if v not in shared] for k in (i, j)]
            others = (vertices[faces[j]], vertices[faces[i]])
            if any(pierces(*vertices[end], other) for end, other in zip(ends, others, strict=True)):
                expected.add((i, j))
    assert len(expected) > 5
    apart = {tuple(sorted(pair)) for pair in self_crossings(vertices, faces).tolist()}
    every = {tuple(sorted(pair)) for pair in self_crossings(vertices, faces, sharing=True).tolist()}
    assert every - apart == expected


def test_far_apart_is_nothing() -> None:
    triangle, face = np.eye(3), np.array([[0, 1, 2]])
    assert crossings(triangle, face, triangle + 9.0, face).shape == (0, 2)
    assert self_crossings(triangle, face).shape == (0, 2)
