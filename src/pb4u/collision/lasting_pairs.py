"""Known pairs of near elements that last over moves, and how far vertices strayed from where they were known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pb4u.collision.box_tree import Boxes, copy_row, with_room
from pb4u.collision.element_distance import Reaches, fastest_approach, gather, nearest, reach_of
from pb4u.collision.jit import compiled


class Strayed(NamedTuple):
    """How far vertices strayed from where pairs were known: what strayed together is left out of a search.

    Args:
        ends: (vertices, 6) [m] as a move begins and as it ends.
        boxes: of that [m] of nodes and faces.
        calm: (vertices of no obstacle,) bool whether all around each strayed together.
        within: distance [m] up to which two vertices do.
    """

    ends: np.ndarray
    boxes: Boxes
    calm: np.ndarray
    within: float


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Pairs of elements that may come within a reach on a move, and after it while two corners stray alike.

    What strays alike from the end, by less than twice the room apart, comes no nearer than that: cloth that is carried
    along keeps its pairs. They are all there are for another move from the same start, too, whose end strays so.

    Args:
        start: (vertices, 3) [m] where the move began.
        end: (vertices, 3) [m] where it led.
        reaches: how near they may come.
        room: half of how far apart [m] two corners may stray from the end.
        corners: (pairs, 4) int64, as those of `ElementPairs`.
        vertex_faces: number of pairs of a vertex and a face, which come first.
        distances: (pairs,) [m] between them at the end.
    """

    start: np.ndarray
    end: np.ndarray
    reaches: Reaches
    room: float
    corners: np.ndarray
    vertex_faces: int
    distances: np.ndarray

    def strayed(
        self,
        vertices: np.ndarray,
        moves: np.ndarray,
        edges: np.ndarray,
        fitted: Callable[[np.ndarray, np.ndarray], Boxes],
    ) -> Strayed:
        """How far vertices stray from the end on a move; of a move from the same start its end alone matters.

        Args:
            vertices: (vertices, 3) [m].
            moves: (vertices, 3) [m] from there, linear.
            edges: (edges, 2) int64 between vertices that are not of obstacles.
            fitted: gives boxes of the surface's nodes and faces for values (vertices, 3) [m] and their changes.
        """
        begun, way, ends = _strayed(self.start, self.end, vertices, moves)
        within, own = 2.0 * self.room, ends[: self.reaches.first_obstacle]
        # Cloth that slides over a body strays from that, however much it does so as one.
        calm = _calm(own, edges, within, self.room if len(own) < len(ends) else np.inf)
        return Strayed(ends, fitted(begun, way), calm, within)

    def near(
        self, vertices: np.ndarray, moves: np.ndarray, strayed: Strayed, reaches: Reaches
    ) -> tuple[np.ndarray, int]:
        """Corners of its pairs that may come within their reach, and the number of those of a vertex and a face.

        Args:
            vertices: (vertices, 3) [m].
            moves: (vertices, 3) [m] from there, linear.
            strayed: how far vertices stray on them; only pairs that stray `together` are looked at.
            reaches: how near they have to come.
        """
        away, pairs = _away(self.end, vertices, moves), (self.corners, self.vertex_faces, self.distances)
        rows = _stay_near(vertices, moves, *pairs, away, strayed, reaches)
        return self.corners[rows], int(rows[: self.vertex_faces].sum())


