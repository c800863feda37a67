"""Moves that carry no element through another: from any state that crosses nowhere, to anywhere."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.collision.crossing_free_states import Surface, folded, lying, nested, stack
from tests.physics.shapes import sheet

from pb4u.collision.collision_free import SMALLEST_GAP, free_shares, met_by_obstacles, past_obstacles, smallest_gaps
from pb4u.collision.element_distance import free_share, nearest
from pb4u.collision.element_pairs import ElementPairs
from pb4u.collision.surface_tree import SurfaceTree

PROMISED_GAP = 5e-5
SURFACES = {
    "sheet": stack(1, 0.0, cells=4),
    "stack": stack(3, 2e-3, cells=3),
    "tight stack": stack(3, 1.2e-4, cells=3),
    "folded": folded(4, 1e-3, cells=2),
    "nested": nested(5e-3, around=8, along=2),
    "worlds": stack(4, 1e-3, cells=2, worlds=(0, 0, 1, 1)),
}
WISHES = ("small", "large", "huge", "mirrored", "turned over", "crumpled", "gathered", "through")


def collision_free(*move: Any) -> np.ndarray:
    return past_obstacles(*move)[0]


def wished(surface: Surface, wish: str, seed: int) -> np.ndarray:
    """Positions (vertices, 3) [m] that are asked for."""
    rng = np.random.default_rng(seed)
    x = surface.before
    noise = rng.normal(size=x.shape)
    if wish == "gathered":
        return np.tile(rng.normal(size=3), (len(x), 1))
    if wish == "mirrored":
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        return x - 2.0 * ((x - x.mean(axis=0)) @ normal)[:, None] * normal
    if wish == "turned over":
        return x @ np.diag([1.0, -1.0, -1.0])
    if wish == "through":
        # Every garment is carried its own way.
        return x + (0.1 * rng.normal(size=(surface.part.max() + 1, 3)))[surface.part]
    if wish == "crumpled":
        return x.mean(axis=0) + 0.1 * (x - x.mean(axis=0)) + 1e-3 * noise
    return x + {"small": 1e-3, "large": 0.1, "huge": 300.0}[wish] * noise


def require_kept(surface: Surface, reached: np.ndarray) -> None:
    """No element has come nearer to another than is promised, and no face crosses another as it is written."""
    distances = surface.all_pairs.nearest(reached)[0]
    before = surface.all_pairs.nearest(surface.before)[0]
    promised = np.minimum(PROMISED_GAP, 0.5 * np.minimum(before, 0.25 * surface.all_pairs.rest_distance))
    assert (distances >= promised).all()
    if np.abs(reached).max() < 3.0:
        assert surface.crossing(reached) == 0


@given(
    name=st.sampled_from(sorted(SURFACES)),
    wish=st.sampled_from(WISHES),
    seed=st.integers(0, 10**6),
    pins=st.sampled_from([0.0, 0.2]),
)
@settings(max_examples=30, deadline=None)
def test_from_any_state_to_anywhere(name: str, wish: str, seed: int, pins: float) -> None:
    surface = SURFACES[name]
    assert surface.crossing(surface.before) == 0
    wanted = wished(surface, wish, seed)
    masses = np.where(np.random.default_rng(seed).random(len(wanted)) < pins, np.inf, 1e-3)
    require_kept(surface, collision_free(surface.tree, surface.before, wanted, masses))


@given(wishes=st.lists(st.sampled_from(WISHES), min_size=4, max_size=8), seed=st.integers(0, 10**6))
@settings(max_examples=8, deadline=None)
def test_moves_after_one_another_grind_no_gap_down(wishes: list[str], seed: int) -> None:
    surface, x = SURFACES["folded"], SURFACES["folded"].before
    for k, wish in enumerate(wishes):
        moved = Surface(surface.rest, surface.faces, surface.part, surface.world, x)
        wanted = wished(moved, wish, seed + k)
        x = collision_free(surface.tree, x, np.clip(wanted, -2.0, 2.0), np.full(len(x), 1e-3))
        require_kept(surface, x)


@pytest.mark.parametrize("name", SURFACES)
def test_what_touches_nothing_arrives(name: str) -> None:
    surface, masses = SURFACES[name], np.ones(len(SURFACES[name].rest))
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    for wanted in (surface.before + [9.0, -1.0, 4.0], 1.5 * surface.before, surface.before.copy()):
        assert collision_free(surface.tree, surface.before, wanted, masses) is wanted
    # A quarter turn is not a linear move: what is asked of it is allowed to end elsewhere, but crosses nowhere.
    require_kept(surface, collision_free(surface.tree, surface.before, surface.before @ turn, masses))


def test_what_touches_nothing_arrives_beside_what_does() -> None:
    surface = stack(2, 2e-3)
    wanted = surface.before.copy()
    wanted[0] += [0.0, 0.05, 0.0]  # a corner of the lower sheet, through the upper
    reached = collision_free(surface.tree, surface.before, wanted, np.ones(len(wanted)))
    far = np.linalg.norm(surface.before - surface.before[0], axis=1) > 0.15
    np.testing.assert_array_equal(reached[far], wanted[far])
    require_kept(surface, reached)


def test_pinned_cloth_pushes_what_is_free() -> None:
    surface = stack(2, 1e-3)
    pinned = surface.part == 0
    wanted = surface.before + pinned[:, None] * np.array([0.0, 0.03, 0.0])
    reached = collision_free(surface.tree, surface.before, wanted, np.where(pinned, np.inf, 1e-3))
    np.testing.assert_allclose(reached[pinned], wanted[pinned], atol=1e-12)
    assert reached[~pinned, 1].mean() > 0.02
    require_kept(surface, reached)


def test_an_impulse_keeps_the_momentum() -> None:
    surface = stack(2, 1e-3)
    masses = np.random.default_rng(0).uniform(0.5, 2.0, len(surface.rest))
    wanted = surface.before + np.where(surface.part == 0, 2e-3, 0.0)[:, None] * np.array([0.3, 1.0, 0.0])
    reached = collision_free(surface.tree, surface.before, wanted, masses)
    assert reached is not wanted
    np.testing.assert_allclose(masses @ reached, masses @ wanted, rtol=1e-9)


@pytest.mark.parametrize("falls", [0.0, 3e-3, 0.05])
def test_cloth_that_came_by_another_way_is_turned_aside_by_obstacles_alone(falls: float) -> None:
    """Two sheets that changed places, beneath a third that is an obstacle."""
    surface = stack(3, 2e-3)
    upper, first = surface.part == 1, int(np.flatnonzero(surface.part == 2)[0])
    tree = SurfaceTree(
        surface.rest, surface.faces, surface.edges, surface.part, surface.world, len(surface.rest) - first
    )
    heights = np.select([surface.part == 0, upper], [2e-3, -2e-3], -falls)
    before, wanted = surface.before, surface.before + heights[:, None] * [0.0, 1.0, 0.0]
    masses, passed = np.where(surface.part == 2, np.inf, 1e-3), np.zeros(len(before), dtype=bool)
    assert past_obstacles(tree, before, wanted, masses)[0] is not wanted
    known = met_by_obstacles(tree, before, wanted, passed)
    assert len(known[0]) or not falls
    assert (known[0].corners >= first).any(axis=1).all()
    reached, through = past_obstacles(tree, before, wanted, masses, known)
    assert (reached is wanted) == (falls == 0.0)
    assert not through.any()
    require_kept(surface, reached)


def test_one_world_does_not_hold_up_another() -> None:
    surface = stack(4, 1e-3, cells=4, worlds=(0, 0, 1, 1))
    alone = stack(2, 1e-3, cells=4)
    rng = np.random.default_rng(7)
    for size in (1e-3, 0.1, 10.0):
        first = alone.before + size * rng.normal(size=alone.before.shape)
        rest = surface.before[len(first) :] + [0.0, 0.2, 0.1]
        masses = np.ones(len(surface.rest))
        both = collision_free(surface.tree, surface.before, np.concatenate([first, rest]), masses)
        np.testing.assert_allclose(both[len(first) :], rest, atol=1e-12)
        expected = collision_free(alone.tree, alone.before, first, masses[: len(first)])
        np.testing.assert_allclose(both[: len(first)], expected, atol=1e-12)


def test_a_free_share_never_passes() -> None:
    rng = np.random.default_rng(11)
    weights, between = np.empty(4), np.empty(3)
    cut = 0
    for k in range(400):
        points, moves = rng.normal(size=(2, 4, 3))
        vertex_face, gap = bool(k % 2), 0.2 * nearest(points, bool(k % 2), weights, between)
        share = free_share(points.copy(), moves.copy(), vertex_face, gap, weights, between)
        cut += share < 1.0
        for part in np.linspace(0.0, share, 60):
            assert nearest(points + part * moves, vertex_face, weights, between) >= gap
    assert cut > 50


def test_free_shares_are_no_longer_than_those_of_the_ipc_toolkit() -> None:
    ipctk = pytest.importorskip("ipctk")
    detection = ipctk.AdditiveCCD(conservative_rescaling=0.9)
    rng = np.random.default_rng(13)
    corners, hits, ratios = np.arange(4)[None], 0, []
    for k in range(300):
        points, moves = rng.normal(size=(4, 3)), 2.0 * rng.normal(size=(4, 3))
        vertex_face = bool(k % 2)
        pairs = ElementPairs(corners, int(vertex_face), np.array([np.inf]))
        share = free_shares(pairs, np.zeros(1), points, moves)[0]
        find = detection.point_triangle_ccd if vertex_face else detection.edge_edge_ccd
        collides, time = find(*points, *(points + moves), min_distance=0.0, tmax=1.0)
        if collides and share == 1.0:
            # A move may end nearer than the toolkit stops it, not on the other side.
            assert nearest_on_the_way(points, moves, vertex_face, 1.0) > 0.0
        elif collides:
            hits += 1
            ratios.append(share / time)
            assert nearest_on_the_way(points, moves, vertex_face, share) > 0.0
    assert hits > 20
    # Both stop where a tenth of what was between the elements is left, theirs a little later.
    assert max(ratios) <= 1.1
    assert np.median(ratios) > 0.8


def nearest_on_the_way(points: np.ndarray, moves: np.ndarray, vertex_face: bool, share: float) -> float:
    weights, between = np.empty(4), np.empty(3)
    return min(nearest(points + part * moves, vertex_face, weights, between) for part in np.linspace(0.0, share, 80))


def test_gaps_give_way_where_rest_or_the_present_is_nearer() -> None:
    surface = stack(2, 6e-5, cells=3)
    pairs = surface.all_pairs
    gaps = smallest_gaps(pairs, surface.before)
    distances = pairs.nearest(surface.before)[0]
    assert (gaps < distances).all()
    assert (gaps <= SMALLEST_GAP).all()
    assert (gaps <= 0.25 * pairs.rest_distance).all()
    close = np.isinf(pairs.rest_distance) & (distances > 2 * SMALLEST_GAP)
    assert (gaps[close] == SMALLEST_GAP).all()


def test_slivers_may_come_as_near_as_they_are() -> None:
    garment = sheet(40, 2, 2e-3, 0.1)  # columns 50 micrometres wide
    surface = stack(1, 0.0)
    flat = garment.vertices[:, [0, 2, 1]]
    surface = Surface(garment.vertices, garment.faces, np.zeros(len(flat), dtype=np.int64), (0,), flat)
    wanted = flat + 1e-5 * np.random.default_rng(2).normal(size=flat.shape)
    reached = collision_free(surface.tree, flat, wanted, np.ones(len(flat)))
    np.testing.assert_array_equal(reached, wanted)


def test_a_lying_sheet_is_flat() -> None:
    _, state = lying(height=0.3)
    assert (state[:, 1] == 0.3).all()
