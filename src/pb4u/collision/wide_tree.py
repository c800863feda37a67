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

    def fitted(self, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners (faces, 9) [m] in the order, and lowest and highest corner (nodes, 6, 8) [m] of all children.

        Args:
            vertices: (vertices, 3) [m].
            faces: (faces, 3) int64.
        """
        fitted: tuple[np.ndarray, np.ndarray] = fit(
            vertices, faces, np.ones(len(faces), dtype=np.bool_), self.order, self.levels
        )
        return fitted


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
    vertices: np.ndarray, faces: np.ndarray, wanted: np.ndarray, order: np.ndarray, levels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (faces, 9) [m] in the order, and lowest and highest corner (nodes, 6, 8) [m] of all children.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        wanted: (faces,) bool, those that a search can find.
        order: that of the `WideTree`.
        levels: those of the `WideTree`.
    """
    corners, boxes = np.empty((len(order), 9)), np.empty((levels[-1], 6, WIDTH))
    for place in range(len(order)):
        for corner in range(3):
            for axis in range(3):
                corners[place, 3 * corner + axis] = vertices[faces[order[place], corner], axis]
    for level in range(len(levels) - 1):
        first, below = levels[level], levels[level - 1] if level > 0 else 0
        held = first - below if level > 0 else len(order)
        for node in range(first, levels[level + 1]):
            for lane in range(WIDTH):
                child = WIDTH * (node - first) + lane
                for axis in range(3):
                    low, high = _EMPTY, -_EMPTY
                    if level == 0 and child < held and wanted[order[child]]:
                        for corner in range(axis, 9, 3):
                            low, high = min(low, corners[child, corner]), max(high, corners[child, corner])
                    elif level > 0 and child < held:
                        for inner in range(WIDTH):
                            low = min(low, boxes[below + child, axis, inner])
                            high = max(high, boxes[below + child, 3 + axis, inner])
                    boxes[node, axis, lane], boxes[node, 3 + axis, lane] = low, high
    return corners, boxes
