"""Which elements of a surface may come near each other on a move: the search through its tree, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pb4u.collision.box_tree import Boxes, BoxTree, boxes_meet, copy_row, with_room
from pb4u.collision.element_distance import Reaches
from pb4u.collision.jit import compiled
from pb4u.collision.surface_elements import Elements, any_corner, share_a_vertex

_DEEPEST = 1024
"""Entries of the stack of a search: a median split halves, so that 2^60 faces would not fill it."""

EVERY = 2**62
"""Most pairs of leaves of a search that gives up on no cloth."""


class Query(NamedTuple):
    """What of a surface has some of its vertices.

    Args:
        vertices: (vertices,) bool.
        nodes: (nodes,) bool of the tree.
        faces: (faces,) bool.
    """

    vertices: np.ndarray
    nodes: np.ndarray
    faces: np.ndarray


class Sweep(NamedTuple):
    """A move on which elements may come near.

    Args:
        vertices: (vertices, 3) [m] where it begins.
        moves: (vertices, 3) [m], linear.
        ends: (vertices, 6) [m] where it begins and where it ends.
        reaches: how near they have to come.
        slack: by how much further apart [m] they may be at its end.
    """

    vertices: np.ndarray
    moves: np.ndarray
    ends: np.ndarray
    reaches: Reaches
    slack: float


@compiled
def query_of(tree: BoxTree, faces: np.ndarray, among: np.ndarray) -> Query:
    """What of a tree has a vertex `among` (vertices,) the given ones.

    Args:
        tree: of the surface.
        faces: (faces, 3) int64.
        among: (vertices,) bool.
    """
    asked_faces = any_corner(faces, among)
    asked_nodes = np.empty(len(tree.children), dtype=np.bool_)
    for node in range(len(tree.children) - 1, -1, -1):
        asked = False
        if tree.children[node, 0] >= 0:
            asked = asked_nodes[tree.children[node, 0]] or asked_nodes[tree.children[node, 1]]
        else:
            for place in range(tree.ranges[node, 0], tree.ranges[node, 1]):
                asked = asked or asked_faces[tree.order[place]]
        asked_nodes[node] = asked
    return Query(among, asked_nodes, asked_faces)


@compiled
def meeting_leaves(
    boxes: Boxes, tree: BoxTree, asked: Query, others: Query, parts: np.ndarray, most: int
) -> np.ndarray:
    """Pairs (pairs, 2) of leaves whose boxes meet, of which one is `asked` for and the other of `others`; each once.

    A leaf meets itself. Of the nodes below the pairs of nodes `parts` (parts, 2). None where there are over `most`.

    Args:
        boxes: of the nodes.
        tree: of the surface.
        asked: elements to look for.
        others: with which it may meet.
        parts: (parts, 2) int64 pairs of nodes to begin with.
        most: number of pairs above which none are returned.
    """
    children, ranges = tree.children, tree.ranges
    found, count = np.empty((1024, 2), dtype=np.int64), 0
    stack = np.empty((_DEEPEST, 2), dtype=np.int64)
    for part in range(len(parts)):
        stack[0, 0], stack[0, 1] = parts[part, 0], parts[part, 1]
        depth = 1
        while depth > 0:
            depth -= 1
            a, b = stack[depth, 0], stack[depth, 1]
            if not ((asked.nodes[a] and others.nodes[b]) or (asked.nodes[b] and others.nodes[a])):
                continue
            inner_a, inner_b = children[a, 0] >= 0, children[b, 0] >= 0
            if a == b:
                if inner_a:
                    left, right = children[a, 0], children[a, 1]
                    stack[depth, 0], stack[depth, 1] = left, left
                    stack[depth + 1, 0], stack[depth + 1, 1] = right, right
                    stack[depth + 2, 0], stack[depth + 2, 1] = left, right
                    depth += 3
                    continue
            elif not boxes_meet(boxes.nodes, a, boxes.nodes, b):
                continue
            elif inner_a or inner_b:
                if inner_a and (not inner_b or ranges[a, 1] - ranges[a, 0] >= ranges[b, 1] - ranges[b, 0]):
                    stack[depth, 0], stack[depth, 1] = children[a, 0], b
                    stack[depth + 1, 0], stack[depth + 1, 1] = children[a, 1], b
                else:
                    stack[depth, 0], stack[depth, 1] = a, children[b, 0]
                    stack[depth + 1, 0], stack[depth + 1, 1] = a, children[b, 1]
                depth += 2
                continue
            if count == most:
                return found[:0]
            found = with_room(found, count)
            found[count, 0], found[count, 1] = a, b
            count += 1
    return found[:count]


@compiled
def near_elements(
    boxes: Boxes,
    tree: BoxTree,
    elements: Elements,
    asked: Query,
    others: Query,
    parts: np.ndarray,
    way: Sweep,
) -> tuple[np.ndarray, np.ndarray]:
    """Corners (pairs, 4) of vertex and face, and of two edges, that may come near on a way and whose boxes meet.

    Of faces that share no vertex. What is certainly `_apart` or `_beside` is left out.

    Args:
        boxes: of the nodes and faces.
        tree: of the surface.
        elements: of the surface.
        asked: vertices, of which each pair has one.
        others: of whose faces the other is.
        parts: (parts, 2) int64 pairs of nodes that are searched.
        way: on which they may come near.
    """
    order, ranges = tree.order, tree.ranges
    faces, edges, own_vertices, own_edges = elements
    ends, first_obstacle = way.ends, way.reaches.first_obstacle
    near_faces, near_edges = np.empty((1024, 4), dtype=np.int64), np.empty((1024, 4), dtype=np.int64)
    face_count, edge_count = 0, 0
    leaves = meeting_leaves(boxes, tree, asked, others, parts, EVERY)
    for pair in range(len(leaves)):
        a, b = leaves[pair]
        for i in range(ranges[a, 0], ranges[a, 1]):
            f = order[i]
            for j in range(i + 1 if a == b else ranges[b, 0], ranges[b, 1]):
                g = order[j]
                if not ((asked.faces[f] and others.faces[g]) or (asked.faces[g] and others.faces[f])):
                    continue
                mixed = faces[f, 0] >= first_obstacle or faces[g, 0] >= first_obstacle
                # Most faces of cloth whose boxes meet are neighbours; with obstacles it has no vertex in common.
                if not mixed and share_a_vertex(faces, f, g):
                    continue
                if not boxes_meet(boxes.faces, f, boxes.faces, g):
                    continue
                one, other = (faces[f, 0], faces[f, 1], faces[f, 2]), (faces[g, 0], faces[g, 1], faces[g, 2])
                if one[0] >= first_obstacle and _beside(other, one, way):
                    continue
                if other[0] >= first_obstacle and _beside(one, other, way):
                    continue
                begun = way.reaches.obstacle if mixed else way.reaches.cloth
                ended = begun + way.slack
                if _apart(ends, one, other, begun, ended):
                    continue
                for first, second, corners in ((f, g, other), (g, f, one)):
                    for k in range(3):
                        v = own_vertices[first, k]
                        if v < 0 or not (asked.vertices[v] or asked.faces[second]):
                            continue
                        if not _apart(ends, (v,), corners, begun, ended):
                            near_faces = with_room(near_faces, face_count)
                            near_faces[face_count, 0] = v
                            copy_row(faces[second], near_faces[face_count, 1:])
                            face_count += 1
                for k in range(3):
                    p = own_edges[f, k]
                    if p < 0:
                        continue
                    side = edges[p, 0], edges[p, 1]
                    if _apart(ends, side, other, begun, ended):
                        continue
                    for m in range(3):
                        q = own_edges[g, m]
                        if q < 0:
                            continue
                        if not (
                            asked.vertices[side[0]]
                            or asked.vertices[side[1]]
                            or asked.vertices[edges[q, 0]]
                            or asked.vertices[edges[q, 1]]
                        ):
                            continue
                        across = edges[q, 0], edges[q, 1]
                        if not _apart(ends, side, across, begun, ended):
                            near_edges = with_room(near_edges, edge_count)
                            copy_row(edges[p], near_edges[edge_count, :2])
                            copy_row(edges[q], near_edges[edge_count, 2:])
                            edge_count += 1
    return near_faces[:face_count], near_edges[:edge_count]


@compiled
def near_around(
    listed: np.ndarray, starts: np.ndarray, vertex_face: bool, asked: np.ndarray, among: np.ndarray, way: Sweep
) -> np.ndarray:
    """Corners (pairs, 4) of those `listed` that may come near on a way, as in `near_elements`.

    Args:
        listed: (pairs, 4) int32, by the vertex around which they are.
        starts: (vertices + 1,) int64 first pair around each vertex, and the total.
        vertex_face: whether they are of a vertex and a face, else of two edges.
        asked: (n,) int64 vertices around which they are looked for.
        among: (vertices,) bool of which each pair has one.
        way: on which they may come near.
    """
    begun, ended = way.reaches.cloth, way.reaches.cloth + way.slack
    near, count = np.empty((64, 4), dtype=np.int64), 0
    for vertex in asked:
        for pair in range(starts[vertex], starts[vertex + 1]):
            a, b, c, d = listed[pair, 0], listed[pair, 1], listed[pair, 2], listed[pair, 3]
            if not (among[a] or among[b] or among[c] or among[d]):
                continue
            if vertex_face:
                apart = _apart(way.ends, (a,), (b, c, d), begun, ended)
            else:
                apart = _apart(way.ends, (a, b), (c, d), begun, ended)
            if not apart:
                near = with_room(near, count)
                near[count, 0], near[count, 1], near[count, 2], near[count, 3] = a, b, c, d
                count += 1
    return near[:count]


@compiled
def beside(edges: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Vertices (n,) int64 that are `among` (vertices,) the given ones, or have one of them at the other end of an edge.

    Args:
        edges: (edges, 2) int64.
        among: (vertices,) bool.
    """
    found = among.copy()
    for edge in range(len(edges)):
        a, b = edges[edge, 0], edges[edge, 1]
        found[a] = found[a] or among[b]
        found[b] = found[b] or among[a]
    return np.flatnonzero(found)


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
def _beside(face: tuple, other: tuple, way: Sweep) -> bool:
    """Whether another face, of three corners, stays on one side of the plane of a `face`.

    By more than the reach from an obstacle on the `way`.
    """
    vertices, moves = way.vertices, way.moves
    begun, ended = way.reaches.obstacle, way.reaches.obstacle + way.slack
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
