"""Distances between elements, and the search for those that come near, against slow readable twins."""

from __future__ import annotations

import numpy as np
import pytest
from tests.collision.crossing_free_states import Surface, folded, nested, stack

from pb4u.collision import surface_tree
from pb4u.collision.element_distance import nearest
from pb4u.collision.element_pairs import ElementPairs
from pb4u.collision.surface_tree import SurfaceTree

SURFACES = {
    "stack": stack(3, 2e-3),
    "folded": folded(4, 3e-3),
    "nested": nested(4e-3),
    "worlds": stack(4, 1e-3, cells=4, worlds=(0, 0, 1, 1)),
}
on_surfaces = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "nested" else []) for name in SURFACES]
)


def keys(pairs: ElementPairs, rows: np.ndarray | None = None) -> set[tuple[bool, tuple[int, ...]]]:
    """The pairs whatever the order of their corners."""
    corners = pairs.corners.tolist()
    wanted = range(len(corners)) if rows is None else np.flatnonzero(rows)
    return {
        (False, (corners[k][0], *sorted(corners[k][1:])))
        if k < pairs.vertex_faces
        else (True, tuple(v for edge in sorted((sorted(corners[k][:2]), sorted(corners[k][2:]))) for v in edge))
        for k in wanted
    }


def sampled(points: np.ndarray, vertex_face: bool, steps: int = 40) -> float:
    """Least distance [m] between points spread evenly over two elements."""
    u, v = (grid.ravel() for grid in np.meshgrid(*[np.linspace(0.0, 1.0, steps + 1)] * 2))
    if vertex_face:
        inside = u + v <= 1.0 + 1e-9
        on_face = np.column_stack([1.0 - u - v, u, v])[inside] @ points[1:]
        return float(np.linalg.norm(on_face - points[0], axis=1).min())
    one = np.column_stack([1.0 - u, u]) @ points[:2]
    other = np.column_stack([1.0 - v, v]) @ points[2:]
    return float(np.linalg.norm(one - other, axis=1).min())


@pytest.mark.parametrize("vertex_face", [True, False])
def test_a_distance_is_the_least_between_any_two_points(vertex_face: bool) -> None:
    rng = np.random.default_rng(3)
    weights, between = np.empty(4), np.empty(3)
    for _ in range(200):
        points = rng.normal(size=(4, 3))
        distance = nearest(points, vertex_face, weights, between)
        spacing = max(float(np.linalg.norm(p - q)) for p in points for q in points) / 40
        assert distance <= sampled(points, vertex_face) <= distance + 1.5 * spacing
        np.testing.assert_allclose(weights @ points, between, atol=1e-14)
        assert np.linalg.norm(between) == pytest.approx(distance, rel=1e-12)
        ones = weights * ([1, -1, -1, -1] if vertex_face else [1, 1, -1, -1])
        assert (ones >= 0).all()
        assert weights.sum() == pytest.approx(0.0, abs=1e-14)


def test_distances_are_those_of_the_ipc_toolkit() -> None:
    ipctk = pytest.importorskip("ipctk")
    rng = np.random.default_rng(5)
    weights, between = np.empty(4), np.empty(3)
    for k in range(300):
        # Flat and parallel ones too, where formulas break.
        points = rng.normal(size=(4, 3)) * [1.0, 1.0, (1.0, 1e-3, 0.0)[k % 3]]
        if k % 5 == 0:
            points[3] = points[2] + (points[1] - points[0]) * rng.uniform(0.2, 2.0)
        expected = np.sqrt(ipctk.point_triangle_distance(*points)), np.sqrt(ipctk.edge_edge_distance(*points))
        found = nearest(points, True, weights, between), nearest(points, False, weights, between)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("reach", [5e-4, pytest.param(3e-3, marks=pytest.mark.slow), 3e-2])
def test_all_near_pairs_are_found_once(name: str, reach: float) -> None:
    surface = SURFACES[name]
    found = surface.tree.pairs(surface.before, reach)
    assert len(keys(found)) == len(found)
    near = surface.all_pairs.nearest(surface.before)[0] < reach
    assert keys(surface.all_pairs, near) <= keys(found) <= keys(surface.all_pairs)
    # A superset, and a small one: boxes of elements a hundred times as far are not listed.
    if reach < 1e-3:
        assert len(found) < 0.2 * len(surface.all_pairs)


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("size", [1e-3, 0.05, 1.0])
def test_pairs_that_meet_on_the_way_are_found(name: str, size: float) -> None:
    surface = SURFACES[name]
    rng = np.random.default_rng(1)
    moves = size * rng.normal(size=surface.before.shape)
    near = _nearest_on_the_way(surface, surface.before, moves) < 1e-3
    assert near.any()
    assert keys(surface.all_pairs, near) <= keys(surface.tree.pairs(surface.before, 1e-3, moves))


