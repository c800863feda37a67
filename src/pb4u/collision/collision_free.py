"""Moves of a surface that carry no element of it through another.

A move from a surface that crosses nowhere is made so that it crosses nowhere either, and that no two elements come
nearer than a smallest gap. Where two would touch, they are given an impulse along the line between them that leaves
the rest of their motion as it was; where impulses do not settle it, what touches moves together as one.
"""

from __future__ import annotations

import sys

import numpy as np

from pb4u.collision.element_distance import free_share, gather, nearest
from pb4u.collision.element_pairs import ElementPairs
from pb4u.collision.jit import compiled
from pb4u.collision.surface_elements import any_corner
from pb4u.collision.surface_tree import SurfaceTree

SMALLEST_GAP = 1e-4
"""Distance [m] that no two elements come within: rounding to float32 at two metres moves a vertex by 1e-7 m."""

_SHARE_OF_REST = 0.25
"""Share of their distance at rest that two elements of one garment may always come within: slivers of a mesh."""

_OF_PRESENT = 0.9
"""The same of its distance before a move, where that is less than the gap."""

_OF_OBSTACLE_PRESENT = 0.5
"""Most of its distance from an obstacle before a move that an element keeps: no energy holds them apart, and cloth that
lies at the smallest gap on skin that bends could not move, so that skin was let through it."""

_OFF_OBSTACLES = 2.0 * SMALLEST_GAP
"""Distance [m] from obstacles to which impulses lead what met them: the next move begins with room."""

_PAST_OBSTACLES = 1.5
"""Most speed, over that of the fastest of its world, to which an obstacle brings what it meets: cloth that also goes
aside, or that is met at one end of an edge, cannot keep clear of what pushes it at that speed alone."""

_IMPULSES = 12
"""Rounds of impulses: a stack of layers passes one on from layer to layer."""

_MORE_IMPULSES = 100
"""The same where obstacles found no room in those: cloth that an arm closes on the trunk settles slowly."""

_LEAST_RESPONSE = 0.1
"""Share of the response of a pair of free elements below which an impulse is not made larger for it: where nearly all
of the weight is on vertices that do not give way, it would fling the others."""

_ZONES = 20
"""Rounds in which what touches is moved together: each joins more."""

_ZONES_WITH_OBSTACLES = 8
"""The same of what touches moving obstacles, before these are let through it."""

_PARTS = 4
"""Smaller moves that are tried where an obstacle finds no room in one: a running leg goes 20 cm in a step."""


def smallest_gaps(pairs: ElementPairs, before: np.ndarray, first_obstacle: int = sys.maxsize) -> np.ndarray:
    """Gaps (pairs,) [m] that the pairs keep; less than `SMALLEST_GAP` where they are that near at rest or `before`.

    Args:
        pairs: of the surface.
        before: (vertices, 3) [m] positions that cross nowhere.
        first_obstacle: number of the first vertex of obstacles, which are the last ones.
    """
    return _smallest_gaps(before, pairs.corners, pairs.vertex_faces, pairs.rest_distance, first_obstacle)


