"""Wavefront OBJ files, read and written with vertex order, polygons and UVs as their author left them.

trimesh splits quads and n-gons into triangles and splits vertices at UV seams even with process=False, so it cannot
give the author's mesh back; what is needed of OBJ (v, vt, f) is read here.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pb4u.atomic_file import replace_file
from pb4u.errors import InputError
from pb4u.geometry.mesh_file import PolygonMesh

_KINDS = {b"v ", b"f ", b"vt"}
Lines = list[tuple[int, bytes]]
"""Lines of a file with their numbers, from 1."""
FaceLine = tuple[int, bytes, int, int]
"""A face line with its number, and the vertices and texture coordinates before it."""


def read_obj(path: Path) -> PolygonMesh:
    """The mesh of an OBJ file, all objects and groups together.

    Args:
        path: the file.

    Raises:
        InputError: a number cannot be read, a vertex is not finite, an index is out of range (naming the line), or the
            file has no faces.
        OSError: the file cannot be read.
    """
    vertex_lines, uv_lines, face_lines = _scan(path)
    if not face_lines:
        raise InputError(f"{path} has no faces ({len(vertex_lines)} vertices): export it as a polygon mesh.")
    vertices = _numbers(path, vertex_lines, 3, "vertex")
    uvs = _numbers(path, uv_lines, 2, "texture coordinate") if uv_lines else None
    polygons, polygon_uvs = _polygons(path, face_lines, len(vertices), 0 if uvs is None else len(uvs))
    return PolygonMesh(vertices, polygons, None if polygon_uvs is None else uvs, polygon_uvs)


def read_obj_vertices(path: Path) -> tuple[np.ndarray, list[bytes]]:
    """Vertices of an OBJ file with its faces as text: much quicker than `read_obj`, which parses every face.

    Args:
        path: the file.

    Returns:
        Vertices (vertices, 3) float64 [m], and the text of the faces, equal where two files have the same ones.

    Raises:
        InputError: a number of a vertex cannot be read or is not finite.
        OSError: the file cannot be read.
    """
    vertex_lines, _, face_lines = _scan(path)
    return _numbers(path, vertex_lines, 3, "vertex"), [line for _, line, _, _ in face_lines]


def _scan(path: Path) -> tuple[Lines, Lines, list[FaceLine]]:
    """Lines of vertices, texture coordinates and faces."""
    vertex_lines: Lines = []
    uv_lines: Lines = []
    face_lines: list[FaceLine] = []
    for number, line in enumerate(path.read_bytes().replace(b"\\\n", b" ").replace(b"\\\r\n", b" ").split(b"\n"), 1):
        kind = line[:2]
        if kind not in _KINDS:
            line = line.lstrip()
            kind = line[:2]
        if kind == b"v " or kind == b"v\t":
            vertex_lines.append((number, line))
        elif kind == b"f " or kind == b"f\t":
            # Negative indices count back from what has been read so far.
            face_lines.append((number, line, len(vertex_lines), len(uv_lines)))
        elif kind == b"vt":
            uv_lines.append((number, line))
    return vertex_lines, uv_lines, face_lines


def write_obj(path: Path, mesh: PolygonMesh) -> None:
    """Write a mesh in one step: the file appears whole or not at all.

    Args:
        path: the file.
        mesh: what is written, numbers to nine digits.

    Raises:
        InputError: the file cannot be written.
    """
    parts = [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.vertices.tolist()]
    if mesh.uvs is not None and mesh.polygon_uvs is not None:
        parts += [f"vt {u:.9g} {v:.9g}\n" for u, v in mesh.uvs.tolist()]
        for polygon, corners in zip(mesh.polygons, mesh.polygon_uvs, strict=True):
            joined = " ".join(f"{v + 1}/{t + 1}" for v, t in zip(polygon.tolist(), corners.tolist(), strict=True))
            parts.append(f"f {joined}\n")
    else:
        parts += ["f " + " ".join(str(v + 1) for v in polygon.tolist()) + "\n" for polygon in mesh.polygons]
    try:
        replace_file(path, "".join(parts).encode())
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}.") from None


def _numbers(path: Path, lines: Lines, width: int, what: str) -> np.ndarray:
    """(lines, width) float64, the first numbers of each line. Raises InputError naming the first bad line."""
    try:
        values = np.array([line.split(None, width + 1)[1 : width + 1] for _, line in lines], dtype=bytes)
        table = values.reshape(len(lines), width).astype(np.float64)
    except ValueError:
        number = next(number for number, line in lines if not _readable(line, width))
        raise InputError(f"{path} line {number}: a {what} needs {width} numbers; mend or export it again.") from None
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}: {len(bad)} {what} line(s) hold NaN or infinite numbers, first at line {lines[bad[0]][0]} "
            f"({what} {bad[0] + 1}); delete or mend them and export again."
        )
    return table


def _readable(line: bytes, width: int) -> bool:
    try:
        return len([float(token) for token in line.split()[1 : width + 1]]) == width
    except ValueError:
        return False


def _polygons(
    path: Path, lines: Sequence[FaceLine], vertex_count: int, uv_count: int
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...] | None]:
    """Vertex indices of each polygon, and UV indices where every corner has one."""
    vertex_index: list[int] = []
    uv_index: list[int] = []
    sizes: list[int] = []
    for number, line, vertices_so_far, uvs_so_far in lines:
        tokens = line.split(b"#", 1)[0].split()[1:]
        sizes.append(len(tokens))
        try:
            for token in tokens:
                fields = token.split(b"/", 2)
                v = int(fields[0])
                vertex_index.append(v - 1 if v > 0 else v + vertices_so_far if v < 0 else -1)
                t = int(fields[1]) if len(fields) > 1 and fields[1] else 0
                uv_index.append(t - 1 if t > 0 else t + uvs_so_far if t < 0 else -1)
        except ValueError:
            raise InputError(f"{path} line {number}: the face index {_shown(token)} is not a whole number.") from None
        if len(tokens) < 3:
            raise InputError(f"{path} line {number}: a face needs 3 corners or more, not {len(tokens)}.")
    ends = np.cumsum(sizes)
    try:
        corners, uv_corners = (np.array(index, dtype=np.int64) for index in (vertex_index, uv_index))
    except OverflowError:
        raise InputError(f"{path}: a face index has 19 digits or more; export it again.") from None
    _refuse_out_of_range(path, corners, vertex_count, ends, lines, "vertex")
    polygons = _split(corners, ends)
    # Faces without a texture beside faces with one: there is no UV map of the whole garment then.
    if not uv_count or (uv_corners == -1).any():
        return polygons, None
    _refuse_out_of_range(path, uv_corners, uv_count, ends, lines, "texture coordinate")
    return polygons, _split(uv_corners, ends)


def _refuse_out_of_range(
    path: Path,
    corners: np.ndarray,
    count: int,
    ends: np.ndarray,
    lines: Sequence[FaceLine],
    what: str,
) -> None:
    bad = np.flatnonzero((corners < 0) | (corners >= count))
    if len(bad):
        line = lines[int(np.searchsorted(ends, bad[0], side="right"))]
        raise InputError(
            f"{path} line {line[0]}: face {_shown(line[1])} names a {what} out of range, the file has {count}; "
            "export it again."
        )


def _split(corners: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, ...]:
    stops = ends.tolist()
    return tuple(corners[a:b] for a, b in zip([0, *stops[:-1]], stops, strict=True))


def _shown(text: bytes) -> str:
    return f'"{text.strip()[:60].decode("utf-8", "replace")}"'
