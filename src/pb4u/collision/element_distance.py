"""Distances between a vertex and a triangle and between two edges, and how far both may move before they touch.

Compiled by Numba. A pair is four corners and four weights: the vector between the two nearest points is the sum of the
weighted corners, so that the distance changes by `weight * normal` per unit that a corner moves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pb4u.collision.jit import compiled

_KEPT = 0.1
"""Share of the gap that is left where a move is cut: that much of the way to the other element is not taken."""

_ENDS = 0.4
"""Share of what a cut leaves that is enough at the end of a move: an impulse leaves half."""

_MOST_ADVANCES = 200
"""Advances after which a time of impact is taken as found: of a pair that grazes past, each is short."""


class Reaches(NamedTuple):
    """How near two elements have to come to count as near.

    Args:
        cloth: distance [m] of pairs of cloth.
        obstacle: distance [m] of pairs with an obstacle, at most that of cloth.
        first_obstacle: number of the first vertex of obstacles, which are the last ones.
    """

    cloth: float
    obstacle: float
    first_obstacle: int


@compiled
def gather(values: np.ndarray, corners: np.ndarray, rows: np.ndarray) -> None:
    """Fill `rows` (4, 3) with those of `values` (vertices, 3) at `corners` (4,).

    Args:
        values: (vertices, 3).
        corners: (4,) int64.
        rows: (4, 3), filled.
    """
    # Row by row, the kernels would compile for three times as long: Numba also compiles the checks of their shapes.
    for corner in range(4):
        for axis in range(3):
            rows[corner, axis] = values[corners[corner], axis]


@compiled
def vertex_face_weights(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, weights: np.ndarray) -> None:
    """Fill `weights` (4,) of the vector from the nearest point of triangle a b c to the point p.

    Args:
        p: (3,) [m] the point.
        a: (3,) [m] first corner.
        b: (3,) [m] second corner.
        c: (3,) [m] third corner.
        weights: (4,) dimensionless, filled.

    Source: Ericson, Real-Time Collision Detection, 5.1.5.
    """
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    weights[0] = 1.0
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        weights[1], weights[2], weights[3] = -1.0, 0.0, 0.0
        return
    bpx, bpy, bpz = p[0] - b[0], p[1] - b[1], p[2] - b[2]
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    if d3 >= 0.0 and d4 <= d3:
        weights[1], weights[2], weights[3] = 0.0, -1.0, 0.0
        return
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3) if d1 - d3 > 0.0 else 0.0
        weights[1], weights[2], weights[3] = v - 1.0, -v, 0.0
        return
    cpx, cpy, cpz = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    if d6 >= 0.0 and d5 <= d6:
        weights[1], weights[2], weights[3] = 0.0, 0.0, -1.0
        return
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6) if d2 - d6 > 0.0 else 0.0
        weights[1], weights[2], weights[3] = w - 1.0, 0.0, -w
        return
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        span = (d4 - d3) + (d5 - d6)
        w = (d4 - d3) / span if span > 0.0 else 0.0
        weights[1], weights[2], weights[3] = 0.0, w - 1.0, -w
        return
    total = va + vb + vc
    if not total > 0.0:
        weights[1], weights[2], weights[3] = -1.0, 0.0, 0.0
        return
    v, w = vb / total, vc / total
    weights[1], weights[2], weights[3] = v + w - 1.0, -v, -w


@compiled
def edge_edge_weights(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, weights: np.ndarray) -> None:
    """Fill `weights` (4,) of the vector from the nearest point of the edge c d to that of the edge a b.

    Args:
        a: (3,) [m] start of one edge.
        b: (3,) [m] its end.
        c: (3,) [m] start of the other edge.
        d: (3,) [m] its end.
        weights: (4,) dimensionless, filled.

    Source: Ericson, Real-Time Collision Detection, 5.1.9.
    """
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = d[0] - c[0], d[1] - c[1], d[2] - c[2]
    rx, ry, rz = a[0] - c[0], a[1] - c[1], a[2] - c[2]
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    ur = ux * rx + uy * ry + uz * rz
    vr = vx * rx + vy * ry + vz * rz
    s, t = 0.0, 0.0
    if uu > 0.0 and vv > 0.0:
        across = uu * vv - uv * uv
        if across > 1e-14 * uu * vv:
            s = min(1.0, max(0.0, (uv * vr - ur * vv) / across))
        t = (uv * s + vr) / vv
        if t < 0.0:
            t = 0.0
            s = min(1.0, max(0.0, -ur / uu))
        elif t > 1.0:
            t = 1.0
            s = min(1.0, max(0.0, (uv - ur) / uu))
    elif uu > 0.0:
        s = min(1.0, max(0.0, -ur / uu))
    elif vv > 0.0:
        t = min(1.0, max(0.0, vr / vv))
    weights[0], weights[1], weights[2], weights[3] = 1.0 - s, s, t - 1.0, -t


@compiled
def nearest(points: np.ndarray, vertex_face: bool, weights: np.ndarray, between: np.ndarray) -> float:
    """Distance [m] of a pair; fills its `weights` (4,) and the vector `between` (3,) [m] its nearest points.

    `points` (4, 3) [m] are its corners: those of a vertex and a face where `vertex_face`, else of two edges.

    Args:
        points: (4, 3) [m] corners of the pair.
        vertex_face: whether it is a vertex and a face, else two edges.
        weights: (4,) dimensionless, filled.
        between: (3,) [m], filled.
    """
    if vertex_face:
        vertex_face_weights(points[0], points[1], points[2], points[3], weights)
    else:
        edge_edge_weights(points[0], points[1], points[2], points[3], weights)
    total = 0.0
    for axis in range(3):
        between[axis] = (
            weights[0] * points[0, axis]
            + weights[1] * points[1, axis]
            + weights[2] * points[2, axis]
            + weights[3] * points[3, axis]
        )
        total += between[axis] * between[axis]
    return np.sqrt(total)


@compiled
def crossing_share(points: np.ndarray, parallel: float, slopes: np.ndarray) -> float:
    """How much two edges lie across each other, from 0 where they are parallel to 1; fills its `slopes` (4, 3) [1/m].

    The points in which parallel edges are nearest jump when the edges turn, and the direction of a force with them. A
    force that fades out there has no jump; of edges that lie along each other, an end is near a face as well.

    Args:
        points: (4, 3) [m] ends of both edges.
        parallel: squared cross product of the edges [m^4] from which on the share is 1; 0 for a vertex and a face.
        slopes: receives the gradient of the share.

    Source: the mollifier of Incremental Potential Contact (Li et al. 2020, eq. 24).
    """
    for corner in range(4):
        slopes[corner] = 0.0
    if not parallel > 0.0:
        return 1.0
    uu, vv, uv = 0.0, 0.0, 0.0
    for axis in range(3):
        u, v = points[1, axis] - points[0, axis], points[3, axis] - points[2, axis]
        uu, vv, uv = uu + u * u, vv + v * v, uv + u * v
    ratio = max(uu * vv - uv * uv, 0.0) / parallel
    if ratio >= 1.0:
        return 1.0
    slope = 2.0 * (1.0 - ratio) / parallel
    for axis in range(3):
        u, v = points[1, axis] - points[0, axis], points[3, axis] - points[2, axis]
        slopes[1, axis] = 2.0 * slope * (vv * u - uv * v)
        slopes[3, axis] = 2.0 * slope * (uu * v - uv * u)
        slopes[0, axis], slopes[2, axis] = -slopes[1, axis], -slopes[3, axis]
    return ratio * (2.0 - ratio)


@compiled
def crossing_shares(vertices: np.ndarray, corners: np.ndarray, parallels: np.ndarray) -> np.ndarray:
    """Shares (pairs,) of `crossing_share` of pairs with `corners` (pairs, 4) among `vertices` (vertices, 3) [m].

    Args:
        vertices: (vertices, 3) [m].
        corners: (pairs, 4) int64 vertices of the pairs.
        parallels: (pairs,) [m^4], see `crossing_share`.
    """
    points, slopes, shares = np.empty((4, 3)), np.empty((4, 3)), np.empty(len(corners))
    for pair in range(len(corners)):
        gather(vertices, corners[pair], points)
        shares[pair] = crossing_share(points, parallels[pair], slopes)
    return shares


@compiled
def fastest_approach(moves: np.ndarray, vertex_face: bool) -> float:
    """Bound [m] of how much nearer a pair comes by `moves` (4, 3) [m]; what both do together is taken from these.

    Args:
        moves: (4, 3) [m] displacements of the corners.
        vertex_face: whether the pair is a vertex and a face, else two edges.
    """
    for axis in range(3):
        mean = 0.25 * (moves[0, axis] + moves[1, axis] + moves[2, axis] + moves[3, axis])
        for corner in range(4):
            moves[corner, axis] -= mean
    first = moves[0, 0] ** 2 + moves[0, 1] ** 2 + moves[0, 2] ** 2
    second = moves[1, 0] ** 2 + moves[1, 1] ** 2 + moves[1, 2] ** 2
    third = moves[2, 0] ** 2 + moves[2, 1] ** 2 + moves[2, 2] ** 2
    fourth = moves[3, 0] ** 2 + moves[3, 1] ** 2 + moves[3, 2] ** 2
    if vertex_face:
        return np.sqrt(first) + np.sqrt(max(second, max(third, fourth)))
    return np.sqrt(max(first, second)) + np.sqrt(max(third, fourth))


@compiled
def free_share(
    points: np.ndarray, moves: np.ndarray, vertex_face: bool, gap: float, weights: np.ndarray, between: np.ndarray
) -> float:
    """Share in [0, 1] of linear `moves` (4, 3) [m] that a pair may take and stay further apart than `gap` [m].

    Below 1, a tenth of what was between them is left; 0 where they are that near already. `points` (4, 3) [m] are
    changed; `weights` (4,) and `between` (3,) are filled.

    Args:
        points: (4, 3) [m] corners of the pair, changed.
        moves: (4, 3) [m] displacements of the corners.
        vertex_face: whether the pair is a vertex and a face, else two edges.
        gap: distance that has to stay [m].
        weights: (4,) dimensionless, filled.
        between: (3,) [m], filled.

    Source: additive continuous collision detection, Li et al., Codimensional Incremental Potential Contact, 2021.
    """
    fastest = fastest_approach(moves, vertex_face)
    left = nearest(points, vertex_face, weights, between) - gap
    if left >= fastest:
        return 1.0
    if left <= 0.0:
        return 0.0
    enough = _KEPT * left
    share, advance, stopped = 0.0, (1.0 - _KEPT) * left / fastest, -1.0
    for _ in range(_MOST_ADVANCES):
        if share + advance >= 1.0:
            return 1.0
        for corner in range(4):
            for axis in range(3):
                points[corner, axis] += advance * moves[corner, axis]
        left = nearest(points, vertex_face, weights, between) - gap
        if stopped < 0.0 and left < enough:
            stopped = share
        # A move may end nearer than it is cut: where an impulse leaves it.
        if left < _ENDS * enough:
            break
        share += advance
        advance = (1.0 - _KEPT) * left / fastest
        if advance < 1e-6:
            break
    return stopped if stopped >= 0.0 else share


@compiled
def reach_of(corners: np.ndarray, pair: int, reaches: Reaches) -> float:
    """Reach [m] of a pair of some `corners` (pairs, 4).

    Args:
        corners: (pairs, 4) int64 vertices of the pairs.
        pair: its row.
        reaches: of both kinds.
    """
    mixed = max(corners[pair, 0], corners[pair, 3]) >= reaches.first_obstacle
    return reaches.obstacle if mixed else reaches.cloth


@compiled
def may_meet(
    vertices: np.ndarray,
    moves: np.ndarray,
    corners: np.ndarray,
    vertex_face: bool,
    reaches: Reaches,
) -> np.ndarray:
    """Whether each pair (pairs,) is no further apart than its reach and what it may approach by the moves.

    Args:
        vertices: (vertices, 3) [m].
        moves: (vertices, 3) [m] displacements.
        corners: (pairs, 4) int64 vertices of the pairs.
        vertex_face: whether the pairs are of a vertex and a face, else of two edges.
        reaches: as `reach_of` takes them.
    """
    points, way, weights, between = np.empty((4, 3)), np.empty((4, 3)), np.empty(4), np.empty(3)
    near = np.empty(len(corners), dtype=np.bool_)
    for pair in range(len(corners)):
        gather(vertices, corners[pair], points)
        gather(moves, corners[pair], way)
        reach = reach_of(corners, pair, reaches)
        near[pair] = nearest(points, vertex_face, weights, between) <= reach + fastest_approach(way, vertex_face)
    return near
