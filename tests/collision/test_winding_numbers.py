"""How often surfaces wind around points, beside sums of solid angles."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh

from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.collision.winding_numbers import winding_numbers


def winding(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    return np.asarray(winding_numbers(TriangleSurface(faces, len(vertices)).at(vertices).searched, points))


def two_balls() -> trimesh.Trimesh:
    """Two that overlap, and a third that is turned inside out within one of them."""
    one, other, hole = (trimesh.creation.icosphere(subdivisions=2, radius=r) for r in (0.2, 0.2, 0.05))
    other.apply_translation([0.21, 0.02, 0.01])
    hole.invert()
    hole.apply_translation([-0.1, 0.0, 0.0])
    joined: trimesh.Trimesh = trimesh.util.concatenate([one, other, hole])
    return joined


def test_numbers_are_those_of_solid_angles() -> None:
    mesh = two_balls()
    points = np.random.default_rng(5).uniform(*mesh.bounds, (4000, 3))
    found = winding(mesh, points)
    angles = igl.winding_number(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64), points)
    np.testing.assert_array_equal(found, np.round(angles))
    assert set(found.tolist()) == {0, 1, 2}


@pytest.mark.parametrize("size", [1, 2, 8])
def test_a_ray_through_edges_and_corners_counts_once(size: int) -> None:
    """A grid of points in a box of as many cells: rays go along its edges, through corners and within its sides."""
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    while len(box.faces) < 12 * size * size:
        box = box.subdivide()
    steps = np.arange(-8, 9) / 8.0
    points = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    distances = 0.5 - np.abs(points).max(axis=1)
    points, distances = points[np.abs(distances) > 1e-9], distances[np.abs(distances) > 1e-9]
    np.testing.assert_array_equal(winding(box, points), (distances > 0).astype(int))
