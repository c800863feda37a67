"""Known pairs of near elements that last over moves, and which vertices strayed from where they were known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pb4u.collision.box_tree import copy_row, with_room
from pb4u.collision.element_distance import Reaches, fastest_approach, gather, nearest, reach_of
from pb4u.collision.jit import compiled
from pb4u.collision.surface_elements import any_corner


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """All pairs of elements that may come within a reach on a move, and after it while no vertex strays from its end.

    A vertex that stays within the room of its end brings a pair nearer by no more than that. They are all there are for
    another move from the same start, too, that ends so near. Vertices that stray are followed: what is near them is
    searched for again, and has an end of its own.

    Args:
        start: (vertices, 3) [m] where the last move that was followed began.
        end: (vertices, 3) [m] where each vertex was last followed to.
        reaches: how near they may come.
        room: how far [m] a vertex may stray from its end.
        corners: (pairs, 4) int64, as those of `ElementPairs`.
        vertex_faces: number of pairs of a vertex and a face, which come first.
        distances: (pairs,) [m] between them at the ends.
    """

    start: np.ndarray
    end: np.ndarray
    reaches: Reaches
    room: float
    corners: np.ndarray
    vertex_faces: int
    distances: np.ndarray

    def strayed(self, vertices: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which vertices (vertices,) bool stray on a move, and a move by which the others go as they did before.

        Where that begins (vertices, 3) [m], and the way (vertices, 3) [m] of each: its own where it strays.

        Args:
            vertices: (vertices, 3) [m].
            moves: (vertices, 3) [m] from there, linear.
        """
        return _strayed(self.start, self.end, vertices, moves, self.room)

    def near(self, vertices: np.ndarray, moves: np.ndarray, reaches: Reaches) -> tuple[np.ndarray, int]:
        """Corners of its pairs that may come within their reach, and the number of those of a vertex and a face.

        Args:
            vertices: (vertices, 3) [m].
            moves: (vertices, 3) [m] from there, linear, on which none strays.
            reaches: how near they have to come.
        """
        pairs = self.corners, self.vertex_faces, self.distances
        rows = _stay_near(vertices, moves, *pairs, _away(self.end, vertices, moves), reaches)
        return self.corners[rows], int(rows[: self.vertex_faces].sum())

    def followed(self, strayed: np.ndarray, start: np.ndarray, found: Neighbourhood) -> Neighbourhood:
        """These pairs, with those `found` of the vertices that `strayed` in place of those known of them.

        Args:
            strayed: (vertices,) bool.
            start: (vertices, 3) [m] where the move began on which they did.
            found: all pairs that have one of them.
        """
        stay = ~any_corner(self.corners, strayed)
        first, other = int(stay[: self.vertex_faces].sum()), found.vertex_faces
        kept, distances = self.corners[stay], self.distances[stay]
        corners = np.concatenate([kept[:first], found.corners[:other], kept[first:], found.corners[other:]])
        distances = np.concatenate(
            [distances[:first], found.distances[:other], distances[first:], found.distances[other:]]
        )
        return replace(
            self, start=start, end=found.end, corners=corners, vertex_faces=first + other, distances=distances
        )


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
def _strayed(
    start: np.ndarray, end: np.ndarray, vertices: np.ndarray, moves: np.ndarray, room: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which vertices (vertices,) bool are further than a `room` [m] from their `end` before or after their moves.

    Of a move from the `start` the end alone counts. With positions and ways (vertices, 3) [m]: those of the vertices
    that stray are theirs; the others stand at their end, or go there from the start.
    """
    again = True
    for row in range(len(vertices)):
        for axis in range(3):
            again = again and vertices[row, axis] == start[row, axis]
    strayed, begun, way = np.empty(len(vertices), dtype=np.bool_), np.empty(vertices.shape), np.empty(vertices.shape)
    for row in range(len(vertices)):
        before, after = 0.0, 0.0
        for axis in range(3):
            gone = vertices[row, axis] - end[row, axis]
            before += gone * gone
            after += (gone + moves[row, axis]) ** 2
        # What is near its end all along stands there, whether it began there or not.
        near = before <= room * room
        strayed[row] = after > room * room or not (near or again)
        for axis in range(3):
            if strayed[row]:
                begun[row, axis], way[row, axis] = vertices[row, axis], moves[row, axis]
            elif near:
                begun[row, axis], way[row, axis] = end[row, axis], 0.0
            else:
                begun[row, axis], way[row, axis] = vertices[row, axis], end[row, axis] - vertices[row, axis]
    return strayed, begun, way


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
    reaches: Reaches,
) -> np.ndarray:
    """Whether each pair (pairs,) is no further apart than it may approach.

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
        gather(vertices, corners[pair], points)
        gather(moves, corners[pair], way)
        near[pair] = nearest(points, vertex_face, weights, between) <= reach + fastest_approach(way, vertex_face)
    return near
