"""A tree of boxes over the faces of a moving surface: built once, fitted to the positions of every search."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pb4u.collision.jit import compiled

_LEAF = 2
"""Most faces of a leaf: smaller leaves cost more boxes, larger ones more comparisons of faces."""

_NOWHERE = np.repeat([1e30, -1e30, 1e30, -1e30], 3)
"""A box that meets none, and leaves the box of a node that holds it as it is."""


class Boxes(NamedTuple):
    """Boxes of what a tree holds, as `boxes_of` gives them.

    Args:
        nodes: (nodes, 12) [m].
        faces: (faces, 12) [m].
    """

    nodes: np.ndarray
    faces: np.ndarray


class BoxTree(NamedTuple):
    """Which faces each node of the tree holds.

    Args:
        order: (faces,) int64 the faces, those of a node in one piece.
        children: (nodes, 2) int64, after their parents; -1 in a leaf.
        ranges: (nodes, 2) int64 where the faces of a node begin and end in the order.
        roots: (worlds,) int64 a node for each world.
    """

    order: np.ndarray
    children: np.ndarray
    ranges: np.ndarray
    roots: np.ndarray

    @staticmethod
    def over(centres: np.ndarray, face_part: np.ndarray, world: np.ndarray) -> BoxTree:
        """Tree over faces: those of a part lie together, and near ones next to each other.

        Args:
            centres: (faces, 3) [m].
            face_part: (faces,) int64 part of each face.
            world: (parts,) int64 world of each part, with a root of its own.
        """
        face_world = np.asarray(world, dtype=np.int64)[face_part] if len(face_part) else face_part
        order = np.lexsort((face_part, face_world))
        _, begins = np.unique(face_world[order], return_index=True)
        spans = np.append(begins, len(order)).astype(np.int64)
        children, ranges, roots = _split(np.ascontiguousarray(centres, dtype=np.float64), face_part, order, spans)
        return BoxTree(order, children, ranges, roots)

    def halves(self, a: int, b: int) -> list[tuple[int, int]]:
        """Pairs of nodes below a pair of nodes, in the order in which a search of it goes through them.

        Args:
            a: a node.
            b: the same, or another of which none is above the other.
        """
        (left, right), others = self.children[a], self.children[b]
        if a == b:
            return [(left, left), (right, right), (left, right)] if left >= 0 else [(a, b)]
        (size_a, size_b), inner_b = (int(np.diff(self.ranges[node])[0]) for node in (a, b)), others[0] >= 0
        if left >= 0 and (size_a >= size_b or not inner_b):
            return [(right, b), (left, b)]
        return [(a, others[1]), (a, others[0])] if inner_b else [(a, b)]

    def fitted(self, face_boxes: np.ndarray) -> Boxes:
        """Boxes of the nodes and faces.

        Args:
            face_boxes: (faces, 12) [m] as `boxes_of` gives them.
        """
        boxes = Boxes(np.empty((len(self.children), 12)), face_boxes)
        fit_nodes(np.arange(len(self.children) - 1, -1, -1), self, boxes)
        return boxes


@compiled
def sort_along_widest(centres: np.ndarray, order: np.ndarray, first: int, stop: int) -> None:
    """Sort the rows first..stop-1 of an order along the axis on which their centres lie furthest apart.

    Args:
        centres: (faces, 3) [m].
        order: (faces,) int64, changed in place.
        first: first row.
        stop: row after the last.
    """
    rows = order[first:stop].copy()
    widest, spread = 0, -1.0
    for axis in range(3):
        low, high = np.inf, -np.inf
        for row in rows:
            low, high = min(low, centres[row, axis]), max(high, centres[row, axis])
        if high - low > spread:
            widest, spread = axis, high - low
    along = np.empty(len(rows))
    for place in range(len(rows)):
        along[place] = centres[rows[place], widest]
    sorting = np.argsort(along, kind="mergesort")
    for place in range(len(rows)):
        order[first + place] = rows[sorting[place]]


@compiled
def _split(
    centres: np.ndarray, face_part: np.ndarray, order: np.ndarray, spans: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Children (nodes, 2), ranges (nodes, 2) and roots (worlds,); puts `order` (faces,) in order of the leaves.

    Faces are halved where two parts meet, or else at the median along the axis on which their centres lie furthest
    apart. The faces of a world are those between two of the `spans` (worlds + 1,) of the order, sorted by part.
    """
    most = 2 * len(order) + 1
    children, ranges = np.full((most, 2), -1, dtype=np.int64), np.empty((most, 2), dtype=np.int64)
    roots = np.empty(len(spans) - 1, dtype=np.int64)
    waiting = np.empty(most, dtype=np.int64)
    nodes = 0
    for number in range(len(roots)):
        roots[number] = waiting[0] = nodes
        ranges[nodes, 0], ranges[nodes, 1] = spans[number], spans[number + 1]
        nodes, depth = nodes + 1, 1
        while depth > 0:
            depth -= 1
            node = waiting[depth]
            first, stop = ranges[node]
            if stop - first <= _LEAF:
                continue
            cut = (first + stop) // 2
            if face_part[order[first]] != face_part[order[stop - 1]]:
                middle = face_part[order[cut]]
                if middle == face_part[order[first]]:
                    while face_part[order[cut]] == middle:
                        cut += 1
                else:
                    while face_part[order[cut - 1]] == middle:
                        cut -= 1
            else:
                sort_along_widest(centres, order, first, stop)
            for side in range(2):
                children[node, side] = waiting[depth] = nodes
                ranges[nodes, 0], ranges[nodes, 1] = (first, cut) if side == 0 else (cut, stop)
                nodes, depth = nodes + 1, depth + 1
    return children[:nodes].copy(), ranges[:nodes].copy(), roots


