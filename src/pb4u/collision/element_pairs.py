"""Pairs of near elements of a surface, a vertex and a face or two edges: how far apart they are, and stay on a move."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pb4u.collision.box_tree import copy_row, with_room
from pb4u.collision.element_distance import fastest_approach, gather, nearest
from pb4u.collision.jit import compiled

Reaches = tuple[float, float, int]
"""Distance [m] of pairs, of those with an obstacle, and the first vertex of obstacles, which are the last ones."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Pairs of elements that may come within a reach on a move, and after it while two corners stray alike.

    What strays alike from the end, by less than twice the room apart, comes no nearer than that: cloth that is carried
    along keeps its pairs. They are all there are for another move from the same start, too, whose end strays so.

    Args:
        start: (vertices, 3) [m] where the move began.
        end: (vertices, 3) [m] where it led.
        reaches: distances [m] of pairs, and of those with an obstacle.
        room: half of how far apart [m] two corners may stray from the end.
        corners: (pairs, 4) int64, as those of `ElementPairs`.
        vertex_faces: number of pairs of a vertex and a face, which come first.
        distances: (pairs,) [m] between them at the end.
    """

    start: np.ndarray
    end: np.ndarray
    reaches: tuple[float, float]
    room: float
    corners: np.ndarray
    vertex_faces: int
    distances: np.ndarray

    def strayed(self, vertices: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where (vertices, 3) [m] from the end vertices begin a move, and the move (vertices, 3) [m], as it matters.

        Of a move from the same start that is its end alone.

        Args:
            vertices: (vertices, 3) [m].
            moves: (vertices, 3) [m] from there, linear.
        """
        if np.array_equal(self.start, vertices):
            return vertices + moves - self.end, np.zeros_like(moves)
        return vertices - self.end, moves

    def near(
        self, vertices: np.ndarray, moves: np.ndarray, strayed: np.ndarray, reaches: Reaches
    ) -> tuple[np.ndarray, int]:
        """Corners of its pairs that may come within their reach, and the number of those of a vertex and a face.

        Args:
            vertices: (vertices, 3) [m].
            moves: (vertices, 3) [m] from there, linear.
            strayed: (vertices, 6) [m] from the end, as the move begins and ends; only pairs that stray `together`.
            reaches: as `reach_of` takes them.
        """
        away, within = _away(self.end, vertices, moves), 2.0 * self.room
        pairs = self.corners, self.vertex_faces, self.distances
        rows = _stay_near(vertices, moves, *pairs, away, strayed, within, reaches)
        return self.corners[rows], int(rows[: self.vertex_faces].sum())


@dataclass(frozen=True, eq=False)
class ElementPairs:
    """Pairs of a vertex and a face, then pairs of two edges, that come near one another and share no vertex.

    Args:
        corners: (pairs, 4) int64 the vertex and the face's corners, or the ends of both edges.
        vertex_faces: number of pairs of the first kind, which come first.
        rest_distance: (pairs,) [m] between them in the rest shape; infinite between two parts.
        neighbourhood: by which they were found, or None.
    """

    corners: np.ndarray
    vertex_faces: int
    rest_distance: np.ndarray
    neighbourhood: Neighbourhood | None = None

    def __len__(self) -> int:
        return len(self.corners)

    def nearest(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (pairs,) [m], weights (pairs, 4) of the corners and unit normals (pairs, 3).

        The vector between the nearest points, the normal times the distance, is the sum of the weighted corners.

        Args:
            vertices: (vertices, 3) float64 [m].
        """
        return _all_nearest(np.ascontiguousarray(vertices), self.corners, self.vertex_faces)

    def chosen(self, rows: np.ndarray) -> ElementPairs:
        """The pairs where `rows` (pairs,) bool holds.

        Args:
            rows: (pairs,) bool.
        """
        return replace(
            self,
            corners=self.corners[rows],
            vertex_faces=int(rows[: self.vertex_faces].sum()),
            rest_distance=self.rest_distance[rows],
        )


@compiled
def reach_of(corners: np.ndarray, pair: int, reaches: Reaches) -> float:
    """Reach [m] of a pair of some `corners` (pairs, 4).

    Args:
        corners: (pairs, 4) int64 vertices of the pairs.
        pair: its row.
        reaches: of both kinds.
    """
    return reaches[1] if max(corners[pair, 0], corners[pair, 3]) >= reaches[2] else reaches[0]


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
def rest_distances(rest: np.ndarray, part: np.ndarray, corners: np.ndarray, vertex_faces: int) -> np.ndarray:
    """Distances (pairs,) [m] at rest of pairs of one part, infinite between two.

    Args:
        rest: (vertices, 3) [m] at rest.
        part: (vertices,) int64 connected part of each vertex.
        corners: (pairs, 4) int64 vertices of the pairs.
        vertex_faces: number of leading pairs that are of a vertex and a face.
    """
    count = len(corners)
    distances = np.full(count, np.inf)
    points, weights, between = np.empty((4, 3)), np.empty(4), np.empty(3)
    for pair in range(count):
        if part[corners[pair, 0]] == part[corners[pair, 2]]:
            gather(rest, corners[pair], points)
            distances[pair] = nearest(points, pair < vertex_faces, weights, between)
    return distances


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
    strayed: np.ndarray,
    within: float,
    reaches: Reaches,
) -> np.ndarray:
    """Whether each pair (pairs,) that strayed `together` is no further apart than it may approach.

    Most are told by what was between them, `distances` (pairs,) [m], and how far `away` (vertices,) [m] they got.
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
        if not (
            together(strayed, (a,), (b, c, d), within) if vertex_face else together(strayed, (a, b), (c, d), within)
        ):
            continue
        gather(vertices, corners[pair], points)
        gather(moves, corners[pair], way)
        near[pair] = nearest(points, vertex_face, weights, between) <= reach + fastest_approach(way, vertex_face)
    return near


@compiled
def _all_nearest(
    vertices: np.ndarray, corners: np.ndarray, vertex_faces: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances (pairs,), weights (pairs, 4) and unit normals (pairs, 3) of pairs."""
    count = len(corners)
    distances, weights, normals = np.empty(count), np.empty((count, 4)), np.empty((count, 3))
    points = np.empty((4, 3))
    for pair in range(count):
        gather(vertices, corners[pair], points)
        distances[pair] = nearest(points, pair < vertex_faces, weights[pair], normals[pair])
        for axis in range(3):
            normals[pair, axis] /= max(distances[pair], 1e-300)
    return distances, weights, normals