@pytest.mark.parametrize("name", SURFACES)
def test_pairs_of_some_vertices_are_those_of_all_that_have_one(name: str) -> None:
    surface = SURFACES[name]
    rng = np.random.default_rng(4)
    among = rng.random(len(surface.before)) < 0.05
    moves = 0.05 * rng.normal(size=surface.before.shape) * among[:, None]
    every = surface.tree.pairs(surface.before, 5e-3, moves)
    some = surface.tree.pairs(surface.before, 5e-3, moves, among=among)
    assert 0 < len(some) < len(every)
    assert keys(some) == keys(every, among[every.corners].any(axis=1))


@on_surfaces
def test_known_pairs_of_some_vertices_serve_while_no_other_moves(name: str) -> None:
    surface = SURFACES[name]
    tree, rng = surface.tree, np.random.default_rng(9)
    among = rng.random(len(surface.before)) < 0.1
    x, known = surface.before, tree.pairs(surface.before, 2e-3, lasting=True, among=among)
    for size in (0.0, 2e-4, 0.05, 2e-4):
        moves = size * rng.normal(size=x.shape) * among[:, None]
        found = tree.pairs(x, 2e-3, moves, known, lasting=True, among=among)
        near = (_nearest_on_the_way(surface, x, moves) < 2e-3) & among[surface.all_pairs.corners].any(axis=1)
        _assert_complete(surface, near, found)
        assert among[found.corners].any(axis=1).all()
        x, known = x + moves, found


@on_surfaces
def test_pairs_known_before_save_a_search_and_change_nothing(name: str) -> None:
    """Over several moves: small ones, one of a few vertices that go far, and one of all."""
    surface = SURFACES[name]
    tree, rng = surface.tree, np.random.default_rng(2)
    x, known = surface.before, surface.tree.pairs(surface.before, 2e-3, lasting=True)
    kept = []
    for size, share in ((2e-4, 1.0), (3e-4, 1.0), (0.05, 0.04), (2e-4, 1.0), (0.1, 1.0), (2e-4, 1.0)):
        moves = size * rng.normal(size=x.shape) * (rng.random(len(x)) < share)[:, None]
        found, before = tree.pairs(x, 2e-3, moves, known, lasting=True), known.neighbourhood
        _assert_complete(surface, _nearest_on_the_way(surface, x, moves) < 2e-3, found)
        assert before is not None
        away = np.linalg.norm([x - before.end, x + moves - before.end], axis=2)
        kept.append(found.neighbourhood is before)
        assert kept[-1] == bool((away <= before.room).all())
        x, known = x + moves, found
    # Small moves are served by what is known; what goes far is searched for, and known from then on.
    assert kept[0]
    assert kept[3]
    assert not kept[4]


@on_surfaces
@pytest.mark.parametrize("size", [pytest.param(2e-3, marks=pytest.mark.slow), 0.03])
def test_pairs_known_of_one_move_serve_another_that_ends_near(name: str, size: float) -> None:
    """As a move that is turned aside where cloth meets cloth, and one that starts where the first one ended."""
    surface = SURFACES[name]
    tree, rng = surface.tree, np.random.default_rng(4)
    moves = size * rng.normal(size=surface.before.shape)
    known = tree.pairs(surface.before, 2e-3, moves, lasting=True)
    _assert_complete(surface, _nearest_on_the_way(surface, surface.before, moves) < 2e-3, known)
    for x, further in (
        (surface.before, moves + 5e-4 * rng.normal(size=moves.shape)),
        (surface.before + moves, 5e-4 * rng.normal(size=moves.shape)),
        (surface.before + 0.7 * moves, 0.2 * moves),
    ):
        nearest = _nearest_on_the_way(surface, x, further)
        for reach in (2e-3, 1e-3):
            _assert_complete(surface, nearest < reach, tree.pairs(x, reach, further, known))
    served = tree.pairs(surface.before, 2e-3, moves + 1e-4, known)
    assert served.neighbourhood is known.neighbourhood


@on_surfaces
def test_a_move_from_the_same_start_is_followed_beside_one_that_strayed(name: str) -> None:
    """All go far from one start; then a few go elsewhere from there, which meet what the others pass on their way."""
    surface = SURFACES[name]
    tree, rng = surface.tree, np.random.default_rng(6)
    moves = 0.05 * rng.normal(size=surface.before.shape)
    known = tree.pairs(surface.before, 2e-3, moves, lasting=True)
    for share in (0.1, 0.3):
        others = 0.1 * rng.normal(size=moves.shape) * (rng.random(len(moves)) < share)[:, None]
        known = tree.pairs(surface.before, 2e-3, moves + others, known, lasting=True)
        _assert_complete(surface, _nearest_on_the_way(surface, surface.before, moves + others) < 2e-3, known)
    back = -0.5 * (moves + others)
    found = tree.pairs(surface.before + moves + others, 2e-3, back, known, lasting=True)
    _assert_complete(surface, _nearest_on_the_way(surface, surface.before + moves + others, back) < 2e-3, found)


