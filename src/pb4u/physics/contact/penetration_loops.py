"""The loops of the penetration clean-up over vertices, elements and edges, compiled."""

from __future__ import annotations

import numpy as np

from pb4u.collision.jit import compiled
from pb4u.collision.nearest_points import Found

_HALVINGS = 8
"""Times that a move which would strain cloth too far is shortened before it is given up there."""

_ROUNDING = 1.0 + 1e-9
"""Factor on a squared length within which it is the same."""


@compiled
def vertices_within(
    vertices: np.ndarray, faces: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (places, 3) [m] of faces in a box, and their unit normals (places, 3), weighted by area.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3); vertices without a face are left out.
        low: (3,) [m] lowest corner of the box.
        high: (3,) [m] highest corner.
    """
    inside = np.empty(len(vertices), dtype=np.bool_)
    for row in range(len(vertices)):
        inside[row] = True
        for axis in range(3):
            inside[row] &= low[axis] <= vertices[row, axis] <= high[axis]
    sums, used = np.zeros(vertices.shape), np.zeros(len(vertices), dtype=np.bool_)
    for face in range(len(faces)):
        a, b, c = faces[face]
        if not (inside[a] or inside[b] or inside[c]):
            continue
        for axis in range(3):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            across = (vertices[b, i] - vertices[a, i]) * (vertices[c, j] - vertices[a, j])
            across -= (vertices[b, j] - vertices[a, j]) * (vertices[c, i] - vertices[a, i])
            sums[a, axis] += across
            sums[b, axis] += across
            sums[c, axis] += across
        used[a] = used[b] = used[c] = True
    rows = np.flatnonzero(inside & used)
    places, normals = vertices[rows], sums[rows]
    for row in range(len(rows)):
        length = np.sqrt(normals[row, 0] ** 2 + normals[row, 1] ** 2 + normals[row, 2] ** 2)
        for axis in range(3):
            normals[row, axis] /= max(length, 1e-30)
    return places, normals


@compiled
def carry_found(found: Found, went: np.ndarray, x: np.ndarray, faces: np.ndarray) -> None:
    """Discard results for faces that moved, and store the present positions of these.

    Args:
        found: results on the faces; changed.
        went: (faces,) bool.
        x: (vertices, 3) [m] where the vertices are now.
        faces: (faces, 3).
    """
    at, triangle, barycentric, positions = found.at, found.triangle, found.barycentric, found.positions
    for row in range(len(at)):
        if not went[triangle[row]]:
            continue
        a, b, c = faces[triangle[row]]
        for axis in range(3):
            at[row, axis] = np.nan
            positions[row, axis] = (
                barycentric[row, 0] * x[a, axis] + barycentric[row, 1] * x[b, axis] + barycentric[row, 2] * x[c, axis]
            )


@compiled
def add_lifts(
    direction: np.ndarray,
    size: np.ndarray,
    corners: np.ndarray,
    shares: np.ndarray,
    heights: np.ndarray,
    normals: np.ndarray,
) -> None:
    """Lift points of the cloth, each by the least displacement of its corners.

    Args:
        direction: (vertices, 3) [m] all lifts of a vertex summed; added to.
        size: (vertices,) [m] the largest lift; raised.
        corners: (points, corners) of the points.
        shares: (points, corners) with which the positions of the corners sum to a point.
        heights: (points,) [m] of the lifts.
        normals: (points, 3) unit vectors along which they go.
    """
    for row in range(len(corners)):
        squared = 0.0
        for k in range(corners.shape[1]):
            squared += shares[row, k] ** 2
        for k in range(corners.shape[1]):
            vertex, move = corners[row, k], heights[row] * shares[row, k] / squared
            size[vertex] = max(size[vertex], move)
            for axis in range(3):
                direction[vertex, axis] += move * normals[row, axis]


@compiled
def cut_back(
    before: np.ndarray, lifted: np.ndarray, shares: np.ndarray, edges: np.ndarray, longest: np.ndarray
) -> np.ndarray:
    """Positions (vertices, 3) [m] after shares of a lift.

    The share of vertices at edges that would be stretched too far, and more than before, is halved repeatedly and
    finally set to 0, until no such edge is left.

    Args:
        before: (vertices, 3) [m] at the start of the lift.
        lifted: (vertices, 3) [m] where it leads.
        shares: (vertices,) of the lift for each vertex; changed.
        edges: (edges, 2).
        longest: (edges,) [m] lengths to which they may be stretched.
    """
    x, overstretched = np.empty(before.shape), np.empty(len(before), dtype=np.bool_)
    # Each round after the halvings stops a vertex at least.
    for halving in range(_HALVINGS + len(before)):
        for row in range(len(x)):
            overstretched[row] = False
            for axis in range(3):
                x[row, axis] = before[row, axis] + shares[row] * (lifted[row, axis] - before[row, axis])
        for edge in range(len(edges)):
            a, b = edges[edge]
            if shares[a] == 0.0 and shares[b] == 0.0:
                continue
            was, now = 0.0, 0.0
            for axis in range(3):
                was += (before[a, axis] - before[b, axis]) ** 2
                now += (x[a, axis] - x[b, axis]) ** 2
            if now > max(longest[edge] ** 2, was * _ROUNDING):
                overstretched[a] = overstretched[b] = True
        if not overstretched.any():
            break
        for row in range(len(x)):
            if overstretched[row]:
                shares[row] = 0.5 * shares[row] if halving < _HALVINGS - 1 else 0.0
    return x


@compiled
def move_vertices(x: np.ndarray, direction: np.ndarray, size: np.ndarray, movable: np.ndarray, largest: float) -> bool:
    """Move vertices by what `add_lifts` gathered; whether any moved.

    Args:
        x: (vertices, 3) [m]; changed.
        direction: (vertices, 3) [m] sum gathered there.
        size: (vertices,) [m] maximum gathered there.
        movable: (vertices,) bool.
        largest: displacement [m] of a vertex at most.
    """
    moved = False
    for row in range(len(x)):
        length = np.sqrt(direction[row, 0] ** 2 + direction[row, 1] ** 2 + direction[row, 2] ** 2)
        if not movable[row] or length == 0.0:
            continue
        for axis in range(3):
            x[row, axis] += min(size[row], largest) * direction[row, axis] / length
        moved = moved or size[row] > 0.0
    return moved
