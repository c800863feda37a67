"""Nearest points of a posed surface, each with the direction in which the distance grows; compiled by Numba.

The tree of boxes is built once for a surface and fitted to each of its poses. The nearest face of one point bounds the
search for the next: vertices of cloth come in an order in which neighbours mostly follow each other.
"""

from __future__ import annotations

import numpy as np

from pb4u.geometry.proximity.element_distance import compiled, vertex_face_weights

_ON_BORDER = 1e-12
"""Barycentric coordinate up to which the nearest point of a face lies on its edge."""

_AT = 1e-9
"""Distance [m] up to which a point lies on the surface, where the way to it has no direction."""

_DEEPEST = 512
"""Entries of the stack of a search: a median split halves, so that 2^60 faces would not fill it."""


@compiled
def fitted(
    vertices: np.ndarray, faces: np.ndarray, order: np.ndarray, children: np.ndarray, ranges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (faces, 9) [m] of the faces in the order of a tree; lowest and highest corner (nodes, 6) of its nodes."""
    corners, boxes = np.empty((len(order), 9)), np.empty((len(children), 6))
    for place in range(len(order)):
        for corner in range(3):
            for axis in range(3):
                corners[place, 3 * corner + axis] = vertices[faces[order[place], corner], axis]
    for node in range(len(children) - 1, -1, -1):
        left, right = children[node, 0], children[node, 1]
        for axis in range(3):
            if left >= 0:
                boxes[node, axis] = min(boxes[left, axis], boxes[right, axis])
                boxes[node, 3 + axis] = max(boxes[left, 3 + axis], boxes[right, 3 + axis])
                continue
            low, high = np.inf, -np.inf
            for place in range(ranges[node, 0], ranges[node, 1]):
                for corner in range(axis, 9, 3):
                    low, high = min(low, corners[place, corner]), max(high, corners[place, corner])
            boxes[node, axis], boxes[node, 3 + axis] = low, high
    return corners, boxes


@compiled
def nearest_points(
    vertices: np.ndarray, faces: np.ndarray, fans: tuple, fitted: tuple, tree: tuple, points: np.ndarray
) -> tuple:
    """Face (points,), barycentric coordinates and position (points, 3) of the nearest point to each of the `points`.

    Then the unit normal (points, 3), the signed distance (points,) and whether the point is on the border (points,).

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3).
        fans: begin of each vertex' faces (vertices + 1,), these faces, and which vertices are on the border.
        fitted: corners and boxes of the tree at these vertices.
        tree: order, children and ranges of its nodes.
        points: (points, 3) [m].
    """
    (order, children, ranges), (corners, boxes) = tree, fitted
    count = len(points)
    face_of, barycentric, positions = np.empty(count, dtype=np.int64), np.empty((count, 3)), np.empty((count, 3))
    normals, distances = np.empty((count, 3)), np.empty(count)
    beyond = np.zeros(count, dtype=np.bool_)
    stack, waiting = np.empty(_DEEPEST, dtype=np.int64), np.empty(_DEEPEST)
    weights, one = np.empty(4), np.empty(3)
    place = 0
    for row in range(count):
        point = points[row]
        place = _nearest_face(corners, boxes, children, ranges, point, place, stack, waiting)
        best = face_of[row] = order[place]
        a, b, c = faces[best]
        vertex_face_weights(point, vertices[a], vertices[b], vertices[c], weights)
        zeros = 0
        for corner in range(3):
            barycentric[row, corner] = -weights[1 + corner]
            zeros += barycentric[row, corner] <= _ON_BORDER
        for axis in range(3):
            positions[row, axis] = (
                barycentric[row, 0] * vertices[a, axis]
                + barycentric[row, 1] * vertices[b, axis]
                + barycentric[row, 2] * vertices[c, axis]
            )
        normal = normals[row]
        if zeros == 0:
            _unit_normal(vertices, faces[best], normal)
        else:
            beyond[row] = _feature_normal(vertices, faces, fans, best, barycentric[row], normal, one)
        length, along = 0.0, 0.0
        for axis in range(3):
            offset = point[axis] - positions[row, axis]
            length += offset * offset
            along += offset * normal[axis]
        length = np.sqrt(length)
        sign = -1.0 if along < 0.0 and not beyond[row] else 1.0
        distances[row] = sign * length
        if zeros > 0 and length > _AT:
            for axis in range(3):
                normal[axis] = (point[axis] - positions[row, axis]) * sign / length
    return face_of, barycentric, positions, normals, distances, beyond


@compiled
def _nearest_face(
    corners: np.ndarray,
    boxes: np.ndarray,
    children: np.ndarray,
    ranges: np.ndarray,
    point: np.ndarray,
    guess: int,
    stack: np.ndarray,
    waiting: np.ndarray,
) -> int:
    """Place in the order of the face nearest to a point (3,); a `guess` nearby makes it quicker.

    `stack` and `waiting` are room.
    """
    x, y, z = point[0], point[1], point[2]
    best, least = guess, _squared_distance(x, y, z, corners, guess)
    stack[0], waiting[0] = 0, 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        if waiting[depth] >= least:
            continue
        node = stack[depth]
        near, far = children[node, 0], children[node, 1]
        if near < 0:
            for place in range(ranges[node, 0], ranges[node, 1]):
                distance = _squared_distance(x, y, z, corners, place)
                if distance < least:
                    best, least = place, distance
            continue
        near_distance, far_distance = _box_distance(x, y, z, boxes, near), _box_distance(x, y, z, boxes, far)
        if near_distance > far_distance:
            near, far, near_distance, far_distance = far, near, far_distance, near_distance
        # The nearer one is looked at first.
        if far_distance < least:
            stack[depth], waiting[depth] = far, far_distance
            depth += 1
        if near_distance < least:
            stack[depth], waiting[depth] = near, near_distance
            depth += 1
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
def _box_distance(x: float, y: float, z: float, boxes: np.ndarray, node: int) -> float:
    """Squared distance [m^2] of a point to the box of a node."""
    dx = max(boxes[node, 0] - x, x - boxes[node, 3], 0.0)
    dy = max(boxes[node, 1] - y, y - boxes[node, 4], 0.0)
    dz = max(boxes[node, 2] - z, z - boxes[node, 5], 0.0)
    return dx * dx + dy * dy + dz * dz


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
