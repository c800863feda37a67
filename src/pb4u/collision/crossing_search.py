"""Which faces of a moving surface cross, asked for every frame.

The tree is built once and its boxes are fitted to each frame, as that of `surface_tree`. Only what is certainly apart
is left out, so that the result is that of a search among all faces.
"""

from __future__ import annotations

import numpy as np

from pb4u.collision.box_tree import Boxes, BoxTree, boxes_meet, still_boxes, with_room
from pb4u.collision.collision_free import SMALLEST_GAP
from pb4u.collision.crossings import self_crossings
from pb4u.collision.jit import compiled
from pb4u.collision.near_elements import EVERY, Query, meeting_leaves, query_of
from pb4u.collision.surface_tree import SurfaceTree

_TOUCHING = 1e-10
"""Gap [m] up to which two faces are left to the exact predicates; the rounding of a few metres is 1e-15."""


class CrossingSearch:
    """Faces of a moving surface that cross.

    Args:
        tree: of the surface.
        most: pairs of leaves of the tree whose boxes meet, beyond which nothing is found: such cloth has collapsed.
    """

    def __init__(self, tree: SurfaceTree, most: int = EVERY) -> None:
        self._tree, self._most = tree, most

    def crossed(self, vertices: np.ndarray, among: np.ndarray | None = None) -> np.ndarray:
        """Vertices (vertices,) bool, none of an obstacle, of the faces that cross one.

        Args:
            vertices: (vertices, 3) float64 [m], finite.
            among: (vertices,) bool, of which each of these faces has one; None for all.
        """
        tree, faces = self._tree, self._tree.faces
        found, own = np.zeros(len(vertices), dtype=bool), np.arange(len(vertices)) < tree.first_obstacle
        # As wide as for a move from there, which then finds its boxes fitted.
        boxes = tree.fitted(vertices, np.zeros_like(vertices), 0.5 * SMALLEST_GAP)
        asked, obstacles = (query_of(tree.boxes, faces, rows) for rows in (own if among is None else among & own, ~own))
        pairs = _touching_faces(vertices, faces, boxes, tree.boxes, False, self._most, asked, obstacles)
        found[faces[pairs]] = True
        return found & own

    def pairs(self, vertices: np.ndarray, *, sharing: bool = False) -> np.ndarray:
        """Pairs (pairs, 2) int64 of faces that cross: those of `self_crossings`; what is not finite crosses nothing.

        Args:
            vertices: (vertices, 3) [m].
            sharing: whether pairs that share a vertex, and pass through each other elsewhere, are found as well.
        """
        tree, faces = self._tree, self._tree.faces
        points, face_boxes = still_boxes(vertices, faces, 0.5 * _TOUCHING)
        boxes, asked = tree.boxes.fitted(face_boxes), query_of(tree.boxes, faces, np.ones(len(vertices), dtype=bool))
        touching = np.unique(_touching_faces(points, faces, boxes, tree.boxes, sharing, self._most, asked, asked))
        if not len(touching):
            return np.zeros((0, 2), dtype=np.int64)
        return touching[self_crossings(points, faces[touching], sharing=sharing)]


@compiled
def _touching_faces(
    vertices: np.ndarray,
    faces: np.ndarray,
    boxes: Boxes,
    tree: BoxTree,
    sharing: bool,
    most: int,
    asked: Query,
    others: Query,
) -> np.ndarray:
    """Faces (pairs, 2) of every pair that shares no vertex, or one where `sharing`, and is not certainly apart."""
    order, ranges, roots = tree.order, tree.ranges, tree.roots
    found = np.empty((256, 2), dtype=np.int64)
    count = 0
    # Taken once: an array made for every pair would cost more than its numbers.
    work, side, other_side = np.empty((9, 3)), np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    leaves = meeting_leaves(boxes, tree, asked, others, np.column_stack((roots, roots)), most)
    for pair in range(len(leaves)):
        a, b = leaves[pair]
        for i in range(ranges[a, 0], ranges[a, 1]):
            f = order[i]
            for j in range(i + 1 if a == b else ranges[b, 0], ranges[b, 1]):
                g = order[j]
                if not ((asked.faces[f] and others.faces[g]) or (asked.faces[g] and others.faces[f])):
                    continue
                if not boxes_meet(boxes.faces, f, boxes.faces, g):
                    continue
                shared = _shared(faces[f], faces[g], side, other_side)
                if shared == 0:
                    apart = _apart(vertices, faces[f], faces[g], work)
                elif shared == 1 and sharing:
                    # They meet at the vertex in any case; elsewhere, what is across from it has to reach the other.
                    apart = _apart(vertices, faces[g], side, work) and _apart(vertices, faces[f], other_side, work)
                else:
                    continue
                if not apart:
                    found = with_room(found, count)
                    found[count, 0], found[count, 1] = f, g
                    count += 1
    return found[:count]


@compiled
def _shared(one: np.ndarray, other: np.ndarray, side: np.ndarray, other_side: np.ndarray) -> int:
    """How many vertices two faces (3,) share; of one, fills the sides across from it, as faces (3,) without area."""
    count = 0
    for k in range(3):
        for m in range(3):
            if one[k] == other[m]:
                count += 1
                side[0], side[1], side[2] = one[(k + 1) % 3], one[(k + 2) % 3], one[(k + 2) % 3]
                other_side[0], other_side[1] = other[(m + 1) % 3], other[(m + 2) % 3]
                other_side[2] = other_side[1]
    return count


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
