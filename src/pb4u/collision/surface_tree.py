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

from pb4u.collision.box_tree import (
    EVERY,
    BoxTree,
    boxes_meet,
    boxes_of,
    boxes_within,
    copy_row,
    fill_boxes,
    fit_nodes,
    meeting_leaves,
    with_room,
)
from pb4u.collision.element_pairs import (
    ElementPairs,
    Neighbourhood,
    Reaches,
    lasting_pairs,
    may_meet,
    rest_distances,
    together,
)
from pb4u.collision.jit import compiled
from pb4u.geometry.topology import Topology
from pb4u.threads import parallel_map

_ROOM = 0.1
"""Half of how far apart two vertices may stray, in mean edge lengths at rest, before what is near is searched again."""

_MOST_STRAYING = 0.3
"""Share of the vertices that may stray from those around them before the whole surface is searched again."""

_FEW = 4096
"""Vertices up to which one thread searches: 6 ms, beside which it takes long to wake another processor."""

_PIECES = 4
"""Pieces in which threads look through a list of pairs: as many as of the surface."""

_HALVED = 2
"""How often the surface is halved for the parts that threads search: four pieces, and the three seams between them."""


Boxes = tuple[np.ndarray, np.ndarray]


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


class _Strayed(NamedTuple):
    """How far vertices strayed from where pairs were known, as a move begins and as it ends.

    Args:
        ends: (vertices, 6) [m].
        boxes: (.., 12) [m] of that of nodes and faces.
        calm: (vertices,) bool whether all around a vertex strayed together.
        within: distance [m] up to which two vertices do.
    """

    ends: np.ndarray
    boxes: Boxes
    calm: np.ndarray
    within: float

    @staticmethod
    def over(tree: SurfaceTree, known: Neighbourhood, vertices: np.ndarray, moves: np.ndarray) -> _Strayed:
        """Those of a move (vertices, 3) [m] of the surface of a `tree` from `vertices` (vertices, 3) [m]."""
        begun, way = known.strayed(vertices, moves)
        ends, within, faces = np.concatenate([begun, begun + way], axis=1), 2.0 * known.room, tree.faces
        calm = _calm(ends, tree.edges, within)
        if tree.first_obstacle < len(vertices):
            # Cloth that slides over a body strays from that, however much it does so as one.
            calm &= (ends[:, :3] ** 2).sum(axis=1) <= known.room**2
            calm &= (ends[:, 3:] ** 2).sum(axis=1) <= known.room**2
        straying = boxes_of(begun, way, faces, 0.0)
        return _Strayed(ends, (tree.boxes.fitted(straying), straying), calm, within)


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
        self._own_faces = own_faces
        lengths = np.linalg.norm(self.rest[self.edges[:own_edges, 0]] - self.rest[self.edges[:own_edges, 1]], axis=1)
        self._room = _ROOM * float(lengths.mean()) if len(lengths) else 0.0
        self._owned_vertices, self._owned_edges = _owners(self.faces, self.edges, len(self.rest))
        around = (values[:own_faces] for values in (self.faces, self._owned_vertices, self._owned_edges))
        own, own_vertices, own_sides = around
        self._around = _pairs_around(own, self.edges, own_vertices, own_sides, len(self.rest))

    @cached_property
    def _still(self) -> np.ndarray:
        return np.zeros_like(self.rest)

    @cached_property
    def _everywhere(self) -> np.ndarray:
        return np.arange(len(self.rest)) < self.first_obstacle

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
            among: (vertices,) bool, of which each pair has one; None for all. Not with `known` or `lasting`.
            obstacle_reach: distance [m] of pairs with an obstacle where it is less than `reach`; None for the same.

        Raises:
            ValueError: they are given together.
        """
        if among is not None and (known is not None or lasting):
            raise ValueError("pairs of some vertices are neither taken from known pairs nor kept as such")
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        moving = self._still if moves is None else np.ascontiguousarray(moves, dtype=np.float64)
        reaches = reach, min(reach, reach if obstacle_reach is None else obstacle_reach), self.first_obstacle
        neighbourhood = None if known is None else known.neighbourhood
        if neighbourhood is not None and all(np.less_equal(reaches[:2], neighbourhood.reaches)):
            strayed = _Strayed.over(self, neighbourhood, vertices, moving)
            if np.count_nonzero(~strayed.calm[: self.first_obstacle]) <= _MOST_STRAYING * self.first_obstacle:
                stayed = neighbourhood.near(vertices, moving, strayed.ends, reaches)
                candidates = self._search(vertices, moving, reaches, self._everywhere, strayed=strayed)
                return self._pairs((stayed, _near(candidates, vertices, moving, reaches)), neighbourhood)
        if not lasting:
            asked = self._everywhere if among is None else among
            candidates = self._search(vertices, moving, reaches, asked)
            return self._pairs((_near(candidates, vertices, moving, reaches),), None)
        candidates = self._search(vertices, moving, reaches, self._everywhere, self._room)
        neighbourhood, rows = self._neighbourhood(candidates, vertices, moving, reaches)
        found = neighbourhood.corners[rows], int(rows[: neighbourhood.vertex_faces].sum())
        return self._pairs((found,), neighbourhood)

    def _neighbourhood(
        self, candidates: tuple[np.ndarray, np.ndarray], vertices: np.ndarray, moves: np.ndarray, reaches: Reaches
    ) -> tuple[Neighbourhood, np.ndarray]:
        """Those of the `candidates` that come near, or do so after the move; and which (pairs,) do on it."""
        pieces = _PIECES if len(vertices) > _FEW else 1
        parts = [(part, kind) for kind in (True, False) for part in np.array_split(candidates[not kind], pieces)]
        kept = parallel_map(lambda part: lasting_pairs(vertices, moves, *part, self._room, reaches), parts)
        corners, distances, rows = (np.concatenate(found) for found in zip(*kept, strict=True))
        vertex_faces = sum(len(found[0]) for found in kept[:pieces])
        made = Neighbourhood(
            vertices.copy(), vertices + moves, reaches[:2], self._room, corners, vertex_faces, distances
        )
        return made, rows

    def _pairs(self, parts: Sequence[tuple[np.ndarray, int]], neighbourhood: Neighbourhood | None) -> ElementPairs:
        """All `parts` as one: corners, of which the first so many are of a vertex and a face."""
        faces, edges = [c[:first] for c, first in parts], [c[first:] for c, first in parts]
        corners, first = np.concatenate([*faces, *edges]), sum(first for _, first in parts)
        return ElementPairs(corners, first, rest_distances(self.rest, self.part, corners, first), neighbourhood)

    def _search(
        self,
        vertices: np.ndarray,
        moves: np.ndarray,
        reaches: Reaches,
        among: np.ndarray,
        room: float = 0.0,
        strayed: _Strayed | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Corners (pairs, 4) of vertex and face, and of two edges, that have one `among` these vertices and may meet.

        Whose boxes meet that are wider by half of a reach on every side, and at the end of the move by `room` [m] more.
        Those that `strayed` together since are left out.
        """
        if not among.any():
            return np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4), dtype=np.int64)
        boxes = self.fitted(vertices, moves, 0.5 * reaches[0], room)
        elements = (self.faces, self.edges, self._owned_vertices, self._owned_edges)
        tree = self.boxes.arrays[:3]
        asked = (among, *asked_for(tree, self.faces, among))
        whole = np.count_nonzero(among) > _FEW
        parts = np.split(self._parts, range(1, len(self._parts))) if whole else [self._parts]
        # Cloth on skin lies along it: planes of its faces keep most apart whose boxes meet.
        begun, ended = reaches[0], reaches[0] + 2.0 * room
        ends = np.concatenate([vertices, vertices + moves], axis=1)
        way = vertices, moves, begun, ended, self.first_obstacle, ends, reaches[1], reaches[1] + 2.0 * room
        known = None if strayed is None else tuple(strayed)
        searches: list[Callable[[], Any]] = [
            partial(_search, boxes, tree, elements, asked, part, way, known) for part in parts
        ]
        # Boxes of faces that share a vertex always meet: half of the time to find what they hold in the tree.
        pieces = _PIECES if whole else 1
        around = [(piece, kind) for kind in (True, False) for piece in np.array_split(self._around[not kind], pieces)]
        searches += [partial(_near_around, ends, among, *piece, begun, ended, known) for piece in around]
        found = parallel_map(lambda search: search(), searches)
        vertex_faces, edge_edges = (
            np.concatenate(
                [pairs[kind] for pairs in found[: len(parts)]] + found[len(parts) + kind * pieces :][:pieces]
            )
            for kind in (0, 1)
        )
        if among[self.first_obstacle :].any():
            vertex_faces, edge_edges = (
                corners[(corners < self.first_obstacle).any(axis=1)] for corners in (vertex_faces, edge_edges)
            )
        return vertex_faces, edge_edges

    def fitted(self, vertices: np.ndarray, moves: np.ndarray, margin: float, room: float = 0.0) -> Boxes:
        """Boxes (.., 12) [m] of the nodes and faces; those of obstacles may be wider than asked for.

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
            nodes, faces = kept.boxes
            fill_boxes(vertices, moves, self.faces[: self._own_faces], margin, room, faces)
            fit_nodes(self._own_nodes, faces, *self.boxes.arrays[:3], nodes)
            return kept.boxes
        faces = boxes_of(vertices, moves, self.faces, margin, room)
        boxes = self.boxes.fitted(faces), faces
        if first < len(vertices):
            self._kept.boxes = _Fitted(vertices[first:].copy(), moves[first:].copy(), margin, room, boxes)
        return boxes

    @cached_property
    def _kept(self) -> threading.local:
        return threading.local()

    @cached_property
    def _own_nodes(self) -> np.ndarray:
        """Nodes (nodes,) int64 that hold a face which is no obstacle's, children before their parents."""
        own = self.faces[:, 0] < self.first_obstacle
        counts = np.concatenate([[0], np.cumsum(own[self.boxes.order])])
        nodes = np.flatnonzero(counts[self.boxes.ranges[:, 1]] > counts[self.boxes.ranges[:, 0]])
        return np.ascontiguousarray(nodes[::-1])

    @cached_property
    def _parts(self) -> np.ndarray:
        """Pairs (parts, 2) int64 of nodes, a search of all of which is one of everything."""
        parts = [(root, root) for root in self.boxes.roots]
        children = self.boxes.children
        for _ in range(_HALVED):
            finer = []
            for a, b in parts:
                left, right = children[a]
                finer += [(left, left), (right, right), (left, right)] if a == b and left >= 0 else [(a, b)]
            parts = finer
        return np.asarray(parts, dtype=np.int64).reshape(-1, 2)