@compiled
def boxes_of(
    vertices: np.ndarray, moves: np.ndarray, corners: np.ndarray, margin: float, room: float = 0.0
) -> np.ndarray:
    """Boxes (elements, 12) of elements, wider by `margin` on every side, and at the end of the move by `room` more.

    Lowest and highest position of the corners; then the same at the end of the move. What the element takes up in
    between lies within what changes linearly from one to the other, so that two need be compared at the ends alone.

    Args:
        vertices: (vertices, 3) [m] where the move begins.
        moves: (vertices, 3) [m] displacements.
        corners: (elements, corners) int64 vertices of each element.
        margin: added on every side [m].
        room: added at the end of the move [m].
    """
    boxes = np.empty((len(corners), 12))
    fill_boxes(vertices, moves, corners, margin, room, boxes)
    return boxes


@compiled
def fill_boxes(
    vertices: np.ndarray, moves: np.ndarray, corners: np.ndarray, margin: float, room: float, boxes: np.ndarray
) -> None:
    """Fill `boxes` (elements, 12) as `boxes_of` gives them.

    Args:
        vertices: (vertices, 3) [m] where the move begins.
        moves: (vertices, 3) [m] displacements.
        corners: (elements, corners) int64 vertices of each element.
        margin: added on every side [m].
        room: added at the end of the move [m].
        boxes: (elements, 12) [m], filled.
    """
    for element in range(len(corners)):
        box = boxes[element]
        for axis in range(3):
            low, high, last_low, last_high = np.inf, -np.inf, np.inf, -np.inf
            for k in range(corners.shape[1]):
                position = vertices[corners[element, k], axis]
                last = position + moves[corners[element, k], axis]
                low, high = min(low, position), max(high, position)
                last_low, last_high = min(last_low, last), max(last_high, last)
            box[axis], box[3 + axis] = low - margin, high + margin
            box[6 + axis], box[9 + axis] = last_low - margin - room, last_high + margin + room


def still_boxes(vertices: np.ndarray, faces: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (vertices, 3) float64, where not finite 0, and boxes (faces, 12) of faces at rest there [m].

    Of a face with a corner that is not finite, a box that meets none.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        margin: what the boxes are wider by on every side [m].
    """
    finite = np.isfinite(vertices).all(axis=1)
    points = np.ascontiguousarray(np.where(finite[:, None], vertices, 0.0), dtype=np.float64)
    boxes = boxes_of(points, np.zeros_like(points), faces, margin)
    boxes[~finite[faces].all(axis=1)] = _NOWHERE
    return points, boxes


@compiled
def fit_nodes(nodes: np.ndarray, tree: BoxTree, boxes: Boxes) -> None:
    """Fill the boxes of some `nodes` (n,) from those of faces, children before their parents.

    Args:
        nodes: (n,) int64 nodes, children before their parents.
        tree: which faces they hold.
        boxes: those of the nodes are filled.
    """
    for node in nodes:
        box = boxes.nodes[node]
        if tree.children[node, 0] >= 0:
            copy_row(boxes.nodes[tree.children[node, 0]], box)
            _include(box, boxes.nodes[tree.children[node, 1]])
        else:
            copy_row(boxes.faces[tree.order[tree.ranges[node, 0]]], box)
            for place in range(tree.ranges[node, 0] + 1, tree.ranges[node, 1]):
                _include(box, boxes.faces[tree.order[place]])


@compiled
def copy_row(source: np.ndarray, target: np.ndarray) -> None:
    """Put the numbers of `source` (n,) into `target` (n,).

    Args:
        source: (n,).
        target: (n,), filled.
    """
    for k in range(len(source)):
        target[k] = source[k]


@compiled
def _include(box: np.ndarray, other: np.ndarray) -> None:
    """Widen `box` (12,) to hold `other` (12,)."""
    for axis in range(3):
        box[axis] = min(box[axis], other[axis])
        box[3 + axis] = max(box[3 + axis], other[3 + axis])
        box[6 + axis] = min(box[6 + axis], other[6 + axis])
        box[9 + axis] = max(box[9 + axis], other[9 + axis])


@compiled
def boxes_meet(ones: np.ndarray, one: int, others: np.ndarray, other: int) -> bool:
    """Whether two boxes, rows of `ones` and of `others` (boxes, 12), may come together.

    They do where on no axis one is beyond the other at both ends of their moves.

    Args:
        ones: (boxes, 12) [m].
        one: row of `ones`.
        others: (boxes, 12) [m].
        other: row of `others`.
    """
    # By number: a row on its own is an array, which costs more to make than to compare.
    for axis in range(3):
        if ones[one, axis] > others[other, 3 + axis] and ones[one, 6 + axis] > others[other, 9 + axis]:
            return False
        if others[other, axis] > ones[one, 3 + axis] and others[other, 6 + axis] > ones[one, 9 + axis]:
            return False
    return True


@compiled
def with_room(rows: np.ndarray, count: int) -> np.ndarray:
    """`rows` with room for one more than `count`.

    Args:
        rows: (capacity, ...) of which the first `count` are in use.
        count: number of rows in use.
    """
    if count < len(rows):
        return rows
    larger = np.empty((2 * len(rows), rows.shape[1]), dtype=rows.dtype)
    for row in range(count):
        copy_row(rows[row], larger[row])
    return larger
