"""Searches of a moving surface that are made for every frame: which faces may cross, and which is nearest to a point.

The tree is built once and its boxes are fitted to each frame, as that of `surface_tree`. Both searches only leave out
what is certainly not wanted, so that their results are those of a search among all faces.
"""

from __future__ import annotations

import numpy as np

from pb4u.geometry.proximity.box_tree import BoxTree, boxes_meet, boxes_of, with_room
from pb4u.geometry.proximity.crossings import self_crossings
from pb4u.geometry.proximity.element_distance import compiled
from pb4u.geometry.proximity.surface_tree import SurfaceTree

_TOUCHING = 1e-10
"""Gap [m] up to which two faces are left to the exact predicates; the rounding of a few metres is 1e-15."""


class CrossingSearch:
    """Faces of a moving surface that cross.

    Args:
        tree: of the surface.
    """

    def __init__(self, tree: SurfaceTree) -> None:
        self._tree = tree

    def pairs(self, vertices: np.ndarray) -> np.ndarray:
        """Pairs (pairs, 2) int64 of faces that cross and share no vertex: those of `self_crossings`.

        Args:
            vertices: (vertices, 3) [m], finite.
        """
        tree, points = self._tree, np.ascontiguousarray(vertices, dtype=np.float64)
        face_boxes = boxes_of(points, np.zeros_like(points), tree.faces, 0.5 * _TOUCHING)
        node_boxes, shape = tree.boxes.fitted(face_boxes), tree.boxes.arrays
        touching = np.unique(_touching_faces(points, tree.faces, node_boxes, face_boxes, shape))
        if not len(touching):
            return np.zeros((0, 2), dtype=np.int64)
        return touching[self_crossings(points, tree.faces[touching])]


class NearestFaceSearch:
    """Faces of a moving surface that are nearest to points that move with it, such as cloth on a body.

    Args:
        rest: (vertices, 3) [m] from which the tree is built.
        faces: (faces, 3) int64.
    """

    def __init__(self, rest: np.ndarray, faces: np.ndarray) -> None:
        self._faces = np.ascontiguousarray(faces, dtype=np.int64)
        none = np.zeros(len(faces), dtype=np.int64)
        centres = np.asarray(rest, dtype=np.float64)[self._faces].mean(axis=1)
        self._tree = BoxTree.over(centres, none, none[:1])
        self._last = np.zeros(0, dtype=np.int64)

    def nearest(self, vertices: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Nearest face (points,) int64 of each point; quickest where the same points were asked for a little before.

        Args:
            vertices: (vertices, 3) of the surface [m], finite.
            points: (points, 3) [m], finite.
        """
        places, asked = (np.ascontiguousarray(values, dtype=np.float64) for values in (vertices, points))
        face_boxes = boxes_of(places, np.zeros_like(places), self._faces, 0.0)
        boxes = np.ascontiguousarray(self._tree.fitted(face_boxes)[:, :6])
        guess = self._last if len(self._last) == len(asked) else np.zeros(len(asked), dtype=np.int64)
        shape = self._tree.arrays[:3]
        self._last = _nearest_faces(places, self._faces, boxes, shape, asked, guess)
        return self._last


@compiled
def _touching_faces(
    vertices: np.ndarray, faces: np.ndarray, node_boxes: np.ndarray, face_boxes: np.ndarray, tree: tuple
) -> np.ndarray:
    """Faces (2, pairs) of every pair that shares no vertex and is not certainly apart."""
    order, children, ranges, roots = tree
    found = np.empty((256, 2), dtype=np.int64)
    count = 0
    stack = np.empty((1024, 2), dtype=np.int64)
    # Taken once: an array made for every pair would cost more than its numbers.
    work = np.empty((9, 3))
    for root in roots:
        stack[0, 0], stack[0, 1] = root, root
        depth = 1
        while depth > 0:
            depth -= 1
            a, b = stack[depth, 0], stack[depth, 1]
            inner_a, inner_b = children[a, 0] >= 0, children[b, 0] >= 0
            if a == b:
                if inner_a:
                    left, right = children[a, 0], children[a, 1]
                    stack[depth, 0], stack[depth, 1] = left, left
                    stack[depth + 1, 0], stack[depth + 1, 1] = right, right
                    stack[depth + 2, 0], stack[depth + 2, 1] = left, right
                    depth += 3
                    continue
            elif not boxes_meet(node_boxes[a], node_boxes[b]):
                continue
            elif inner_a or inner_b:
                if inner_a and (not inner_b or ranges[a, 1] - ranges[a, 0] >= ranges[b, 1] - ranges[b, 0]):
                    stack[depth, 0], stack[depth, 1] = children[a, 0], b
                    stack[depth + 1, 0], stack[depth + 1, 1] = children[a, 1], b
                else:
                    stack[depth, 0], stack[depth, 1] = a, children[b, 0]
                    stack[depth + 1, 0], stack[depth + 1, 1] = a, children[b, 1]
                depth += 2
                continue
            for i in range(ranges[a, 0], ranges[a, 1]):
                f = order[i]
                for j in range(i + 1 if a == b else ranges[b, 0], ranges[b, 1]):
                    g = order[j]
                    if not boxes_meet(face_boxes[f], face_boxes[g]) or _share(faces[f], faces[g]):
                        continue
                    if not _apart(vertices, faces[f], faces[g], work):
                        found = with_room(found, count)
                        found[count, 0], found[count, 1] = f, g
                        count += 1
    return found[:count]


@compiled
def _share(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two faces (3,) share a vertex."""
    for k in range(3):
        for m in range(3):
            if one[k] == other[m]:
                return True
    return False


@compiled
def _apart(vertices: np.ndarray, one: np.ndarray, other: np.ndarray, work: np.ndarray) -> bool:
    """Whether an axis keeps two faces (3,) more than `_TOUCHING` apart; `work` (9, 3) is written over.

    Triangles that do not meet are apart along one of these: a normal of either, a normal of a side in its own plane, or
    what is perpendicular to a side of each. Those in the planes come first: neighbours in smooth cloth are apart there.
    """
    sides, other_sides, normal, other_normal, along = work[0:3], work[3:6], work[6], work[7], work[8]
    for k in range(3):
        for axis in range(3):
            sides[k, axis] = vertices[one[(k + 1) % 3], axis] - vertices[one[k], axis]
            other_sides[k, axis] = vertices[other[(k + 1) % 3], axis] - vertices[other[k], axis]
    _cross(sides[0], sides[1], normal)
    _cross(other_sides[0], other_sides[1], other_normal)
    for k in range(3):
        _cross(normal, sides[k], along)
        if _gap(vertices, one, other, along):
            return True
        _cross(other_normal, other_sides[k], along)
        if _gap(vertices, one, other, along):
            return True
    if _gap(vertices, one, other, normal) or _gap(vertices, one, other, other_normal):
        return True
    for k in range(3):
        for m in range(3):
            _cross(sides[k], other_sides[m], along)
            if _gap(vertices, one, other, along):
                return True
    return False


@compiled
def _gap(vertices: np.ndarray, one: np.ndarray, other: np.ndarray, along: np.ndarray) -> bool:
    """Whether two faces (3,) are more than `_TOUCHING` apart along a direction (3,) of any length but 0."""
    low, high, other_low, other_high = np.inf, -np.inf, np.inf, -np.inf
    for k in range(3):
        at, other_at = 0.0, 0.0
        for axis in range(3):
            # From a corner of the first, so that places far from the origin lose nothing.
            at += (vertices[one[k], axis] - vertices[one[0], axis]) * along[axis]
            other_at += (vertices[other[k], axis] - vertices[one[0], axis]) * along[axis]
        low, high = min(low, at), max(high, at)
        other_low, other_high = min(other_low, other_at), max(other_high, other_at)
    length = np.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2)
    return max(other_low - high, low - other_high) > _TOUCHING * length > 0.0


