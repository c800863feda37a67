"""Remeshing of surfaces with open borders to a wanted number of even triangles (docs/design/programs.md)."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pb4u.collision.box_tree import BoxTree
from pb4u.errors import InputError, warn
from pb4u.geometry.edge_operations import (
    collapse_short_edges,
    cornerwise_normals,
    flip_edges,
    relax,
    split_long_edges,
)
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import face_areas

# Relative deviation from the wanted number of triangles at which the edge length is adjusted no more.
_COUNT_TOLERANCE = 0.02
# Share of its area that a remeshed surface keeps where nothing of it is lost; a coarse one cuts its corners.
_KEPT_AREA = 0.92
# A border that turns by more than this [rad] from one edge to the next has a corner, which stays where it is.
_SHARP_TURN = np.radians(50.0)
# Vertices up to which all that a step reads of them is in the cache: below, their order saves nothing.
_CACHED = 8192


class Surface(Protocol):
    """The shape that a remeshed surface keeps to."""

    def project(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Points moved on to the surface, near where they were.

        Args:
            points: (n, 3) [m].
            normals: (n, 3) unit normals that say on which side to stay.

        Returns:
            (n, 3) [m].
        """
        ...

    def project_border(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) [m] moved on to the border curves.

        Args:
            points: (n, 3) [m] near the border.
        """
        ...


def remesh(
    vertices: np.ndarray, faces: np.ndarray, triangles: int, surface: Surface | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The same surface with about `triangles` triangles of even size (within 2 %, see Botsch and Kobbelt 2004).

    Borders stay borders and sharp border corners stay where they are; pieces stay apart.

    Args:
        vertices: (vertices, 3) float64 [m].
        faces: (faces, 3) int64, a manifold, consistently oriented surface, open or closed, in one or more pieces.
        triangles: wanted number of triangles.
        surface: shape to keep to; the given mesh itself by default.

    Returns:
        Vertices (n, 3) float64 and faces (m, 3) int64, oriented as given.

    Raises:
        InputError: the surface is not manifold, or its borders cannot be kept with so few triangles.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if triangles < 4:
        raise InputError(f"A surface cannot be remeshed to {triangles} triangles: ask for more.")
    source = Topology(faces, len(vertices))
    _require_manifold(source)
    used = np.unique(faces)
    faces = np.searchsorted(used, faces)
    vertices = vertices[used]
    # A smooth surface has no corners of its own; those of its first mesh are accidents of meshing.
    smooth = surface is not None
    locked = np.zeros(len(vertices), dtype=bool) if smooth else _sharp_border_corners(vertices, faces)
    if surface is None:
        from pb4u.collision.mesh_surface import MeshSurface

        surface = MeshSurface(vertices, faces)
    area = float(face_areas(vertices, faces).sum())
    # The mean edge of a good mesh is a little shorter than that of as many equilateral triangles.
    length = 0.985 * float(np.sqrt(4.0 / np.sqrt(3.0) * area / triangles))

    vertices, faces, locked = _isotropic(vertices, faces, locked, length, surface, rounds=8)
    for _ in range(8):
        ratio = len(faces) / triangles
        if abs(ratio - 1.0) <= _COUNT_TOLERANCE:
            break
        length *= float(np.clip(np.sqrt(ratio), 0.7, 1.4))
        vertices, faces, locked = _isotropic(vertices, faces, locked, length, surface, rounds=3)
    vertices, faces = _polish(vertices, faces, locked, surface)
    if not smooth and (share := float(face_areas(vertices, faces).sum()) / area) < _KEPT_AREA:
        warn(
            f"Remeshed to {len(faces)} triangles only {100 * share:.0f} % of the area is left: layers closer to each "
            "other than an edge length, such as turned-up cuffs, are lost; ask for more triangles, or keep the mesh."
        )
    result = Topology(faces, len(vertices))
    if len(result.boundary_loops) != len(source.boundary_loops):
        raise InputError(
            f"{triangles} triangles are too few to keep the {len(source.boundary_loops)} borders of the surface: "
            "ask for more triangles."
        )
    if abs(len(faces) / triangles - 1.0) > 0.05:
        raise InputError(
            f"This surface cannot be meshed evenly with {triangles} triangles (the nearest possible count is "
            f"{len(faces)}): ask for a count closer to that."
        )
    return _in_order_of_place(vertices, faces) if len(vertices) > _CACHED else (vertices, faces)


def _in_order_of_place(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same mesh, what is near next to each other: a step reads memory in order, in three quarters of the time."""
    part = np.zeros(len(vertices), dtype=np.int64)
    order = BoxTree.over(vertices, part, part[:1]).order
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    faces = rank[faces]
    first = faces.argmin(axis=1)
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    return vertices[order], faces[np.lexsort(faces.T[::-1])]


