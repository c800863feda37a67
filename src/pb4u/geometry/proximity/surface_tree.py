"""A bounding-volume tree over a moving triangle surface: which vertices, edges and faces of it come near each other.

The tree is built once, from the rest shape, and its boxes are fitted to the positions of every search: cloth deforms,
but what is near on it stays near. Boxes bound displacements too. Two of them are followed through a move relative to
one another, so that cloth which is carried along by centimetres gives no more pairs than cloth at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pb4u.geometry.proximity.box_tree import EVERY, BoxTree, boxes_meet, boxes_of, copy_row, meeting_leaves, with_room
from pb4u.geometry.proximity.element_distance import compiled, fastest_approach, gather, nearest
from pb4u.threads import of_parts

_ROOM = 1.5e-3
"""How far [m] a vertex may go from where it was before what is near it is searched again."""

_MOST_LEAVING = 0.1
"""Share of the vertices that may leave their room before the whole surface is searched again."""

_FEW = 4096
"""Vertices up to which one thread searches: 6 ms, beside which it takes long to wake another processor."""

_HALVED = 2
"""How often the surface is halved for the parts that threads search: four pieces, and the three seams between them."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Pairs of elements that may come within a reach while no corner goes further than a room from where it was.

    Args:
        vertices: (vertices, 3) [m] where they were.
        reach: distance [m].
        vertex_faces: (pairs, 4) int64 the vertex and the face's corners.
        edge_edges: (pairs, 4) int64 the ends of both edges.
    """

    vertices: np.ndarray
    reach: float
    vertex_faces: np.ndarray
    edge_edges: np.ndarray


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
        """The pairs where `rows` (pairs,) bool holds."""
        return replace(
            self,
            corners=self.corners[rows],
            vertex_faces=int(rows[: self.vertex_faces].sum()),
            rest_distance=self.rest_distance[rows],
        )


class SurfaceTree:
    """Search for near pairs of elements of one surface.

    Args:
        rest: (vertices, 3) [m] from which the tree is built.
        faces: (faces, 3) int64.
        edges: (edges, 2) int64 of the faces.
        part: (vertices,) int64 part of the surface that each belongs to, such as a garment.
        world: (parts,) int64; parts of different worlds never meet.
    """

    def __init__(
        self, rest: np.ndarray, faces: np.ndarray, edges: np.ndarray, part: np.ndarray, world: Sequence[int]
    ) -> None:
        self.rest = np.ascontiguousarray(rest, dtype=np.float64)
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        self.part = np.ascontiguousarray(part, dtype=np.int64)
        self.edges = np.ascontiguousarray(edges, dtype=np.int64)
        face_part = self.part[self.faces[:, 0]]
        centres = self.rest[self.faces].mean(axis=1)
        self.vertex_world = np.asarray(world, dtype=np.int64)[self.part]
        self.boxes = BoxTree.over(centres, face_part, np.asarray(world))
        self._vertices = np.arange(len(self.rest))[:, None]
        self._owned_vertices, self._owned_edges = _owners(self.faces, self.edges, len(self.rest))

    @cached_property
    def _still(self) -> np.ndarray:
        return np.zeros_like(self.rest)

    @cached_property
    def _everywhere(self) -> np.ndarray:
        return np.ones(len(self.rest), dtype=bool)

    def pairs(
        self,
        vertices: np.ndarray,
        reach: float,
        moves: np.ndarray | None = None,
        known: ElementPairs | None = None,
    ) -> ElementPairs:
        """Pairs that may come within `reach` of one another, a superset of those that do.

        Without moves it is those that do; with moves, those that are no further apart than they can approach.

        Args:
            vertices: (vertices, 3) float64 [m].
            reach: distance [m].
            moves: (vertices, 3) float64 [m] linear motion along which they may come near, or None.
            known: pairs of positions a little before these, where there are such: only what went far since is searched.
        """
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        moving = self._still if moves is None else np.ascontiguousarray(moves, dtype=np.float64)
        neighbourhood, leaving = None, self._everywhere
        if known is not None:
            neighbourhood, leaving = self._neighbourhood(vertices, reach, moving, known.neighbourhood)
        found: Sequence[np.ndarray] = self._search(vertices, moving, 0.5 * reach, leaving)
        if neighbourhood is not None:
            stayed = (p[~_any_corner(p, leaving)] for p in (neighbourhood.vertex_faces, neighbourhood.edge_edges))
            found = [np.concatenate(parts) for parts in zip(stayed, found, strict=True)]
        # Boxes of long edges across each other meet long before the edges do.
        vertex_faces, edge_edges = (
            corners[_mayboxes_meet(vertices, moving, corners, kind, reach)]
            for corners, kind in zip(found, (True, False), strict=True)
        )
        corners = np.concatenate([vertex_faces, edge_edges])
        rest = _rest_distances(self.rest, self.part, corners, len(vertex_faces))
        return ElementPairs(corners, len(vertex_faces), rest, neighbourhood)

    def _neighbourhood(
        self, vertices: np.ndarray, reach: float, moves: np.ndarray, known: Neighbourhood | None
    ) -> tuple[Neighbourhood | None, np.ndarray]:
        """The `known` neighbourhood, a new one or none, and which vertices (vertices,) leave their room in it."""
        most = _MOST_LEAVING * len(vertices)
        if known is not None and known.reach == reach:
            leaving = _leaving(known.vertices, vertices, moves)
            if leaving.sum() <= most:
                return known, leaving
        leaving = _leaving(vertices, vertices, moves)
        if leaving.sum() > most:
            return None, self._everywhere
        found = self._search(vertices, self._still, 0.5 * reach + _ROOM, self._everywhere)
        return Neighbourhood(vertices.copy(), reach, *found), leaving

    def _search(
        self, vertices: np.ndarray, moves: np.ndarray, margin: float, among: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Corners (pairs, 4) of vertex and face, and of two edges, that have one `among` these vertices and may meet.

        Whose boxes meet that are wider by `margin` [m] on every side.
        """
        if not among.any():
            return np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4), dtype=np.int64)
        face_boxes, edge_boxes, vertex_boxes = (
            boxes_of(vertices, moves, corners, margin) for corners in (self.faces, self.edges, self._vertices)
        )
        boxes = (self.boxes.fitted(face_boxes), face_boxes, edge_boxes, vertex_boxes)
        elements = (self.faces, self.edges, self._owned_vertices, self._owned_edges)
        tree = self.boxes.arrays[:3]
        asked = (among, *_asked(tree, self.faces, self.edges, among))
        whole = np.count_nonzero(among) > _FEW
        parts = np.split(self._parts, range(1, len(self._parts))) if whole else [self._parts]
        found = of_parts(lambda part: _search(boxes, tree, elements, asked, part), parts)
        vertex_faces, edge_edges = (np.concatenate(pairs) for pairs in zip(*found, strict=True))
        return vertex_faces, edge_edges

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


