"""One round of Loop's subdivision."""

from __future__ import annotations

import numpy as np

from pb4u.geometry.subdivision import loop_weights, split_faces

GRID = 7


def flat_grid() -> tuple[np.ndarray, np.ndarray]:
    """Points (49, 3) of a regular triangulation of a rhomb, and its faces (72, 3)."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(GRID), np.arange(GRID), indexing="ij"))
    points = np.column_stack([i + 0.5 * j, np.sqrt(0.75) * j, np.zeros(GRID * GRID)])
    a = (GRID * np.arange(GRID - 1)[:, None] + np.arange(GRID - 1)).ravel()
    return points, np.concatenate([np.column_stack(k) for k in ((a, a + GRID, a + 1), (a + GRID, a + GRID + 1, a + 1))])


def test_a_flat_grid_stays_what_it_is_within_and_its_borders_stay_where_they_are_straight() -> None:
    points, faces = flat_grid()
    split = split_faces(faces, len(points), np.ones(len(faces), dtype=bool))
    weights = loop_weights(split, faces, len(points))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-14)
    smooth, straight = weights @ points, split.between(points)
    corners = np.array([0, GRID - 1, GRID * (GRID - 1), GRID * GRID - 1])
    moved = np.linalg.norm(smooth - straight, axis=1) > 1e-12
    assert set(np.flatnonzero(moved)) == set(corners)
    # Every piece is a quarter of the face that it is cut from.
    a, b, c = straight[split.faces].transpose(1, 0, 2)
    np.testing.assert_allclose(np.cross(b - a, c - a)[:, 2], np.sqrt(0.75) / 4)
    np.testing.assert_array_equal(split.parent, np.repeat(np.arange(len(faces)), 4))


def test_weights_at_a_vertex_of_six_and_on_an_edge_are_those_of_the_scheme() -> None:
    points, faces = flat_grid()
    split = split_faces(faces, len(points), np.ones(len(faces), dtype=bool))
    weights = loop_weights(split, faces, len(points)).toarray()
    middle = GRID * 3 + 3
    around = middle + np.array([-GRID, GRID, -1, 1, GRID - 1, 1 - GRID])
    np.testing.assert_allclose(weights[middle, around], 1 / 16)
    assert weights[middle, middle] == 0.625
    (edge,) = np.flatnonzero((split.edges == [middle, middle + 1]).all(axis=1))
    row = weights[len(points) + edge]
    np.testing.assert_allclose(np.sort(row[row > 0]), [0.125, 0.125, 0.375, 0.375])
    np.testing.assert_allclose(weights[3, [2, 3, 4]], [0.125, 0.75, 0.125])


def test_a_border_follows_nothing_within() -> None:
    points, faces = flat_grid()
    split = split_faces(faces, len(points), np.ones(len(faces), dtype=bool))
    weights = loop_weights(split, faces, len(points)).toarray()
    border = np.isin(np.arange(GRID * GRID) % GRID, (0, GRID - 1)) | np.isin(
        np.arange(GRID * GRID) // GRID, (0, GRID - 1)
    )
    counts = np.bincount((split.middles - len(points)).ravel())
    rows = np.concatenate([np.flatnonzero(border), len(points) + np.flatnonzero(counts == 1)])
    assert not weights[np.ix_(rows, np.flatnonzero(~border))].any()


def test_faces_that_are_not_chosen_stay() -> None:
    points, faces = flat_grid()
    both = np.concatenate([faces, faces + len(points)])
    chosen = np.arange(len(both)) >= len(faces)
    split = split_faces(both, 2 * len(points), chosen)
    np.testing.assert_array_equal(split.faces[: len(faces)], faces)
    assert (split.middles[~chosen] == -1).all()
    twice = np.concatenate([points, points + 5.0])
    smooth = loop_weights(split, both, 2 * len(points)) @ twice
    np.testing.assert_allclose(smooth[: len(points)], points, atol=1e-14)
