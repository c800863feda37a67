"""Grain: which way the warp of the cloth runs on each face of a garment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.source_map import nearest_places
from pb4u.geometry.triangle_mesh import carried_directions, face_areas, face_cross_products
from pb4u.geometry.triangulation import triangulate

_OUT_OF_SCALE = 0.05
"""Mean deviation of the areas of faces up to which UVs are in metres: those of packed islands are far beyond."""

_ACROSS, _ROUNDS = 0.2, 20
"""Sine of the angle to the normal below which a direction says nothing of a face, which then follows its neighbours,
and rounds in which the nearest that it does say something of are reached."""


def grained(garment: Garment, direction: Sequence[float] | None = None) -> Garment:
    """The garment with its warp along the second axis of `rest_uv`, where anything says how it runs.

    A garment cut of flat panels has a grain. For others `direction` gives it, or else the second axis of UVs in metres:
    those of a pattern, not of a packed texture.

    Args:
        garment: as worn at rest.
        direction: of the warp in that position (3,), in any unit; None if not given.

    Raises:
        InputError: a direction is given for a garment that has a grain.
    """
    if garment.has_grain:
        if direction is not None:
            raise InputError(f"{garment.name} is cut of flat panels, which already have a grain; leave out --grain.")
        return garment
    ways = _ways_of_uvs(garment) if direction is None else _projected(garment, np.asarray(direction, dtype=np.float64))
    if ways is None:
        return garment
    rest = garment.rest_shape
    x, y = carried_directions(ways, garment.vertices[garment.faces], rest).T
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = np.stack([y, x, -x, y], axis=1).reshape(-1, 2, 2) / np.hypot(x, y)[:, None, None]
    return replace(garment, rest_uv=rest @ np.where(np.isfinite(turns), turns, np.eye(2)), grainless=False)


def _ways_of_uvs(garment: Garment) -> np.ndarray | None:
    """Directions (faces, 3) up the author's UVs; None where there are none in metres."""
    if garment.uvs is not None and garment.uv_faces is not None:
        corners, flat = garment.vertices[garment.faces], garment.uvs[garment.uv_faces]
    elif garment.source is not None and (mesh := garment.source.source).uvs is not None:
        assert mesh.polygon_uvs is not None
        at = triangulate(mesh.vertices, mesh.polygons)[0]
        corners = mesh.vertices[np.concatenate(mesh.polygons)[at]]
        flat = mesh.uvs[np.concatenate(mesh.polygon_uvs)[at]]
    else:
        return None
    points, faces = corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
    areas = face_areas(points, faces)
    uv_areas = face_areas(np.pad(flat.reshape(-1, 2), ((0, 0), (0, 1))), faces)
    if not np.abs(uv_areas - areas).sum() <= _OUT_OF_SCALE * areas.sum():
        return None
    ways = carried_directions(np.tile([0.0, 1.0], (len(flat), 1)), flat, corners)
    if len(corners) == len(garment.faces) and garment.uvs is not None:
        return ways
    return ways[nearest_places(garment.vertices[garment.faces].mean(axis=1), points, faces)[0]]


def _projected(garment: Garment, direction: np.ndarray) -> np.ndarray:
    """A direction (3,) in the plane of each face (faces, 3)."""
    normals = face_cross_products(garment.vertices, garment.faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    unit = direction / np.linalg.norm(direction)
    ways = unit - (normals @ unit)[:, None] * normals
    one, other = garment.topology.hinge_faces.T
    for _ in range(_ROUNDS):
        unsaid = np.linalg.norm(ways, axis=1) < _ACROSS
        if not unsaid.any():
            break
        sums = np.zeros_like(ways)
        np.add.at(sums, np.concatenate([one, other]), ways[np.concatenate([other, one])])
        ways = np.where(unsaid[:, None], sums - (sums * normals).sum(axis=1, keepdims=True) * normals, ways)
    return ways
