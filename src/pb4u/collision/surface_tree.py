"""A bounding-volume tree over a moving triangle surface: which vertices, edges and faces of it come near each other.

The tree is built once, from the rest shape, and its boxes are fitted to the positions of every search: cloth deforms,
but what is near on it stays near. A box has both ends of a move, and two are followed from one end to the other in the
same measure, so that cloth which is carried along by centimetres gives no more pairs than cloth at rest.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from pb4u.collision.box_tree import Boxes, BoxTree, boxes_of, fill_boxes, fit_nodes
from pb4u.collision.element_distance import Reaches, may_meet
from pb4u.collision.element_pairs import ElementPairs, rest_distances
from pb4u.collision.lasting_pairs import Neighbourhood, lasting_pairs
from pb4u.collision.near_elements import Query, Sweep, beside, near_around, near_elements, query_of
from pb4u.collision.surface_elements import Elements
from pb4u.threads import parallel_map

_ROOM = 0.1
"""How far a vertex may stray, in mean edge lengths at rest, before what is near it is searched again."""

_MOST_STRAYING = 0.5
"""Share of the vertices that may stray before the whole surface is searched again."""

_FEW = 256
"""Vertices up to which one thread searches around them: a millisecond, of which it takes a tenth to wake another."""

_FEW_PAIRS = 4096
"""Pairs up to which one thread looks through a list of them."""

_PIECES = 4
"""Pieces in which threads look through a list of pairs: as many as of the surface."""

_HALVED = 2
"""How often the surface is halved for the parts that threads search, and where it meets obstacles as often again."""


class _Fitted(NamedTuple):
    """Boxes fitted to where obstacles were, which they mostly are in the next search.

    Args:
        obstacles: (obstacle vertices, 3) [m].
        moves: (obstacle vertices, 3) [m].
        margin: what the boxes are wider by [m].
        room: the same at the end of the moves [m].
        boxes: of nodes and faces.
    """

    obstacles: np.ndarray
    moves: np.ndarray
    margin: float
    room: float
    boxes: Boxes

    def serves(self, obstacles: np.ndarray, moves: np.ndarray, margin: float, room: float) -> bool:
        """Whether what is kept of the obstacles holds for a search; arguments as those of the record."""
        wide = margin <= self.margin and room <= self.room
        return wide and np.array_equal(obstacles, self.obstacles) and np.array_equal(moves, self.moves)


class SurfaceTree:
    """Search for near pairs of elements of one surface.

    Args:
        rest: (vertices, 3) [m] from which the tree is built.
        faces: (faces, 3) int64.
        edges: (edges, 2) int64 of the faces.
        part: (vertices,) int64 part of the surface that each belongs to, such as a garment.
        world: (parts,) int64; parts of different worlds never meet.
        obstacles: number of vertices, the last ones, with their faces and edges, that come near each other unasked:
            of each pair one element is of the others.

    Attributes:
        first_obstacle: number of the first of these vertices.
    """

    def __init__(
        self,
        rest: np.ndarray,
        faces: np.ndarray,
        edges: np.ndarray,
        part: np.ndarray,
        world: Sequence[int],
        obstacles: int = 0,
    ) -> None:
        self.rest = np.ascontiguousarray(rest, dtype=np.float64)
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        self.part = np.ascontiguousarray(part, dtype=np.int64)
        self.edges = np.ascontiguousarray(edges, dtype=np.int64)
        face_part = self.part[self.faces[:, 0]]
        centres = self.rest[self.faces].mean(axis=1)
        self.vertex_world = np.asarray(world, dtype=np.int64)[self.part]
        self.boxes = BoxTree.over(centres, face_part, np.asarray(world))
        self.first_obstacle = len(self.rest) - obstacles
        own_edges, own_faces = (int((e[:, 0] < self.first_obstacle).sum()) for e in (self.edges, self.faces))
        self._own_faces, self._own_edges = own_faces, self.edges[:own_edges]
        lengths = np.linalg.norm(self.rest[self._own_edges[:, 0]] - self.rest[self._own_edges[:, 1]], axis=1)
        self._room = _ROOM * float(lengths.mean()) if len(lengths) else 0.0
        self._elements = Elements.of(self.faces, self.edges, len(self.rest))
        self._around = self._elements.pairs_around_vertices(own_faces, len(self.rest))

    @cached_property
    def _still(self) -> np.ndarray:
        return np.zeros_like(self.rest)

    @cached_property
    def _everywhere(self) -> np.ndarray:
        return np.arange(len(self.rest)) < self.first_obstacle

    @cached_property
    def _own(self) -> Query:
        return self._query(self._everywhere)

    @cached_property
    def _obstacles(self) -> Query:
        return self._query(~self._everywhere)

    @cached_property
    def _all(self) -> Query:
        return self._query(np.ones(len(self.rest), dtype=bool))

    def _query(self, among: np.ndarray) -> Query:
        return query_of(self.boxes, self.faces, among)

    def pairs(
        self,
        vertices: np.ndarray,
        reach: float,
        moves: np.ndarray | None = None,
        known: ElementPairs | None = None,
        lasting: bool = False,
        among: np.ndarray | None = None,
        obstacle_reach: float | None = None,
    ) -> ElementPairs:
        """Pairs that may come within `reach` of one another, a superset of those that do.

        Without moves it is those that do; with moves, those that are no further apart than they can approach.

        Args:
            vertices: (vertices, 3) float64 [m].
            reach: distance [m].
            moves: (vertices, 3) float64 [m] linear motion along which they may come near, or None.
            known: pairs of positions before these, where there are such: only what strayed apart since is searched.
            lasting: whether to look further than asked, so that the result serves as the next `known`.
            among: (vertices,) bool, of which each pair has one; None for all. Where all are of obstacles, these pairs
                are all with one. With `known`, the same as for these, and no other vertex moves since.
            obstacle_reach: distance [m] of pairs with an obstacle where it is less than `reach`; None for the same.
        """
        asked = self._everywhere if among is None else among
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        moving = self._still if moves is None else np.ascontiguousarray(moves, dtype=np.float64)
        reaches = Reaches(reach, min(reach, reach if obstacle_reach is None else obstacle_reach), self.first_obstacle)
        neighbourhood = None if known is None else known.neighbourhood
        if neighbourhood is not None and all(np.less_equal(reaches, neighbourhood.reaches)):
            strayed, begun, way = neighbourhood.strayed(vertices, moving)
            if np.count_nonzero(strayed[: self.first_obstacle]) <= _MOST_STRAYING * self.first_obstacle:
                if strayed.any():
                    theirs = self._of(strayed, begun, way, neighbourhood)
                    neighbourhood = neighbourhood.followed(strayed, vertices, theirs)
                return self._pairs(neighbourhood.near(vertices, moving, reaches), neighbourhood)
        if not lasting:
            candidates = self._search(vertices, moving, reaches, asked)
            return self._pairs(_near(candidates, vertices, moving, reaches), None)
        candidates = self._search(vertices, moving, reaches, asked, self._room)
        neighbourhood, rows = self._neighbourhood(candidates, vertices, moving, reaches)
        found = neighbourhood.corners[rows], int(rows[: neighbourhood.vertex_faces].sum())
        return self._pairs(found, neighbourhood)

    def _of(self, strayed: np.ndarray, vertices: np.ndarray, moves: np.ndarray, known: Neighbourhood) -> Neighbourhood:
        """Pairs of the vertices that `strayed` (vertices,) bool from the `known` ones, which last as long as these."""
        cloth, obstacle, first = known.reaches
        # The other vertices are somewhere within the room all along.
        wide = Reaches(cloth + 2.0 * known.room, obstacle + 2.0 * known.room, first)
        return self._neighbourhood(self._search(vertices, moves, wide, strayed), vertices, moves, known.reaches)[0]

    def _neighbourhood(
        self, candidates: tuple[np.ndarray, np.ndarray], vertices: np.ndarray, moves: np.ndarray, reaches: Reaches
    ) -> tuple[Neighbourhood, np.ndarray]:
        """Those of the `candidates` that come near, or do so after the move; and which (pairs,) do on it."""
        pieces = _PIECES if len(candidates[0]) + len(candidates[1]) > _FEW_PAIRS else 1
        parts = [(part, kind) for kind in (True, False) for part in np.array_split(candidates[not kind], pieces)]

        def lasting(part: tuple[np.ndarray, bool]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            return lasting_pairs(vertices, moves, *part, self._room, reaches)

        kept = parallel_map(lasting, parts) if pieces > 1 else [lasting(part) for part in parts]
        corners, distances, rows = (np.concatenate(found) for found in zip(*kept, strict=True))
        vertex_faces = sum(len(found[0]) for found in kept[:pieces])
        made = Neighbourhood(vertices.copy(), vertices + moves, reaches, self._room, corners, vertex_faces, distances)
        return made, rows

    def _pairs(self, found: tuple[np.ndarray, int], neighbourhood: Neighbourhood | None) -> ElementPairs:
        """Pairs of the corners that were `found`, of which the first so many are of a vertex and a face."""
        corners, first = found
        return ElementPairs(corners, first, rest_distances(self.rest, self.part, corners, first), neighbourhood)

    def _search(
        self,
        vertices: np.ndarray,
        moves: np.ndarray,
        reaches: Reaches,
        among: np.ndarray,
        room: float = 0.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Corners (pairs, 4) of vertex and face, and of two edges, that have one `among` these vertices and may meet.

        Whose boxes meet that are wider by half of a reach on every side, and at the end of the move by `room` [m] more.
        """
        if not among.any():
            return np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4), dtype=np.int64)
        boxes = self.fitted(vertices, moves, 0.5 * reaches.cloth, room)
        mixed, of_obstacles = not among[: self.first_obstacle].any(), among[self.first_obstacle :].any()
        asked = self._own if mixed or among is self._everywhere else self._query(among)
        others = self._obstacles if mixed else self._all
        whole = np.count_nonzero(asked.vertices) > _FEW
        pieces = _PIECES if whole else 1
        parts = [self._parts]
        if whole:
            nodes, mates = self._parts.T, self._parts.T[::-1]
            concern = (asked.nodes[nodes] & others.nodes[mates]).any(axis=0)
            parts = [self._parts[k : k + 1] for k in np.flatnonzero(concern)]
        # Cloth on skin lies along it: planes of its faces keep most apart whose boxes meet.
        way = Sweep(vertices, moves, np.concatenate([vertices, vertices + moves], axis=1), reaches, 2.0 * room)
        searches: list[Callable[[], Any]] = [
            partial(near_elements, boxes, self.boxes, self._elements, asked, others, part, way) for part in parts
        ]
        # Boxes of faces that share a vertex always meet: half of the time to find what they hold in the tree.
        if not mixed:
            vertices_around = np.array_split(beside(self._own_edges, among), pieces)
            searches += [
                partial(near_around, *self._around[not kind], kind, part, among, way)
                for kind in (True, False)
                for part in vertices_around
            ]
        found = parallel_map(lambda search: search(), searches) if whole else [search() for search in searches]
        vertex_faces, edge_edges = (
            np.concatenate(
                [pairs[kind] for pairs in found[: len(parts)]] + found[len(parts) + kind * pieces :][:pieces]
            )
            for kind in (0, 1)
        )
        if of_obstacles and not mixed:
            vertex_faces, edge_edges = (
                corners[(corners < self.first_obstacle).any(axis=1)] for corners in (vertex_faces, edge_edges)
            )
        return vertex_faces, edge_edges

    def fitted(self, vertices: np.ndarray, moves: np.ndarray, margin: float, room: float = 0.0) -> Boxes:
        """Boxes of the nodes and faces; those of obstacles may be wider than asked for.

        They hold until the next call in the same thread.

        Args:
            vertices: (vertices, 3) float64 [m].
            moves: (vertices, 3) float64 [m].
            margin: what they are wider by on every side [m].
            room: the same at the end of the move [m].
        """
        first = self.first_obstacle
        kept: _Fitted | None = getattr(self._kept, "boxes", None)
        if first < len(vertices) and kept is not None and kept.serves(vertices[first:], moves[first:], margin, room):
            fill_boxes(vertices, moves, self.faces[: self._own_faces], margin, room, kept.boxes.faces)
            fit_nodes(self._own_nodes, self.boxes, kept.boxes)
            return kept.boxes
        boxes = self.boxes.fitted(boxes_of(vertices, moves, self.faces, margin, room))
        if first < len(vertices):
            self._kept.boxes = _Fitted(vertices[first:].copy(), moves[first:].copy(), margin, room, boxes)
        return boxes

    @cached_property
    def _kept(self) -> threading.local:
        return threading.local()

    @cached_property
    def _own_nodes(self) -> np.ndarray:
        """Nodes (nodes,) int64 that hold a face which is no obstacle's, children before their parents."""
        return np.ascontiguousarray(np.flatnonzero(self._own.nodes)[::-1])

    @cached_property
    def _parts(self) -> np.ndarray:
        """Pairs (parts, 2) int64 of nodes, a search of all of which, one after another, is one of everything."""
        parts = [(root, root) for root in self.boxes.roots]
        for _ in range(_HALVED):
            parts = [finer for part in parts for finer in self.boxes.halves(*part)]
        if self.first_obstacle < len(self.rest):
            for _ in range(_HALVED):
                parts = [finer for a, b in parts for finer in (self.boxes.halves(a, b) if a != b else [(a, b)])]
        return np.asarray(parts, dtype=np.int64).reshape(-1, 2)


def _near(
    candidates: tuple[np.ndarray, np.ndarray], vertices: np.ndarray, moves: np.ndarray, reaches: Reaches
) -> tuple[np.ndarray, int]:
    """Corners of the `candidates` that may come within their reach, and the number of those of a vertex and a face."""
    # Boxes of long edges across each other meet long before the edges do.
    vertex_faces, edge_edges = (
        corners[may_meet(vertices, moves, corners, kind, reaches)] if len(corners) else corners
        for corners, kind in zip(candidates, (True, False), strict=True)
    )
    return np.concatenate([vertex_faces, edge_edges]), len(vertex_faces)
