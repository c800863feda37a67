"""Nearest points of a posed surface, each with the direction in which the distance grows; compiled by Numba.

What was found for a point at this pose before serves again: exactly where the point is where it was, as a bound on the
search where it moved, and as proof that it is far from the surface where it was farther than it moved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pb4u.collision.element_distance import vertex_face_weights
from pb4u.collision.jit import compiled

_ON_BORDER = 1e-12
"""Barycentric coordinate up to which the nearest point of a face lies on its edge."""

_AT = 1e-9
"""Distance [m] up to which a point lies on the surface, where the way to it has no direction."""

_DEEPEST = 512
"""Entries of the stack of a search: at most seven a level are left waiting, so that 8^70 faces would not fill it."""

_ROUNDING = 1.0 + 1e-9
"""Factor on a squared bound, within which the face that it was measured to is found again."""


class Found(NamedTuple):
    """What was found for some points; arrays that a search writes into.

    Args:
        at: (points, 3) [m] where each point was when it was queried; not a number for one that never was.
        triangle: (points,) int64 face.
        barycentric: (points, 3) coordinates of the nearest point in that face.
        positions: (points, 3) nearest points [m]; of a point that never was queried any point of the surface that is
            near, which bounds the search, or not a number.
        normals: (points, 3) unit direction in which the signed distance grows.
        distances: (points,) signed [m], at `at`.
        beyond: (points,) bool, nearest to the border of the surface.
    """

    at: np.ndarray
    triangle: np.ndarray
    barycentric: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    distances: np.ndarray
    beyond: np.ndarray

    @staticmethod
    def nothing(count: int, near: np.ndarray | None = None) -> Found:
        """Of `count` points that were never queried; `near` (points, 3) [m] are points of the surface, if known.

        Args:
            count: number of points.
            near: (points, 3) [m] points of the surface, or None.
        """
        return Found(
            at=np.full((count, 3), np.nan),
            triangle=np.zeros(count, dtype=np.int64),
            barycentric=np.zeros((count, 3)),
            positions=np.full((count, 3), np.nan) if near is None else np.ascontiguousarray(near),
            normals=np.zeros((count, 3)),
            distances=np.full(count, np.inf),
            beyond=np.ones(count, dtype=np.bool_),
        )

    def rows(self, first: int, stop: int) -> Found:
        """What was found for the points from `first` to before `stop`; the same memory.

        Args:
            first: first point.
            stop: point after the last.
        """
        return Found(*(values[first:stop] for values in self))

    def copy(self) -> Found:
        """The same in memory of its own."""
        return Found(*(values.copy() for values in self))


class Searched(NamedTuple):
    """A posed surface as a search sees it.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        fans: begin of each vertex' faces (vertices + 1,), these faces, and which vertices are on the border.
        order: (faces,) int64 of the tree.
        children: (nodes,) int64 of the tree.
        bottoms: number of its nodes whose children are faces.
        corners: (faces, 9) [m] in the order of the tree.
        boxes: (nodes, 6, 8) [m].
    """

    vertices: np.ndarray
    faces: np.ndarray
    fans: tuple
    order: np.ndarray
    children: np.ndarray
    bottoms: int
    corners: np.ndarray
    boxes: np.ndarray


@compiled
def update_closest(
    surface: Searched,
    names: np.ndarray,
    points: np.ndarray,
    within: float,
    patience: float,
    only_nearer: bool,
    found: Found,
) -> int:
    """Bring `found` up to date for `points` (points, 3) [m], and return how many had to be searched for.

    A point keeps its result if it moved by at most `patience` [m] since it was found, or if it is still at least
    `within` [m] from the surface, since a distance changes by no more than the way. With `only_nearer`, a point keeps
    its result if no face is nearer than its stored position. `names` (faces,) are what faces are called.

    Args:
        surface: arrays of the surface and of its tree.
        names: (faces,) int64 number under which each face is noted.
        points: (points, 3) [m].
        within: distance beyond which a point need not be exact [m].
        patience: way that a point may move without a new search [m].
        only_nearer: keep a point's result unless a face is nearer than its stored position.
        found: results, changed.
    """
    vertices, faces, fans, order, children, bottoms, corners, boxes = surface
    at, triangle, barycentric, positions, normals, distances, beyond = found
    stack, waiting, lanes = np.empty(_DEEPEST, dtype=np.int64), np.empty(_DEEPEST), np.empty(8)
    weights, one = np.empty(4), np.empty(3)
    place, searched = 0, 0
    for row in range(len(points)):
        moved, bound = 0.0, 0.0
        for axis in range(3):
            moved += (points[row, axis] - at[row, axis]) ** 2
            bound += (points[row, axis] - positions[row, axis]) ** 2
        moved = np.sqrt(moved)
        # Of a point that was never queried neither is true.
        if moved <= patience or distances[row] - moved >= within:
            continue
        searched += 1
        near = -1
        if bound < np.inf:
            near = _nearest_face(children, bottoms, corners, boxes, points, row, bound, place, stack, waiting, lanes)
        if near < 0 and only_nearer:
            continue
        if near < 0:
            near = _nearest_face(children, bottoms, corners, boxes, points, row, np.inf, place, stack, waiting, lanes)
        place, best = near, order[near]
        a, b, c = faces[best]
        vertex_face_weights(points[row], vertices[a], vertices[b], vertices[c], weights)
        zeros = 0
        for corner in range(3):
            barycentric[row, corner] = -weights[1 + corner]
            zeros += barycentric[row, corner] <= _ON_BORDER
        for axis in range(3):
            at[row, axis] = points[row, axis]
            positions[row, axis] = (
                barycentric[row, 0] * vertices[a, axis]
                + barycentric[row, 1] * vertices[b, axis]
                + barycentric[row, 2] * vertices[c, axis]
            )
        normal, outside = normals[row], False
        if zeros == 0:
            _unit_normal(vertices, faces[best], normal)
        else:
            outside = _feature_normal(vertices, faces, fans, best, barycentric[row], normal, one)
        length, along = 0.0, 0.0
        for axis in range(3):
            offset = points[row, axis] - positions[row, axis]
            length += offset * offset
            along += offset * normal[axis]
        length = np.sqrt(length)
        sign = -1.0 if along < 0.0 and not outside else 1.0
        triangle[row], distances[row], beyond[row] = names[best], sign * length, outside
        if zeros > 0 and length > _AT:
            for axis in range(3):
                normal[axis] = (points[row, axis] - positions[row, axis]) * sign / length
    return searched


@compiled
def _nearest_face(
    children: np.ndarray,
    bottoms: int,
    corners: np.ndarray,
    boxes: np.ndarray,
    points: np.ndarray,
    row: int,
    bound: float,
    guess: int,
    stack: np.ndarray,
    waiting: np.ndarray,
    lanes: np.ndarray,
) -> int:
    """Place in the order of the face nearest to a row of the points; -1 where none lies within a squared `bound` [m^2].

    Where there is no bound, a `guess` nearby makes it quicker. `stack`, `waiting` and `lanes` (8,) are room.
    """
    x, y, z = points[row, 0], points[row, 1], points[row, 2]
    best, least = -1, bound * _ROUNDING + _AT * _AT
    if not bound < np.inf:
        best, least = guess, _squared_distance(x, y, z, corners, guess)
    stack[0], waiting[0] = len(children) - 1, 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        if waiting[depth] >= least:
            continue
        node = stack[depth]
        box, first = boxes[node], children[node]
        # The number of lanes is left open to the compiler, which else unrolls them one by one.
        for lane in range(len(lanes)):
            dx = max(max(box[0, lane] - x, x - box[3, lane]), 0.0)
            dy = max(max(box[1, lane] - y, y - box[4, lane]), 0.0)
            dz = max(max(box[2, lane] - z, z - box[5, lane]), 0.0)
            lanes[lane] = dx * dx + dy * dy + dz * dz
        if node < bottoms:
            for lane in range(len(lanes)):
                if lanes[lane] < least:
                    distance = _squared_distance(x, y, z, corners, first + lane)
                    if distance < least:
                        best, least = first + lane, distance
            continue
        nearest = depth
        for lane in range(len(lanes)):
            if lanes[lane] < least:
                stack[depth], waiting[depth] = first + lane, lanes[lane]
                if lanes[lane] < waiting[nearest]:
                    nearest = depth
                depth += 1
        if nearest < depth:
            # The nearest one is looked at first.
            last = depth - 1
            stack[nearest], stack[last] = stack[last], stack[nearest]
            waiting[nearest], waiting[last] = waiting[last], waiting[nearest]
    return best


@compiled
def _unit_normal(vertices: np.ndarray, face: np.ndarray, normal: np.ndarray) -> None:
    """Fill `normal` (3,) with the unit normal of a face (3,), 0 for one without area."""
    a, b, c = vertices[face[0]], vertices[face[1]], vertices[face[2]]
    normal[0] = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    normal[1] = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    normal[2] = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    _normalise(normal)


@compiled
def _normalise(vector: np.ndarray) -> None:
    """Give `vector` (3,) the length 1, unless it is 0."""
    length = max(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2), 1e-300)
    for axis in range(3):
        vector[axis] /= length


@compiled
def _feature_normal(
    vertices: np.ndarray,
    faces: np.ndarray,
    fans: tuple,
    face: int,
    barycentric: np.ndarray,
    normal: np.ndarray,
    one: np.ndarray,
) -> bool:
    """Fill `normal` (3,) with the pseudo-normal of the edge or vertex of a face that a point (3,) of it lies on.

    Of an edge the sum over its faces, of a vertex the sum weighted by their angles (Baerentzen and Aanaes 2005);
    `one` (3,) is room. Returns whether the edge or vertex is on the border.
    """
    begins, around, on_border = fans
    first, second = -1, -1
    for corner in range(3):
        if barycentric[corner] > _ON_BORDER:
            if first < 0:
                first = faces[face, corner]
            else:
                second = faces[face, corner]
    met = 0
    normal[0] = normal[1] = normal[2] = 0.0
    for place in range(begins[first], begins[first + 1]):
        corners = faces[around[place]]
        share = 1.0
        if second >= 0:
            if corners[0] != second and corners[1] != second and corners[2] != second:
                continue
            met += 1
        else:
            own = 0 if corners[0] == first else (1 if corners[1] == first else 2)
            share = _angle(vertices[first], vertices[corners[(own + 1) % 3]], vertices[corners[(own + 2) % 3]])
        _unit_normal(vertices, corners, one)
        for axis in range(3):
            normal[axis] += share * one[axis]
    _normalise(normal)
    return met == 1 if second >= 0 else on_border[first]


@compiled
def _angle(at: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """Angle [rad] at a point (3,) between the ways to two others (3,)."""
    ux, uy, uz = one[0] - at[0], one[1] - at[1], one[2] - at[2]
    vx, vy, vz = other[0] - at[0], other[1] - at[1], other[2] - at[2]
    across = (uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2
    return np.arctan2(np.sqrt(across), ux * vx + uy * vy + uz * vz)


@compiled
def _squared_distance(x: float, y: float, z: float, corners: np.ndarray, face: int) -> float:
    """Squared distance [m^2] of a point to a face, a row of `corners` (faces, 9).

    Source: Ericson, Real-Time Collision Detection, 5.1.5.
    """
    px, py, pz = x - corners[face, 0], y - corners[face, 1], z - corners[face, 2]
    ux, uy, uz = (
        corners[face, 3] - corners[face, 0],
        corners[face, 4] - corners[face, 1],
        corners[face, 5] - corners[face, 2],
    )
    vx, vy, vz = (
        corners[face, 6] - corners[face, 0],
        corners[face, 7] - corners[face, 1],
        corners[face, 8] - corners[face, 2],
    )
    d1, d2 = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v, w = 0.0, 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3) if d1 - d3 > 0.0 else 0.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6) if d2 - d6 > 0.0 else 0.0
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        span = (d4 - d3) + (d5 - d6)
        w = (d4 - d3) / span if span > 0.0 else 0.0
        v = 1.0 - w
    elif va + vb + vc > 0.0:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    rx, ry, rz = px - v * ux - w * vx, py - v * uy - w * vy, pz - v * uz - w * vz
    return rx * rx + ry * ry + rz * rz