@compiled
def _asked(
    tree: tuple, faces: np.ndarray, edges: np.ndarray, among: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which nodes, faces and edges have a vertex `among` (vertices,) those asked for."""
    order, children, ranges = tree
    asked_edges, asked_faces = _any_corner(edges, among), _any_corner(faces, among)
    asked_nodes = np.empty(len(children), dtype=np.bool_)
    for node in range(len(children) - 1, -1, -1):
        asked = False
        if children[node, 0] >= 0:
            asked = asked_nodes[children[node, 0]] or asked_nodes[children[node, 1]]
        else:
            for place in range(ranges[node, 0], ranges[node, 1]):
                asked = asked or asked_faces[order[place]]
        asked_nodes[node] = asked
    return asked_nodes, asked_faces, asked_edges


@compiled
def _search(
    boxes: tuple, tree: tuple, elements: tuple, asked: tuple, parts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (pairs, 4) of vertex and face, and of two edges, with one `asked` for and boxes that meet.

    Of the elements in the pairs of nodes `parts` (parts, 2).
    """
    order, children, ranges = tree
    faces, edges, owned_vertices, owned_edges = elements
    node_boxes, face_boxes, edge_boxes, vertex_boxes = boxes
    among, asked_nodes, asked_faces, asked_edges = asked
    near_faces, near_edges = np.empty((1024, 4), dtype=np.int64), np.empty((1024, 4), dtype=np.int64)
    face_count, edge_count = 0, 0
    leaves = meeting_leaves(node_boxes, children, ranges, asked_nodes, parts, EVERY)
    for pair in range(len(leaves)):
        a, b = leaves[pair]
        for i in range(ranges[a, 0], ranges[a, 1]):
            f = order[i]
            for j in range(i + 1 if a == b else ranges[b, 0], ranges[b, 1]):
                g = order[j]
                if not (asked_faces[f] or asked_faces[g]) or not boxes_meet(face_boxes[f], face_boxes[g]):
                    continue
                for one, two in ((f, g), (g, f)):
                    for k in range(3):
                        v = owned_vertices[one, k]
                        if v < 0 or v == faces[two, 0] or v == faces[two, 1] or v == faces[two, 2]:
                            continue
                        if (among[v] or asked_faces[two]) and boxes_meet(vertex_boxes[v], face_boxes[two]):
                            near_faces = with_room(near_faces, face_count)
                            near_faces[face_count, 0] = v
                            copy_row(faces[two], near_faces[face_count, 1:])
                            face_count += 1
                for k in range(3):
                    p = owned_edges[f, k]
                    if p < 0 or not boxes_meet(edge_boxes[p], face_boxes[g]):
                        continue
                    for m in range(3):
                        q = owned_edges[g, m]
                        if q < 0 or edges[p, 0] == edges[q, 0] or edges[p, 0] == edges[q, 1]:
                            continue
                        if edges[p, 1] == edges[q, 0] or edges[p, 1] == edges[q, 1]:
                            continue
                        if (asked_edges[p] or asked_edges[q]) and boxes_meet(edge_boxes[p], edge_boxes[q]):
                            near_edges = with_room(near_edges, edge_count)
                            copy_row(edges[p], near_edges[edge_count, :2])
                            copy_row(edges[q], near_edges[edge_count, 2:])
                            edge_count += 1
    return near_faces[:face_count], near_edges[:edge_count]


@compiled
def _any_corner(elements: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Whether any corner of each of the `elements` (elements, corners) is `among` (vertices,)."""
    found = np.zeros(len(elements), dtype=np.bool_)
    for element in range(len(elements)):
        for corner in range(elements.shape[1]):
            found[element] = found[element] or among[elements[element, corner]]
    return found


@compiled
def _leaving(before: np.ndarray, vertices: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Whether each of the `vertices` (vertices, 3) [m] is, or gets by its move, out of its room around `before`."""
    leaving = np.empty(len(vertices), dtype=np.bool_)
    for row in range(len(vertices)):
        first, last = 0.0, 0.0
        for axis in range(3):
            way = vertices[row, axis] - before[row, axis]
            first += way * way
            last += (way + moves[row, axis]) ** 2
        leaving[row] = max(first, last) > _ROOM * _ROOM
    return leaving


@compiled
def _mayboxes_meet(
    vertices: np.ndarray, moves: np.ndarray, corners: np.ndarray, vertex_face: bool, reach: float
) -> np.ndarray:
    """Whether each pair (pairs,) is no further apart than `reach` and what it may approach by the moves."""
    points, way, weights, between = np.empty((4, 3)), np.empty((4, 3)), np.empty(4), np.empty(3)
    near = np.empty(len(corners), dtype=np.bool_)
    for pair in range(len(corners)):
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


@compiled
def _rest_distances(rest: np.ndarray, part: np.ndarray, corners: np.ndarray, vertex_faces: int) -> np.ndarray:
    """Distances (pairs,) [m] at rest of pairs of one part, infinite between two."""
    count = len(corners)
    distances = np.full(count, np.inf)
    points, weights, between = np.empty((4, 3)), np.empty(4), np.empty(3)
    for pair in range(count):
        if part[corners[pair, 0]] == part[corners[pair, 2]]:
            gather(rest, corners[pair], points)
            distances[pair] = nearest(points, pair < vertex_faces, weights, between)
    return distances