def _owners(faces: np.ndarray, edges: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (faces, 3) and edges (faces, 3) that each face answers for, -1 where another face does.

    So that every pair of elements is met once, though neighbouring faces share corners and sides.
    """
    _, first = np.unique(faces.reshape(-1), return_index=True)
    own = np.full(faces.size, -1, dtype=np.int64)
    own[first] = faces.reshape(-1)[first]
    sides = np.sort(np.stack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]], axis=1).reshape(-1, 2), axis=1)
    keys = sides[:, 0] * vertex_count + sides[:, 1]
    ordered = np.sort(edges, axis=1)
    edge_keys = ordered[:, 0] * vertex_count + ordered[:, 1]
    by_key = np.argsort(edge_keys)
    number = by_key[np.searchsorted(edge_keys[by_key], keys)] if len(keys) else keys
    _, first = np.unique(number, return_index=True)
    own_edges = np.full(len(keys), -1, dtype=np.int64)
    own_edges[first] = number[first]
    return own.reshape(-1, 3), own_edges.reshape(-1, 3)


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


def _pairs_around(
    faces: np.ndarray, edges: np.ndarray, owned_vertices: np.ndarray, owned_edges: np.ndarray, vertex_count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a vertex and a face, and of two edges, without a common vertex, whose faces have one.

    Their corners, and the common vertex (pairs, 5) int32 each; each pair once.
    """
    starts, ring = Topology(faces, vertex_count).vertex_faces
    near_faces, near_edges = _listed_around(faces, edges, owned_vertices, owned_edges, ring, starts)
    vertex_faces = np.column_stack([near_faces[:, 0], faces[near_faces[:, 1]], near_faces[:, 2]])
    sides = np.column_stack([edges[near_edges[:, 0]], edges[near_edges[:, 1]], near_edges[:, 2]])
    return vertex_faces.astype(np.int32), sides.astype(np.int32)


@compiled
def _share_a_vertex(faces: np.ndarray, one: int, other: int) -> bool:
    """Whether two of the `faces` (faces, 3) have a vertex in common."""
    a, b, c = faces[one, 0], faces[one, 1], faces[one, 2]
    d, e, f = faces[other, 0], faces[other, 1], faces[other, 2]
    first, second, third = (
        (a == d) | (a == e) | (a == f),
        (b == d) | (b == e) | (b == f),
        (c == d) | (c == e) | (c == f),
    )
    return first | second | third


@compiled
def _listed_around(
    faces: np.ndarray,
    edges: np.ndarray,
    owned_vertices: np.ndarray,
    owned_edges: np.ndarray,
    ring: np.ndarray,
    starts: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """As `_pairs_around`, the elements by their numbers, and the common vertex (pairs, 3) int64.

    `ring` holds the faces around each vertex, from `starts` (vertices + 1,) of it on.
    """
    near_faces, near_edges = np.empty((1024, 3), dtype=np.int64), np.empty((1024, 3), dtype=np.int64)
    face_count, edge_count = 0, 0
    met = np.full(len(faces), -1)
    for f in range(len(faces)):
        for corner in range(3):
            for place in range(starts[faces[f, corner]], starts[faces[f, corner] + 1]):
                g = ring[place]
                if g == f or met[g] == f:
                    continue
                met[g] = f
                for k in range(3):
                    v = owned_vertices[f, k]
                    if v >= 0 and v != faces[g, 0] and v != faces[g, 1] and v != faces[g, 2]:
                        near_faces = with_room(near_faces, face_count)
                        near_faces[face_count, 0], near_faces[face_count, 1] = v, g
                        near_faces[face_count, 2] = faces[f, corner]
                        face_count += 1
                    p = owned_edges[f, k]
                    if p < 0 or g < f:
                        continue
                    for m in range(3):
                        q = owned_edges[g, m]
                        if q < 0 or edges[p, 0] == edges[q, 0] or edges[p, 0] == edges[q, 1]:
                            continue
                        if edges[p, 1] == edges[q, 0] or edges[p, 1] == edges[q, 1]:
                            continue
                        near_edges = with_room(near_edges, edge_count)
                        near_edges[edge_count, 0], near_edges[edge_count, 1] = p, q
                        near_edges[edge_count, 2] = faces[f, corner]
                        edge_count += 1
    return near_faces[:face_count].copy(), near_edges[:edge_count].copy()


@compiled
def _calm(ends: np.ndarray, edges: np.ndarray, within: float) -> np.ndarray:
    """Whether around each vertex (vertices,) `ends` (vertices, 6) [m] are no further than `within` [m] apart."""
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
        calm[v] = begun <= within**2 and ended <= within**2
    return calm


@compiled
def _near_around(
    ends: np.ndarray,
    among: np.ndarray,
    listed: np.ndarray,
    vertex_face: bool,
    begun: float,
    ended: float,
    strayed: tuple | None,
) -> np.ndarray:
    """Corners (pairs, 4) of what `_pairs_around` lists with one `among` (vertices,), unless `_apart`.

    Those that `strayed` together are left out.
    """
    near, count = np.empty((64, 4), dtype=np.int64), 0
    for pair in range(len(listed)):
        if strayed is not None and strayed[2][listed[pair, 4]]:
            continue
        a, b, c, d = listed[pair, 0], listed[pair, 1], listed[pair, 2], listed[pair, 3]
        if not (among[a] or among[b] or among[c] or among[d]):
            continue
        if vertex_face:
            if strayed is not None and together(strayed[0], (a,), (b, c, d), strayed[3]):
                continue
            apart = _apart(ends, (a,), (b, c, d), begun, ended)
        else:
            if strayed is not None and together(strayed[0], (a, b), (c, d), strayed[3]):
                continue
            apart = _apart(ends, (a, b), (c, d), begun, ended)
        if not apart:
            near = with_room(near, count)
            near[count, 0], near[count, 1], near[count, 2], near[count, 3] = a, b, c, d
            count += 1
    return near[:count]


@compiled
def asked_for(tree: tuple, faces: np.ndarray, among: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes and faces have a vertex `among` (vertices,) the given ones.

    Args:
        tree: order, children and ranges of a `BoxTree`.
        faces: (faces, 3) int64.
        among: (vertices,) bool.
    """
    order, children, ranges = tree
    asked_faces = any_corner(faces, among)
    asked_nodes = np.empty(len(children), dtype=np.bool_)
    for node in range(len(children) - 1, -1, -1):
        asked = False
        if children[node, 0] >= 0:
            asked = asked_nodes[children[node, 0]] or asked_nodes[children[node, 1]]
        else:
            for place in range(ranges[node, 0], ranges[node, 1]):
                asked = asked or asked_faces[order[place]]
        asked_nodes[node] = asked
    return asked_nodes, asked_faces


@compiled
def _search(
    boxes: tuple, tree: tuple, elements: tuple, asked: tuple, parts: np.ndarray, way: tuple, strayed: tuple | None
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (pairs, 4) of vertex and face, and of two edges, with one `asked` for and boxes that meet.

    Of the elements in the pairs of nodes `parts` (parts, 2), of faces that share no vertex. Those of obstacles that
    `_beside` tells of, on the `way`, are left out, and those that `strayed` together.
    """
    order, children, ranges = tree
    faces, edges, owned_vertices, owned_edges = elements
    node_boxes, face_boxes = boxes
    among, asked_nodes, asked_faces = asked
    ends = way[5]
    near_faces, near_edges = np.empty((1024, 4), dtype=np.int64), np.empty((1024, 4), dtype=np.int64)
    face_count, edge_count = 0, 0
    leaves = meeting_leaves(node_boxes, children, ranges, asked_nodes, parts, EVERY, strayed)
    for pair in range(len(leaves)):
        a, b = leaves[pair]
        for i in range(ranges[a, 0], ranges[a, 1]):
            f = order[i]
            for j in range(i + 1 if a == b else ranges[b, 0], ranges[b, 1]):
                g = order[j]
                if not (asked_faces[f] or asked_faces[g]) or not boxes_meet(face_boxes, f, face_boxes, g):
                    continue
                if _share_a_vertex(faces, f, g):
                    continue
                if strayed is not None and boxes_within(strayed[1][1], f, g, strayed[3]):
                    continue
                one, other = (faces[f, 0], faces[f, 1], faces[f, 2]), (faces[g, 0], faces[g, 1], faces[g, 2])
                if one[0] >= way[4] and _beside(other, one, way):
                    continue
                if other[0] >= way[4] and _beside(one, other, way):
                    continue
                mixed = one[0] >= way[4] or other[0] >= way[4]
                begun, ended = (way[6], way[7]) if mixed else (way[2], way[3])
                if _apart(ends, one, other, begun, ended):
                    continue
                for first, second, corners in ((f, g, other), (g, f, one)):
                    for k in range(3):
                        v = owned_vertices[first, k]
                        if v < 0 or not (among[v] or asked_faces[second]):
                            continue
                        if strayed is not None and together(strayed[0], (v,), corners, strayed[3]):
                            continue
                        if not _apart(ends, (v,), corners, begun, ended):
                            near_faces = with_room(near_faces, face_count)
                            near_faces[face_count, 0] = v
                            copy_row(faces[second], near_faces[face_count, 1:])
                            face_count += 1
                for k in range(3):
                    p = owned_edges[f, k]
                    if p < 0:
                        continue
                    side = edges[p, 0], edges[p, 1]
                    if _apart(ends, side, other, begun, ended):
                        continue
                    for m in range(3):
                        q = owned_edges[g, m]
                        if q < 0:
                            continue
                        if not (among[side[0]] or among[side[1]] or among[edges[q, 0]] or among[edges[q, 1]]):
                            continue
                        across = edges[q, 0], edges[q, 1]
                        if strayed is not None and together(strayed[0], side, across, strayed[3]):
                            continue
                        if not _apart(ends, side, across, begun, ended):
                            near_edges = with_room(near_edges, edge_count)
                            copy_row(edges[p], near_edges[edge_count, :2])
                            copy_row(edges[q], near_edges[edge_count, 2:])
                            edge_count += 1
    return near_faces[:face_count], near_edges[:edge_count]


@compiled
def _apart(ends: np.ndarray, one: tuple, other: tuple, begun: float, ended: float) -> bool:
    """Whether elements of one to three corners each are apart along the line between their middles.

    By more than a distance `begun` [m] at the beginning of the moves and `ended` [m] at their end, of which the `ends`
    (vertices, 6) [m] are; in between by what lies between these, for along a line that stands still all is linear.
    """
    share, x, y, z = len(other) / len(one), 0.0, 0.0, 0.0
    for v in other:
        x, y, z = x + ends[v, 0] + ends[v, 3], y + ends[v, 1] + ends[v, 4], z + ends[v, 2] + ends[v, 5]
    for v in one:
        x -= share * (ends[v, 0] + ends[v, 3])
        y -= share * (ends[v, 1] + ends[v, 4])
        z -= share * (ends[v, 2] + ends[v, 5])
    far, far_after, near, near_after = -np.inf, -np.inf, np.inf, np.inf
    for v in one:
        far = max(far, x * ends[v, 0] + y * ends[v, 1] + z * ends[v, 2])
        far_after = max(far_after, x * ends[v, 3] + y * ends[v, 4] + z * ends[v, 5])
    for v in other:
        near = min(near, x * ends[v, 0] + y * ends[v, 1] + z * ends[v, 2])
        near_after = min(near_after, x * ends[v, 3] + y * ends[v, 4] + z * ends[v, 5])
    length = np.sqrt(x * x + y * y + z * z)
    return near - far > begun * length and near_after - far_after > ended * length


@compiled
def _beside(face: tuple, other: tuple, way: tuple) -> bool:
    """Whether another face, of three corners, stays on one side of the plane of a `face`.

    By more than a distance [m] at the beginning of the moves and another at their end, as the `way` says: vertices
    (vertices, 3) [m], moves (vertices, 3) [m], and last these two distances [m].
    """
    vertices, moves, begun, ended = way[0], way[1], way[6], way[7]
    a, b, c = face
    u, v, w = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    p, q, r = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    x, y, z = v * r - w * q, w * p - u * r, u * q - v * p
    length = np.sqrt(x * x + y * y + z * z)
    # The face lies in its plane until it moves.
    level = x * vertices[a, 0] + y * vertices[a, 1] + z * vertices[a, 2]
    low, high, after_low, after_high = np.inf, -np.inf, np.inf, -np.inf
    own_low, own_high = np.inf, -np.inf
    for corner in other:
        height = x * vertices[corner, 0] + y * vertices[corner, 1] + z * vertices[corner, 2] - level
        after = height + x * moves[corner, 0] + y * moves[corner, 1] + z * moves[corner, 2]
        low, high = min(low, height), max(high, height)
        after_low, after_high = min(after_low, after), max(after_high, after)
    for corner in face:
        rise = x * moves[corner, 0] + y * moves[corner, 1] + z * moves[corner, 2]
        own_low, own_high = min(own_low, rise), max(own_high, rise)
    above = low > begun * length and after_low - own_high > ended * length
    return above or (high < -begun * length and own_low - after_high > ended * length)


@compiled
def any_corner(elements: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Whether any corner of each of the `elements` (elements, corners) is `among` (vertices,).

    Args:
        elements: (elements, corners) int64.
        among: (vertices,) bool.
    """
    found = np.zeros(len(elements), dtype=np.bool_)
    for element in range(len(elements)):
        for corner in range(elements.shape[1]):
            found[element] = found[element] or among[elements[element, corner]]
    return found