def _require_manifold(topology: Topology) -> None:
    if len(topology.non_manifold_edges):
        a, b = topology.non_manifold_edges[0].tolist()
        raise InputError(
            f"{len(topology.non_manifold_edges)} edges have three or more faces (the first joins {a} and {b}); "
            "remeshing needs a manifold surface: separate or delete the extra faces."
        )
    if not topology.is_consistently_oriented:
        raise InputError("Neighbouring faces are wound in opposite ways: make the normals consistent before remeshing.")
    # A border vertex with two loops through it joins two fans of faces at a point.
    starts = topology.boundary_edges[:, 0]
    values, counts = np.unique(starts, return_counts=True)
    if (counts > 1).any():
        raise InputError(
            f"Vertex {int(values[counts > 1][0])} joins parts of the surface that touch only at that point: "
            f"split the vertex before remeshing."
        )


def _sharp_border_corners(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(vertices,) bool: border vertices where the border turns sharply."""
    locked = np.zeros(len(vertices), dtype=bool)
    for loop in Topology(faces, len(vertices)).boundary_loops:
        points = vertices[loop]
        before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        sine = np.linalg.norm(np.cross(before, after), axis=1)
        angle = np.arctan2(sine, np.einsum("ij,ij->i", before, after))
        locked[loop[angle > _SHARP_TURN]] = True
    return locked


def _isotropic(
    vertices: np.ndarray, faces: np.ndarray, locked: np.ndarray, length: float, surface: Surface, rounds: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    longest, shortest = 4.0 / 3.0 * length, 4.0 / 5.0 * length
    for _ in range(rounds):
        for _ in range(12):
            count = len(vertices)
            vertices, faces, locked = split_long_edges(vertices, faces, longest, locked)
            if len(vertices) == count:
                break
        for turn in range(40):
            vertices, faces, locked, removed = collapse_short_edges(vertices, faces, shortest, longest, locked, turn)
            if removed <= 0.01 * len(vertices):
                break
        faces = _flip_until_settled(vertices, faces)
        vertices = _relax_on(vertices, faces, locked, surface, passes=2)
    return vertices, faces, locked


def _flip_until_settled(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    for _ in range(8):
        faces, flipped = flip_edges(vertices, faces)
        if flipped <= 0.002 * len(faces):
            break
    return faces


def _relax_on(vertices: np.ndarray, faces: np.ndarray, locked: np.ndarray, surface: Surface, passes: int) -> np.ndarray:
    border = Topology(faces, len(vertices)).border_vertices
    for _ in range(passes):
        relaxed = relax(vertices, faces, locked)
        normals = cornerwise_normals(relaxed, faces)
        relaxed[~border] = surface.project(relaxed[~border], normals[~border])
        if border.any():
            relaxed[border] = surface.project_border(relaxed[border])
        relaxed[locked] = vertices[locked]
        vertices = relaxed
    return vertices


def _polish(
    vertices: np.ndarray, faces: np.ndarray, locked: np.ndarray, surface: Surface
) -> tuple[np.ndarray, np.ndarray]:
    """Relaxes and flips at a constant number of triangles."""
    for _ in range(3):
        faces = _flip_until_settled(vertices, faces)
        vertices = _relax_on(vertices, faces, locked, surface, passes=3)
    return vertices, faces