def free_shares(pairs: ElementPairs, gaps: np.ndarray, vertices: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Shares (pairs,) in [0, 1] of `moves` that each pair may take without coming nearer than its gap.

    Args:
        pairs: all that may touch on the way.
        gaps: (pairs,) [m].
        vertices: (vertices, 3) [m].
        moves: (vertices, 3) [m], linear.
    """
    return _free_shares(vertices, moves, pairs.corners, pairs.vertex_faces, gaps)


def past_obstacles(
    tree: SurfaceTree,
    before: np.ndarray,
    wanted: np.ndarray,
    masses: np.ndarray,
    known: tuple[ElementPairs, np.ndarray] | None = None,
    passed: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions near `wanted` that `before` reaches without an element passing through another; obstacles go first.

    Where obstacles leave no room in one move, though more impulses are given, they go in several, each on from where
    the last turned the surface aside. If that leaves no room either, they are let through the elements that they meet
    last.

    Args:
        tree: of the surface, its obstacles last.
        before: (vertices, 3) float64 [m] that cross nowhere but where obstacles have `passed`.
        wanted: (vertices, 3) float64 [m].
        masses: (vertices,) [kg]; infinite for vertices that give way to no impulse, as those of obstacles are.
        known: all pairs that may touch on the way and their gaps (pairs,) [m], where they were queried already; or
            those that `met_by_obstacles` tells of.
        passed: (vertices,) bool of the surface that obstacles are let through; none by default.

    Returns:
        Positions (vertices, 3) [m], `wanted` itself where nothing touches, and what (vertices,) bool obstacles have
        passed through by then.
    """
    passed = np.zeros(len(before), dtype=bool) if passed is None else passed
    found = []
    for impulses in (_IMPULSES, _MORE_IMPULSES):
        found.append(_in_one_move(tree, before, wanted, masses, known, passed, before, impulses))
        if found[-1][1].sum() == passed.sum():
            return found[-1]
    x, still, aside = before, passed, np.zeros_like(before)
    for part in range(1, _PARTS + 1):
        way = wanted + (part / _PARTS - 1.0) * (wanted - before)
        # Gaps are those of the whole move: what is nearer than a gap has no finite energy.
        x, still = _in_one_move(tree, x, way + aside, masses, None, still, before, _IMPULSES)
        aside = x - way
    return min(*found, (x, still), key=lambda each: each[1].sum())


def met_by_obstacles(
    tree: SurfaceTree, before: np.ndarray, wanted: np.ndarray, passed: np.ndarray
) -> tuple[ElementPairs, np.ndarray]:
    """Pairs with an obstacle that may touch on the way, and their gaps (pairs,) [m].

    They are all that `past_obstacles` has to know of a way to positions that the surface is known to reach otherwise
    without touching itself: what obstacles turn aside there is looked at anew.

    Args:
        tree: of the surface, its obstacles last.
        before: (vertices, 3) float64 [m] that cross nowhere but where obstacles have `passed`.
        wanted: (vertices, 3) float64 [m].
        passed: (vertices,) bool of the surface that obstacles are let through.
    """
    of_obstacles = np.arange(len(before)) >= tree.first_obstacle
    return _met(tree, before, wanted - before, passed, before, changed=of_obstacles)


def _in_one_move(
    tree: SurfaceTree,
    before: np.ndarray,
    wanted: np.ndarray,
    masses: np.ndarray,
    known: tuple[ElementPairs, np.ndarray] | None,
    passed: np.ndarray,
    began: np.ndarray,
    impulses: int,
) -> tuple[np.ndarray, np.ndarray]:
    """The same in one linear move; pairs keep the gaps (pairs,) [m] that they have where they `began` (vertices, 3).

    What touches still after so many rounds of `impulses` moves together.
    """
    moves = wanted - before
    if not moves.any():
        return wanted, passed
    pairs, gaps = known or _met(tree, before, moves, passed, began)
    shares = free_shares(pairs, gaps, before, moves)
    if (shares >= 1.0).all():
        return wanted, passed
    inverse, joined = 1.0 / masses, np.arange(len(before))
    worlds = tree.vertex_world.max(initial=0) + 1
    fastest = np.zeros(worlds)
    np.maximum.at(fastest, tree.vertex_world, (moves**2).sum(axis=1))
    firm = slice(tree.first_obstacle, None)
    closing, looked_up = moves[firm].any(), moves.copy()
    for attempt in range(impulses + _ZONES):
        if (shares >= 1.0).all():
            # Changed moves may meet others than the first ones did.
            pairs, gaps = _met(tree, before, moves, passed, began, pairs, _differ(moves, looked_up))
            looked_up = moves.copy()
            shares = free_shares(pairs, gaps, before, moves)
            if (shares >= 1.0).all():
                return before + moves, passed
        touching, previous = shares < 1.0, moves.copy()
        if attempt >= impulses + _ZONES_WITH_OBSTACLES and closing:
            # Nor does it help to go with them: there is no room. Beside what stands still there always is.
            passed = passed | _met_by_obstacles(pairs.corners[touching], tree.first_obstacle, len(moves))
            kept = ~through_obstacle(pairs.corners, tree.first_obstacle, passed)
            pairs, gaps, shares = pairs.chosen(kept), gaps[kept], shares[kept]
            touching = shares < 1.0
        hit = pairs.chosen(touching)
        if attempt < impulses:
            stopped = (gaps[touching], shares[touching])
            limits = (tree.first_obstacle, fastest)
            _impulses(before, moves, hit.corners, hit.vertex_faces, *stopped, inverse, tree.vertex_world, *limits)
        else:
            moves = _merge_touching(moves, hit.corners, joined, masses)
            moves[firm] = previous[firm]
        changed = any_corner(pairs.corners, _differ(moves, previous))
        shares[changed] = free_shares(pairs.chosen(changed), gaps[changed], before, moves)
    # All of a world together, as far as nothing touches: it always can be, but for obstacles.
    pairs, gaps = _met(tree, before, moves, passed, began, pairs)
    free, shares = np.ones(worlds), free_shares(pairs, gaps, before, moves)
    own = (pairs.corners < tree.first_obstacle).all(axis=1)
    np.minimum.at(free, tree.vertex_world[pairs.corners[own, 0]], shares[own])
    moves[: tree.first_obstacle] *= free[tree.vertex_world[: tree.first_obstacle], None]
    if closing:
        pairs, gaps = _met(tree, before, moves, passed, began, pairs)
        met = pairs.corners[free_shares(pairs, gaps, before, moves) < 1.0]
        passed = passed | _met_by_obstacles(met, tree.first_obstacle, len(moves))
    return before + moves, passed


def through_obstacle(corners: np.ndarray, first_obstacle: int, passed: np.ndarray) -> np.ndarray:
    """Which pairs (pairs,) bool are of an obstacle and an element that obstacles are let through.

    Args:
        corners: (pairs, 4) int64 of the pairs.
        first_obstacle: number of the first vertex of obstacles; they are the last ones.
        passed: (vertices,) bool of the surface that obstacles are let through.
    """
    return (corners >= first_obstacle).any(axis=1) & passed[corners].any(axis=1)


def _met_by_obstacles(corners: np.ndarray, first_obstacle: int, count: int) -> np.ndarray:
    """Mask (count,) of the surface vertices that occur in a pair, of `corners` (pairs, 4), with an obstacle."""
    met = np.zeros(count, dtype=bool)
    own = corners < first_obstacle
    mixed = ~own.all(axis=1)
    met[corners[mixed][own[mixed]]] = True
    return met


def _met(
    tree: SurfaceTree,
    before: np.ndarray,
    moves: np.ndarray,
    passed: np.ndarray,
    began: np.ndarray,
    known: ElementPairs | None = None,
    changed: np.ndarray | None = None,
) -> tuple[ElementPairs, np.ndarray]:
    """Pairs that may touch along `moves`, and their gaps (pairs,) [m]; what obstacles have `passed` is left out.

    Pairs of vertices that have not `changed` (vertices,) their moves since they were known free may be left out too.
    """
    # The penetration response and the clean-up move few vertices; what stands still meets nothing that does.
    if known is not None and known.neighbourhood is not None:
        pairs = tree.pairs(before, SMALLEST_GAP, moves, known)
    else:
        if changed is None:
            changed = np.any(moves, axis=1)
            if changed[tree.first_obstacle :].any():
                changed = np.arange(len(moves)) < tree.first_obstacle
        pairs = tree.pairs(before, SMALLEST_GAP, moves, among=changed)
    if passed.any():
        pairs = pairs.chosen(~through_obstacle(pairs.corners, tree.first_obstacle, passed))
    return pairs, smallest_gaps(pairs, began, tree.first_obstacle)


@compiled
def _differ(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Which rows (vertices,) bool of two arrays (vertices, 3) are not the same."""
    differ = np.empty(len(one), dtype=np.bool_)
    for row in range(len(one)):
        differ[row] = one[row, 0] != other[row, 0] or one[row, 1] != other[row, 1] or one[row, 2] != other[row, 2]
    return differ


@compiled
def smallest_gap(rest_distance: float, distance: float, of_obstacle: bool) -> float:
    """Gap [m] that a pair keeps, as in `smallest_gaps`.

    Args:
        rest_distance: between its elements in the rest shape [m].
        distance: between them where they begin [m].
        of_obstacle: whether one of them is of an obstacle.
    """
    gap = min(SMALLEST_GAP, _SHARE_OF_REST * rest_distance)
    if of_obstacle:
        return min(gap, _OF_OBSTACLE_PRESENT * distance)
    return gap if distance > gap else _OF_PRESENT * distance


@compiled
def _smallest_gaps(
    before: np.ndarray, corners: np.ndarray, vertex_faces: int, rest_distances: np.ndarray, first_obstacle: int
) -> np.ndarray:
    """The gaps (pairs,) [m] of `smallest_gaps`."""
    points, weights, between = np.empty((4, 3)), np.empty(4), np.empty(3)
    gaps = np.empty(len(corners))
    for pair in range(len(corners)):
        gather(before, corners[pair], points)
        distance = nearest(points, pair < vertex_faces, weights, between)
        gaps[pair] = smallest_gap(rest_distances[pair], distance, corners[pair].max() >= first_obstacle)
    return gaps


@compiled
def _free_shares(
    vertices: np.ndarray, moves: np.ndarray, corners: np.ndarray, vertex_faces: int, gaps: np.ndarray
) -> np.ndarray:
    """Shares (pairs,) of the moves that each pair may take."""
    points, way, weights, between = np.empty((4, 3)), np.empty((4, 3)), np.empty(4), np.empty(3)
    shares = np.empty(len(corners))
    for pair in range(len(corners)):
        gather(vertices, corners[pair], points)
        gather(moves, corners[pair], way)
        shares[pair] = free_share(points, way, pair < vertex_faces, gaps[pair], weights, between)
    return shares


@compiled
def _impulses(
    before: np.ndarray,
    moves: np.ndarray,
    corners: np.ndarray,
    vertex_faces: int,
    gaps: np.ndarray,
    shares: np.ndarray,
    inverse: np.ndarray,
    world: np.ndarray,
    first_obstacle: int,
    fastest: np.ndarray,
) -> None:
    """Change `moves` of touching pairs, the first to touch first, so that each keeps half of its gap open.

    What meets an obstacle is led to twice the smallest gap from it.

    The impulse acts along the line between the nearest points where the pair was stopped, and makes no vertex faster
    than it was and the `fastest` (worlds,) [m^2] of its world, or `_PAST_OBSTACLES` times that.
    """
    points, weights, between = np.empty((4, 3)), np.empty(4), np.empty(3)
    for pair in np.argsort(shares):
        ids = corners[pair]
        for corner in range(4):
            for axis in range(3):
                points[corner, axis] = before[ids[corner], axis] + shares[pair] * moves[ids[corner], axis]
        distance = nearest(points, pair < vertex_faces, weights, between)
        if not distance > 0.0:
            continue
        # How much nearer they come by the rest of the move, and how much of that is room.
        approach, response, squared, lightest = 0.0, 0.0, 0.0, 0.0
        for corner in range(4):
            response += weights[corner] * weights[corner] * inverse[ids[corner]]
            squared += weights[corner] * weights[corner]
            lightest = max(lightest, inverse[ids[corner]])
            for axis in range(3):
                approach += weights[corner] * between[axis] * moves[ids[corner], axis] / distance
        approach *= 1.0 - shares[pair]
        room = 0.5 * (distance - gaps[pair])
        faster = 1.0
        if ids.max() >= first_obstacle:
            room, faster = min(room, distance - _OFF_OBSTACLES), _PAST_OBSTACLES**2
        excess = -approach - room
        if excess <= 0.0 or response <= 0.0:
            continue
        response = max(response, _LEAST_RESPONSE * squared * lightest)
        for corner in range(4):
            factor, move = inverse[ids[corner]] * weights[corner] * excess / (response * distance), moves[ids[corner]]
            if factor == 0.0:
                continue
            speed = move[0] ** 2 + move[1] ** 2 + move[2] ** 2
            limit = max(faster * fastest[world[ids[corner]]], speed)
            for axis in range(3):
                move[axis] += factor * between[axis]
            speed = move[0] ** 2 + move[1] ** 2 + move[2] ** 2
            if speed > limit:
                for axis in range(3):
                    move[axis] *= np.sqrt(limit / speed)


@compiled
def _root(joined: np.ndarray, vertex: int) -> int:
    while joined[vertex] != vertex:
        joined[vertex] = joined[joined[vertex]]
        vertex = joined[vertex]
    return vertex


@compiled
def _merge_touching(moves: np.ndarray, corners: np.ndarray, joined: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """Moves (vertices, 3) with vertices of touching pairs moved alike; `joined` (vertices,) is their forest.

    What is joined keeps its momentum, or goes where its vertices of infinite mass go on average.
    """
    for pair in range(len(corners)):
        first = _root(joined, corners[pair, 0])
        for corner in range(1, 4):
            other = _root(joined, corners[pair, corner])
            joined[other] = first
    held = np.zeros(len(moves), dtype=np.bool_)
    for vertex in range(len(moves)):
        if np.isinf(masses[vertex]):
            held[_root(joined, vertex)] = True
    sums, weights, counts = np.zeros_like(moves), np.zeros(len(moves)), np.zeros(len(moves), dtype=np.int64)
    for vertex in range(len(moves)):
        root = _root(joined, vertex)
        counts[root] += 1
        weight = masses[vertex]
        if held[root]:
            weight = 1.0 if np.isinf(weight) else 0.0
        weights[root] += weight
        for axis in range(3):
            sums[root, axis] += weight * moves[vertex, axis]
    result = moves.copy()
    for vertex in range(len(moves)):
        root = _root(joined, vertex)
        if counts[root] > 1:
            for axis in range(3):
                result[vertex, axis] = sums[root, axis] / weights[root]
    return result