@compiled
def _cross(u: np.ndarray, v: np.ndarray, result: np.ndarray) -> None:
    """Fill `result` (3,) with the cross product of two vectors (3,)."""
    result[0] = u[1] * v[2] - u[2] * v[1]
    result[1] = u[2] * v[0] - u[0] * v[2]
    result[2] = u[0] * v[1] - u[1] * v[0]


@compiled
def _nearest_faces(
    vertices: np.ndarray, faces: np.ndarray, boxes: np.ndarray, tree: tuple, points: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """Nearest face (points,) of each point; `guess` (points,) bounds the search, `boxes` (nodes, 6) are its nodes'."""
    order, children, ranges = tree
    result = np.empty(len(points), dtype=np.int64)
    stack = np.empty(1024, dtype=np.int64)
    distances = np.empty(1024)
    for row in range(len(points)):
        point = points[row]
        best = guess[row]
        least = _squared_distance(point, vertices, faces[best])
        stack[0], distances[0] = 0, 0.0
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if distances[depth] >= least:
                continue
            if children[node, 0] < 0:
                for place in range(ranges[node, 0], ranges[node, 1]):
                    face = order[place]
                    distance = _squared_distance(point, vertices, faces[face])
                    if distance < least:
                        best, least = face, distance
                continue
            near, far = children[node, 0], children[node, 1]
            near_distance, far_distance = _box_distance(point, boxes[near]), _box_distance(point, boxes[far])
            if near_distance > far_distance:
                near, far, near_distance, far_distance = far, near, far_distance, near_distance
            # The nearer one is looked at first.
            if far_distance < least:
                stack[depth], distances[depth] = far, far_distance
                depth += 1
            if near_distance < least:
                stack[depth], distances[depth] = near, near_distance
                depth += 1
        result[row] = best
    return result


@compiled
def _box_distance(point: np.ndarray, box: np.ndarray) -> float:
    """Squared distance [m^2] of a point (3,) to a box (6,)."""
    total = 0.0
    for axis in range(3):
        beyond = max(box[axis] - point[axis], point[axis] - box[3 + axis], 0.0)
        total += beyond * beyond
    return total


@compiled
def _squared_distance(point: np.ndarray, vertices: np.ndarray, face: np.ndarray) -> float:
    """Squared distance [m^2] of a point (3,) to a face (3,): Ericson, Real-Time Collision Detection, 5.1.5."""
    d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        a, b, c = vertices[face[0], axis], vertices[face[1], axis], vertices[face[2], axis]
        ab, ac = b - a, c - a
        d1 += ab * (point[axis] - a)
        d2 += ac * (point[axis] - a)
        d3 += ab * (point[axis] - b)
        d4 += ac * (point[axis] - b)
        d5 += ab * (point[axis] - c)
        d6 += ac * (point[axis] - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v, w = 0.0, 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    elif va + vb + vc > 0.0:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    total = 0.0
    for axis in range(3):
        a = vertices[face[0], axis]
        offset = point[axis] - a - v * (vertices[face[1], axis] - a) - w * (vertices[face[2], axis] - a)
        total += offset * offset
    return total
