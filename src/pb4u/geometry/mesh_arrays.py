"""Meshes that a program hands over as arrays or lists: each array checked, with one sentence on what is wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pb4u.errors import InputError


def as_numbers(owner: str, what: str, values: ArrayLike) -> np.ndarray:
    """Values as an array of numbers.

    Args:
        owner: name of the object they belong to, for the message.
        what: name of the values, for the message.
        values: array, or lists of equal length.

    Raises:
        InputError: they are not numbers, or lists of different lengths.
    """
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError(f"{owner}: its {what} are lists of different lengths; all rows need the same.") from None
    if array.dtype.kind not in "fiub":
        raise InputError(f"{owner}: its {what} must be numbers, not {array.dtype}.")
    return array


def checked_vertices(owner: str, vertices: ArrayLike) -> np.ndarray:
    """Vertices (vertices, 3) float64 [m].

    Args:
        owner: name of the object they belong to, for the message.
        vertices: array or lists of that shape.

    Raises:
        InputError: another shape, or a number that is not finite.
    """
    array = as_numbers(owner, "vertices", vertices)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        turned = "; transpose them" if array.ndim == 2 and array.shape[0] == 3 else ""
        raise InputError(f"{owner}: its vertices have the shape {array.shape}; it must be (vertices, 3){turned}.")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise InputError(f"{owner}: {len(bad)} vertices are NaN or infinite, the first of them {bad[:5].tolist()}.")
    return array.astype(np.float64, copy=False)


def checked_faces(owner: str, faces: ArrayLike, count: int, what: str = "faces") -> np.ndarray:
    """Faces (faces, 3) int64.

    Args:
        owner: name of the object they belong to, for the message.
        faces: array or lists of that shape.
        count: number of points that they may name, from 0.
        what: name of the faces, for the message.

    Raises:
        InputError: another shape, no whole numbers, or a vertex that does not exist.
    """
    array = as_numbers(owner, what, faces)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        cut = "; cut each quad into two triangles" if array.ndim == 2 and array.shape[1] == 4 else ""
        raise InputError(f"{owner}: its {what} have the shape {array.shape}; it must be (faces, 3){cut}.")
    if array.dtype.kind not in "iu":
        raise InputError(f"{owner}: its {what} must be whole numbers, not {array.dtype}.")
    bad = np.flatnonzero(((array < 0) | (array >= count)).any(axis=1))
    if len(bad):
        raise InputError(f"{owner}: face {bad[0]} is {array[bad[0]].tolist()}; indices run from 0 to {count - 1}.")
    return array.astype(np.int64, copy=False)


def checked_uvs(owner: str, uvs: ArrayLike, uv_faces: ArrayLike, faces: int) -> tuple[np.ndarray, np.ndarray]:
    """UV points (uv points, 2) and the corners of faces among them, (faces, 3) int64.

    Args:
        owner: name of the object they belong to, for the message.
        uvs: array or lists of that shape.
        uv_faces: array or lists of that shape.
        faces: number of faces.

    Raises:
        InputError: another shape, no whole numbers, or a point that does not exist.
    """
    points = as_numbers(owner, "uvs", uvs)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"{owner}: its uvs have the shape {points.shape}; it must be (uv points, 2).")
    corners = checked_faces(owner, uv_faces, len(points), "uv_faces")
    if len(corners) != faces:
        raise InputError(f"{owner}: it has {len(corners)} uv_faces for {faces} faces.")
    return points, corners


def checked_places(owner: str, what: str, places: ArrayLike, rows: int, count: int) -> np.ndarray:
    """Indices (rows,) int64 into a list.

    Args:
        owner: name of the object they belong to, for the message.
        what: name of the indices, for the message.
        places: indices, an array or list of that shape.
        rows: number of indices.
        count: entries of the list.

    Raises:
        InputError: another shape, no whole numbers, or an index out of range.
    """
    array = as_numbers(owner, what, places)
    if array.shape != (rows,) or array.dtype.kind not in "iu":
        raise InputError(f"{owner}: {what} must hold a whole number for each of its {rows} faces.")
    if rows and (array.min() < 0 or array.max() >= count):
        raise InputError(f"{owner}: {what} has {array.min()} to {array.max()}; entries run from 0 to {count - 1}.")
    return array.astype(np.int64, copy=False)