def test_pairs_with_an_obstacle_have_a_reach_of_their_own() -> None:
    surface = SURFACES["stack"]
    first = int(np.flatnonzero(surface.part == surface.part.max())[0])
    tree = SurfaceTree(
        surface.rest, surface.faces, surface.edges, surface.part, surface.world, len(surface.rest) - first
    )
    corners = surface.all_pairs.corners
    own, mixed = (corners < first).all(axis=1), (corners < first).any(axis=1) & (corners >= first).any(axis=1)
    known, moves = None, 1e-3 * np.random.default_rng(7).normal(size=surface.before.shape)
    for x in (surface.before, surface.before + 0.1 * moves):
        distances = _nearest_on_the_way(surface, x, moves)
        found = tree.pairs(x, 6e-3, moves, known, lasting=True, obstacle_reach=2e-3)
        _assert_complete(surface, (own & (distances < 6e-3)) | (mixed & (distances < 2e-3)), found)
        assert not keys(surface.all_pairs, mixed & (distances > 5e-3)) & keys(found)
        assert known is None or found.neighbourhood is known.neighbourhood
        known = found


@pytest.mark.parametrize("name", ["stack", "worlds"])
def test_pairs_of_obstacles_alone_are_all_that_have_one(name: str) -> None:
    surface = SURFACES[name]
    first = int(np.flatnonzero(surface.part == surface.part.max())[0])
    obstacles = len(surface.rest) - first
    tree = SurfaceTree(surface.rest, surface.faces, surface.edges, surface.part, surface.world, obstacles)
    moves = 5e-3 * np.random.default_rng(8).normal(size=surface.before.shape)
    every = tree.pairs(surface.before, 5e-3, moves)
    mixed = (every.corners >= first).any(axis=1)
    assert mixed.any()
    assert not mixed.all()
    some = tree.pairs(surface.before, 5e-3, moves, among=np.arange(len(surface.rest)) >= first)
    assert keys(some) == keys(every, mixed)
    assert len(keys(some)) == len(some)


@pytest.mark.parametrize("name", ["stack", "worlds"])
@pytest.mark.parametrize("asked", ["all", "obstacles", "some"])
def test_a_search_in_parts_finds_the_same_in_the_same_order(
    name: str, asked: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    surface, rng = SURFACES[name], np.random.default_rng(9)
    count = len(surface.rest)
    first = int(np.flatnonzero(surface.part == surface.part.max())[0])
    tree = SurfaceTree(surface.rest, surface.faces, surface.edges, surface.part, surface.world, count - first)
    among = {"all": None, "obstacles": np.arange(count) >= first, "some": rng.random(count) < 0.1}[asked]
    moves, found = 5e-3 * rng.normal(size=surface.before.shape), []
    for few in (count, 0):
        monkeypatch.setattr(surface_tree, "_FEW", few)
        found.append(tree.pairs(surface.before, 5e-3, moves, among=among))
    assert len(found[0])
    np.testing.assert_array_equal(found[0].corners, found[1].corners)


def _nearest_on_the_way(surface: Surface, x: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Least distance [m] of every pair on the way, at steps of a fifth of the reach or of a fortieth of the way."""
    steps = min(41, 2 + int(np.abs(moves).max() / 2e-4))
    parts = np.linspace(0.0, 1.0, steps)
    return np.minimum.reduce([surface.all_pairs.nearest(x + part * moves)[0] for part in parts])


def _assert_complete(surface: Surface, near: np.ndarray, found: ElementPairs) -> None:
    """Whether all pairs that come near on the way are found, each once."""
    assert keys(surface.all_pairs, near) <= keys(found)
    assert len(keys(found)) == len(found)


def test_cloth_that_is_carried_along_gives_no_more_pairs() -> None:
    surface = SURFACES["stack"]
    still = surface.tree.pairs(surface.before, 1e-3)
    carried = surface.tree.pairs(surface.before, 1e-3, np.broadcast_to([3.0, 1.0, -2.0], surface.before.shape).copy())
    assert keys(carried) == keys(still)


@pytest.mark.parametrize("name", SURFACES)
def test_distances_at_rest_are_within_a_part(name: str) -> None:
    surface = SURFACES[name]
    found = surface.tree.pairs(surface.before, 0.02)
    apart = surface.part[found.corners[:, 0]] != surface.part[found.corners[:, 2]]
    np.testing.assert_array_equal(np.isinf(found.rest_distance), apart)
    np.testing.assert_array_equal(found.rest_distance[~apart], found.nearest(surface.rest)[0][~apart])


def test_worlds_do_not_meet() -> None:
    surface: Surface = SURFACES["worlds"]
    found = surface.tree.pairs(surface.before, 0.1)
    worlds = np.asarray(surface.world)[surface.part[found.corners]]
    assert (worlds == worlds[:, :1]).all()
    assert set(np.unique(worlds)) == {0, 1}
