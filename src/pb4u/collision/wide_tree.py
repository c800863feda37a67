"""A tree of boxes with eight children to a node, for searches of one point at a time; built once, fitted to each pose.

The distances to eight boxes are worked out together, in the lanes of a processor, and a search looks at a third of the
nodes that a tree of two children would show it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.collision.box_tree import sort_along_widest
from pb4u.collision.jit import compiled

WIDTH = 8
"""Children of a node: numbers of double precision that a processor of today takes at a time, or in two halves."""

_EMPTY = 1e150
"""Where the box of a child that is missing begins; its square is finite, and no search goes there."""


@dataclass(frozen=True, eq=False)
class WideTree:
    """Which faces each node of the tree holds: eight that follow each other in the order, and eight of these above.

    Args:
        order: (faces,) int64 the faces.
        children: (nodes,) int64 first child of each node, the others follow it; of the first ones, `bottoms`, a place
            in the order. The root is the last node.
        levels: (levels + 1,) int64 first node of each level, and the number of nodes.
    """

    order: np.ndarray
    children: np.ndarray
    levels: np.ndarray

    @staticmethod
    def over(centres: np.ndarray) -> WideTree:
        """Tree over at least one face.

        Args:
            centres: (faces, 3) [m].
        """
        counts = [-(-len(centres) // WIDTH)]
        while counts[-1] > 1:
            counts.append(-(-counts[-1] // WIDTH))
        levels = np.concatenate([[0], np.cumsum(counts)])
        below = [0, *levels[:-2]]
        children = [first + WIDTH * np.arange(count) for first, count in zip(below, counts, strict=True)]
        order = _ordered(np.ascontiguousarray(centres, dtype=np.float64))
        return WideTree(order, np.concatenate(children).astype(np.int64), levels.astype(np.int64))

    @property
    def bottoms(self) -> int:
        """Number of nodes whose children are faces."""
        return int(self.levels[1])


@compiled
def _ordered(centres: np.ndarray) -> np.ndarray:
    """Order (faces,) in which those of each node follow each other, near ones next to each other.

    Faces are halved along the axis on which their centres lie furthest apart, so that the first half fills its nodes.
    """
    order = np.arange(len(centres))
    waiting = np.empty((128, 2), dtype=np.int64)
    waiting[0, 0], waiting[0, 1] = 0, len(centres)
    depth = 1
    while depth > 0:
        depth -= 1
        first, stop = waiting[depth]
        if stop - first <= WIDTH:
            continue
        half = WIDTH
        while 2 * half < stop - first:
            half *= 2
        sort_along_widest(centres, order, first, stop)
        waiting[depth, 0], waiting[depth, 1] = first, first + half
        waiting[depth + 1, 0], waiting[depth + 1, 1] = first + half, stop
        depth += 2
    return order


@compiled
def fit(
    vertices: np.ndarray, faces: np.ndarray, order: np.ndarray, levels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (faces, 9) [m] in the order, and lowest and highest corner (nodes, 6, 8) [m] of all children.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        order: that of the `WideTree`.
        levels: those of the `WideTree`.
    """
    corners, boxes = np.empty((len(order), 9)), _no_boxes(levels)
    _fit_some(vertices, faces, np.ones(len(order), dtype=np.bool_), order, levels, corners, boxes, boxes)
    return corners, boxes


@compiled
def fit_again(
    vertices: np.ndarray,
    faces: np.ndarray,
    went: np.ndarray,
    order: np.ndarray,
    levels: np.ndarray,
    corners: np.ndarray,
    boxes: np.ndarray,
) -> np.ndarray:
    """Bring what `fit` gave up to date, and give back boxes (nodes, 6, 8) [m] in which only faces that `went` are.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        went: (faces,) bool, those with another place than before.
        order: that of the `WideTree`.
        levels: those of the `WideTree`.
        corners: (faces, 9) [m], changed.
        boxes: (nodes, 6, 8) [m], changed.
    """
    alone = _no_boxes(levels)
    _fit_some(vertices, faces, went, order, levels, corners, boxes, alone)
    return alone


@compiled
def _no_boxes(levels: np.ndarray) -> np.ndarray:
    boxes = np.empty((levels[-1], 6, WIDTH))
    boxes[:, :3], boxes[:, 3:] = _EMPTY, -_EMPTY
    return boxes


@compiled
def _fit_some(
    vertices: np.ndarray,
    faces: np.ndarray,
    went: np.ndarray,
    order: np.ndarray,
    levels: np.ndarray,
    corners: np.ndarray,
    boxes: np.ndarray,
    alone: np.ndarray,
) -> None:
    """Change `corners` and `boxes` for the faces that `went`; `alone` are boxes of these and of nothing else."""
    changed = np.zeros(levels[-1], dtype=np.bool_)
    for place in range(len(order)):
        face = order[place]
        if not went[face]:
            continue
        node, lane = place // WIDTH, place % WIDTH
        changed[node] = True
        for axis in range(3):
            low, high = _EMPTY, -_EMPTY
            for corner in range(3):
                value = vertices[faces[face, corner], axis]
                corners[place, 3 * corner + axis] = value
                low, high = min(low, value), max(high, value)
            boxes[node, axis, lane] = alone[node, axis, lane] = low
            boxes[node, 3 + axis, lane] = alone[node, 3 + axis, lane] = high
    for level in range(1, len(levels) - 1):
        first, below = levels[level], levels[level - 1]
        for child in range(first - below):
            if not changed[below + child]:
                continue
            node, lane = first + child // WIDTH, child % WIDTH
            changed[node] = True
            for held in (boxes, alone):
                for axis in range(3):
                    low, high = _EMPTY, -_EMPTY
                    for inner in range(WIDTH):
                        low = min(low, held[below + child, axis, inner])
                        high = max(high, held[below + child, 3 + axis, inner])
                    held[node, axis, lane], held[node, 3 + axis, lane] = low, high
