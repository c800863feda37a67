"""Curved pieces laid flat: what can be unrolled is unrolled, and ease trades stretch for cloth."""

import numpy as np
import pytest
from tests.physics.shapes import grid_faces, sheet, tube

from pb4u.geometry.flattening import flattened
from pb4u.geometry.principal_stretch import principal_stretches
from pb4u.geometry.triangle_mesh import carried_directions, laid_flat
from pb4u.scene.packed import inverse_rest_shapes


def stretches(vertices, faces, flat):
    """Principal stretches (faces, 2), larger first, of a surface from its flat piece."""
    import torch

    inverse = torch.from_numpy(inverse_rest_shapes(flat[faces]))
    return principal_stretches(torch.from_numpy(vertices), torch.from_numpy(faces), inverse).numpy()


def dome(ease: float) -> np.ndarray:
    """Stretches of a spherical cap of 60 degrees on what it is cut of."""
    angle, turn = np.meshgrid(np.linspace(-1.05, 1.05, 15), np.linspace(-1.05, 1.05, 15), indexing="ij")
    vertices = np.stack([np.sin(angle), np.cos(angle) * np.sin(turn), np.cos(angle) * np.cos(turn)], axis=2)
    vertices, faces = vertices.reshape(-1, 3), grid_faces(14, 14, wrap=False)
    flat = flattened(vertices, faces, ease)
    assert flat is not None
    return stretches(vertices, faces, flat)


def test_a_rolled_sheet_is_unrolled() -> None:
    garment = sheet(12, 6, width=1.2, height=0.6)
    x, y, _ = garment.vertices.T
    rolled = np.column_stack([0.3 * np.sin(x / 0.3), y, 0.3 * np.cos(x / 0.3)])
    flat = flattened(rolled, garment.faces)
    assert flat is not None
    assert stretches(rolled, garment.faces, flat) == pytest.approx(1.0, abs=0.005)


def test_ease_takes_stretch_for_more_cloth() -> None:
    tight, eased = dome(0.0), dome(0.8)
    assert tight[:, 0].max() > 1.08
    assert eased[:, 0].mean() < 1.0 + 0.4 * (tight[:, 0].mean() - 1.0)
    assert (1.0 / eased.prod(axis=1)).mean() > (1.0 / tight.prod(axis=1)).mean() + 0.02


def test_what_cannot_be_laid_flat_is_none() -> None:
    garment = tube(16, 12, 0.2, 0.8)
    assert flattened(garment.vertices, garment.faces) is None


def test_a_direction_lies_alike_on_another_shape_of_a_triangle() -> None:
    corners = np.random.default_rng(0).normal(size=(5, 3, 3))
    flat = laid_flat(corners)
    edges = corners[:, 2] - corners[:, 1]
    np.testing.assert_allclose(carried_directions(edges, corners, flat), flat[:, 2] - flat[:, 1], atol=1e-12)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(carried_directions(normal, corners, flat), 0.0, atol=1e-12)