@compiled
def lasting_pairs(
    vertices: np.ndarray,
    moves: np.ndarray,
    corners: np.ndarray,
    vertex_face: bool,
    room: float,
    reaches: Reaches,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Those of the `corners` (pairs, 4) that may come within twice a `room` of their reach on their moves.

    With their distances (pairs,) [m] after the moves, and whether (pairs,) they may come within their reach.

    Args:
        vertices: (vertices, 3) [m].
        moves: (vertices, 3) [m] displacements.
        corners: (pairs, 4) int64 vertices of the pairs.
        vertex_face: whether the pairs are of a vertex and a face, else of two edges.
        room: distance [m].
        reaches: as `reach_of` takes them.
    """
    points, way, weights, between = np.empty((4, 3)), np.empty((4, 3)), np.empty(4), np.empty(3)
    kept, distances = np.empty((64, 4), dtype=np.int64), np.empty(len(corners))
    near = np.empty(len(corners), dtype=np.bool_)
    count = 0
    for pair in range(len(corners)):
        gather(vertices, corners[pair], points)
        gather(moves, corners[pair], way)
        bound = nearest(points, vertex_face, weights, between)
        for corner in range(4):
            for axis in range(3):
                points[corner, axis] += way[corner, axis]
        bound -= fastest_approach(way, vertex_face) + reach_of(corners, pair, reaches)
        if bound > 2.0 * room:
            continue
        kept = with_room(kept, count)
        copy_row(corners[pair], kept[count])
        distances[count], near[count] = nearest(points, vertex_face, weights, between), bound <= 0.0
        count += 1
    return kept[:count], distances[:count], near[:count]


@compiled
def together(strayed: np.ndarray, one: tuple, other: tuple, within: float) -> bool:
    """Whether all corners of one element stray no further than `within` [m] apart from all of the other.

    Args:
        strayed: (vertices, 6) [m] how far, as a move begins and as it ends.
        one: corners of an element.
        other: corners of another.
        within: distance [m].
    """
    for v in one:
        for w in other:
            begun, ended = 0.0, 0.0
            for axis in range(3):
                begun += (strayed[v, axis] - strayed[w, axis]) ** 2
                ended += (strayed[v, 3 + axis] - strayed[w, 3 + axis]) ** 2
            if begun > within**2 or ended > within**2:
                return False
    return True


@compiled
def boxes_within(boxes: np.ndarray, one: int, other: int, within: float) -> bool:
    """Whether no point of one box is further than `within` [m] from one of the other, at both ends of their moves.

    Args:
        boxes: (boxes, 12) [m].
        one: row of them.
        other: row of them.
        within: distance [m].
    """
    begun, ended = 0.0, 0.0
    for axis in range(3):
        begun += max(boxes[one, 3 + axis] - boxes[other, axis], boxes[other, 3 + axis] - boxes[one, axis]) ** 2
        ended += max(boxes[one, 9 + axis] - boxes[other, 6 + axis], boxes[other, 9 + axis] - boxes[one, 6 + axis]) ** 2
    return begun <= within**2 and ended <= within**2


@compiled
def _strayed(
    start: np.ndarray, end: np.ndarray, vertices: np.ndarray, moves: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far (vertices, 3) [m] vertices are from an `end` as a move begins, how they go on, and both ends of that.

    Of a move from the `start` that led to it, the end alone.
    """
    again = True
    for row in range(len(vertices)):
        for axis in range(3):
            again = again and start[row, axis] == vertices[row, axis]
    begun, way, ends = np.empty(vertices.shape), np.empty(vertices.shape), np.empty((len(vertices), 6))
    for row in range(len(vertices)):
        for axis in range(3):
            if again:
                begun[row, axis], way[row, axis] = vertices[row, axis] + moves[row, axis] - end[row, axis], 0.0
            else:
                begun[row, axis], way[row, axis] = vertices[row, axis] - end[row, axis], moves[row, axis]
            ends[row, axis], ends[row, 3 + axis] = begun[row, axis], begun[row, axis] + way[row, axis]
    return begun, way, ends


@compiled
def _calm(ends: np.ndarray, edges: np.ndarray, within: float, room: float) -> np.ndarray:
    """Whether around each vertex (vertices,) `ends` (vertices, 6) [m] are no further than `within` [m] apart.

    And none further than a `room` [m] from 0.
    """
    low, high = ends.copy(), ends.copy()
    for edge in range(len(edges)):
        a, b = edges[edge, 0], edges[edge, 1]
        for k in range(6):
            low[a, k], high[a, k] = min(low[a, k], ends[b, k]), max(high[a, k], ends[b, k])
            low[b, k], high[b, k] = min(low[b, k], ends[a, k]), max(high[b, k], ends[a, k])
    calm = np.empty(len(ends), dtype=np.bool_)
    for v in range(len(ends)):
        begun, ended = 0.0, 0.0
        for axis in range(3):
            begun += (high[v, axis] - low[v, axis]) ** 2
            ended += (high[v, 3 + axis] - low[v, 3 + axis]) ** 2
        gone, gone_after = 0.0, 0.0
        for axis in range(3):
            gone += ends[v, axis] ** 2
            gone_after += ends[v, 3 + axis] ** 2
        calm[v] = begun <= within**2 and ended <= within**2 and gone <= room**2 and gone_after <= room**2
    return calm


@compiled
def _away(end: np.ndarray, vertices: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """How far (vertices,) [m] each vertex is from its `end` at most on its move."""
    away = np.empty(len(vertices))
    for row in range(len(vertices)):
        before, after = 0.0, 0.0
        for axis in range(3):
            way = vertices[row, axis] - end[row, axis]
            before += way * way
            after += (way + moves[row, axis]) ** 2
        away[row] = np.sqrt(max(before, after))
    return away


@compiled
def _stay_near(
    vertices: np.ndarray,
    moves: np.ndarray,
    corners: np.ndarray,
    vertex_faces: int,
    distances: np.ndarray,
    away: np.ndarray,
    strayed: Strayed,
    reaches: Reaches,
) -> np.ndarray:
    """Whether each pair (pairs,) that strayed `together` is no further apart than it may approach.

    For most, what was between them, `distances` (pairs,) [m], and how far `away` (vertices,) [m] they got decide it.
    """
    points, way, weights, between = np.empty((4, 3)), np.empty((4, 3)), np.empty(4), np.empty(3)
    near = np.zeros(len(corners), dtype=np.bool_)
    for pair in range(len(corners)):
        a, b, c, d = corners[pair, 0], corners[pair, 1], corners[pair, 2], corners[pair, 3]
        vertex_face = pair < vertex_faces
        if vertex_face:
            gone = away[a] + max(away[b], max(away[c], away[d]))
        else:
            gone = max(away[a], away[b]) + max(away[c], away[d])
        reach = reach_of(corners, pair, reaches)
        if distances[pair] - gone > reach:
            continue
        ends, within = strayed.ends, strayed.within
        if not (together(ends, (a,), (b, c, d), within) if vertex_face else together(ends, (a, b), (c, d), within)):
            continue
        gather(vertices, corners[pair], points)
        gather(moves, corners[pair], way)
        near[pair] = nearest(points, vertex_face, weights, between) <= reach + fastest_approach(way, vertex_face)
    return near
