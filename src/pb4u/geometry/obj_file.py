"""Wavefront OBJ files, read and written with vertex order, polygons and UVs as their author left them.

trimesh splits quads and n-gons into triangles and splits vertices at UV seams even with process=False, so it cannot
give the author's mesh back; what is needed of OBJ (v, vt, f) is read here.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pb4u.errors import InputError, on_disk, warn
from pb4u.geometry.appearance import Appearance, Appearances, read_mtl, write_mtl
from pb4u.geometry.mesh_file import PolygonMesh, named_pieces
from pb4u.io.atomic_file import replace_file
from pb4u.io.mtl_file import joined_lines, named_libraries, text_of

_LARGEST = 1e9
"""Coordinates beyond which products of areas lose all digits; no unit of length makes a garment so large."""
Lines = list[tuple[int, bytes]]
"""Lines of a file with their numbers, from 1."""


class _Content(NamedTuple):
    """Lines of a file; of a face also the vertices and texture coordinates before it.

    Of `usemtl`, `o` and `g` the faces before it and the name.
    """

    vertices: Lines
    uvs: Lines
    faces: list[tuple[int, bytes, int, int]]
    used: list[tuple[int, str]]
    lines: list[tuple[int, bytes, int]]
    groups: dict[str, list[tuple[int, str]]]


def read_obj(path: Path) -> PolygonMesh:
    """The mesh of an OBJ file, all objects and groups together, with colours and images of its MTL.

    Args:
        path: the file.

    Raises:
        InputError: a number cannot be read, a vertex is not finite, an index is out of range (naming the line), or the
            file has no faces.
        OSError: the file cannot be read.
    """
    content = _content(path)
    vertices = _table(path, content.vertices, 3, "vertex")
    uvs = _table(path, content.uvs, 2, "texture coordinate")
    if not content.faces:
        raise InputError(f"{path} has no faces ({len(vertices)} vertices): export it as a polygon mesh.")
    corners, uv_corners, ends = _corners(path, content.faces)
    _refuse_out_of_range(path, content.faces, corners, len(vertices), ends, "vertex")
    polygon_uvs = None
    if len(uvs) and not (uv_corners == -1).all():
        if (bare := uv_corners == -1).any():
            # Buttons without UVs beside textured cloth: they lie at one point of it.
            uv_corners, uvs = np.where(bare, len(uvs), uv_corners), np.concatenate([uvs, np.zeros((1, 2))])
        _refuse_out_of_range(path, content.faces, uv_corners, len(uvs), ends, "texture coordinate")
        polygon_uvs = tuple(np.split(uv_corners, ends[:-1]))
    starts, names = zip((0, ""), *content.used, strict=True)
    of_face = np.searchsorted(starts, np.arange(len(ends)), side="right") - 1
    looks = _appearances(path, names, of_face, polygon_uvs is not None)
    polygons = tuple(np.split(corners, ends[:-1]))
    pieces, laid = named_pieces(names, of_face), None if polygon_uvs is None else uvs
    lines, objects = _lines(content.lines, len(vertices)), _objects(content, len(ends))
    return PolygonMesh(vertices, polygons, laid, polygon_uvs, looks, *pieces, lines, *objects)


def _objects(content: _Content, count: int) -> tuple[tuple[str, ...], np.ndarray | None]:
    """Names of the objects, or else of the groups, and the number of that of each of `count` faces."""
    begun = content.groups["o"] or content.groups["g"]
    if not begun:
        return (), None
    names = list(dict.fromkeys(["", *(name for _, name in begun)]))
    starts = np.array([0, *(start for start, _ in begun)])
    numbers = np.array([0, *(names.index(name) for _, name in begun)])
    return tuple(names), numbers[np.searchsorted(starts, np.arange(count), side="right") - 1]


def _appearances(path: Path, used: Sequence[str], of_face: np.ndarray, laid_on: bool) -> Appearances | None:
    """Appearances of faces, `of_face` (faces,) which of the `used` materials each has; images need `laid_on`."""
    library_looks: dict[str, Appearance] = {}
    for name, library in named_libraries(path):
        if library is not None:
            library_looks |= read_mtl(library)
        elif len(used) > 1:
            warn(f"{path.name}: the MTL file {name[:60]} is missing; put it beside the file to see its colours.")
    looks = [library_looks[name] for name in dict.fromkeys(used) if name in library_looks]
    if not looks:
        return None
    places = {look.name: k for k, look in enumerate(looks)}
    of_part = np.array([places.get(name, -1) for name in used])
    return Appearances(tuple(look if laid_on else replace(look, image=None) for look in looks), of_part[of_face])


def read_obj_vertices(path: Path) -> tuple[np.ndarray, bytes]:
    """Vertices of an OBJ file with a digest of its faces: much quicker than `read_obj`, which parses every face.

    Args:
        path: the file.

    Returns:
        Vertices (vertices, 3) float64 [m], and a digest of the text of the faces, equal where two files have the same.

    Raises:
        InputError: a number of a vertex cannot be read or is not finite.
        OSError: the file cannot be read.
    """
    content = _content(path)
    digest = hashlib.sha256(b"\n".join(line for _, line, _, _ in content.faces)).digest()
    return _table(path, content.vertices, 3, "vertex"), digest


def left_out(path: Path, mesh: PolygonMesh) -> list[str]:
    """Content of an OBJ file that is not in its mesh: groups, object names, vertex colours, materials without an MTL.

    Args:
        path: the file.
        mesh: the mesh read from it.

    Raises:
        OSError: the file cannot be read.
    """
    text = joined_lines(path)
    lines = {"groups": rb"g[ \t]+\S", "object names": rb"o[ \t]+\S", "vertex colours": rb"v([ \t]+[^\s#]+){6}"}
    kinds = [what for what, line in lines.items() if re.search(rb"(?m)^[ \t]*" + line, text)]
    used = {text_of(name.strip()) for name in re.findall(rb"(?m)^[ \t]*usemtl[ \t](.*)", text)}
    names = set() if mesh.appearances is None else {look.name for look in mesh.appearances.listed}
    return kinds + (["materials without an MTL"] if used - names - {"", "none"} else [])


def _content(path: Path) -> _Content:
    """Lines of vertices, texture coordinates and faces; continued lines count as one."""
    content = _Content([], [], [], [], [], {"o": [], "g": []})
    for number, line in enumerate(joined_lines(path).split(b"\n"), 1):
        line = line.lstrip()
        kind = line[:2]
        if kind in (b"v ", b"v\t"):
            content.vertices.append((number, line))
        elif kind in (b"f ", b"f\t"):
            # Negative indices count back from what has been read so far.
            content.faces.append((number, line, len(content.vertices), len(content.uvs)))
        elif kind in (b"l ", b"l\t"):
            content.lines.append((number, line, len(content.vertices)))
        elif kind == b"vt":
            content.uvs.append((number, line))
        elif kind in (b"o ", b"g ", b"o\t", b"g\t"):
            content.groups[kind[:1].decode()].append((len(content.faces), text_of(line[1:].strip())))
        elif line.startswith(b"usemtl"):
            content.used.append((len(content.faces), text_of(line[6:].strip())))
    return content


def _table(path: Path, lines: Lines, width: int, what: str) -> np.ndarray:
    """Numbers (lines, width) float64; `what` is what a line is."""
    try:
        values = np.array([line.split(None, width + 1)[1 : width + 1] for _, line in lines], dtype=bytes)
        table = values.reshape(len(lines), width).astype(np.float64)
    except ValueError:
        number = next(number for number, line in lines if not _readable(line, width))
        raise InputError(
            f"{path} line {number}: a {what} needs {width} numbers; repair it or export it again."
        ) from None
    bad = np.flatnonzero(~(np.abs(table) <= _LARGEST).all(axis=1))
    if len(bad):
        fault = (
            f"{len(bad)} {what} line(s) hold NaN or infinite numbers, or such above {_LARGEST:g}, first at "
            f"line {lines[bad[0]][0]} ({what} {bad[0] + 1})"
        )
        if width == 3:
            raise InputError(f"{path}: {fault}; delete or repair them and export again.")
        warn(f"{path.name}: {fault}; zero is used instead.")
        table[bad] = 0.0
    return table


def _readable(line: bytes, width: int) -> bool:
    try:
        return len([float(token) for token in line.split()[1 : width + 1]]) == width
    except ValueError:
        return False


def _corners(path: Path, faces: list[tuple[int, bytes, int, int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertex and UV indices (corners,) of all faces, a UV index -1 where there is none, and the end of each face."""
    vertex_index: list[int] = []
    uv_index: list[int] = []
    ends: list[int] = []
    for number, line, vertices, uvs in faces:
        tokens = line.split(b"#", 1)[0].split()[1:]
        try:
            for token in tokens:
                fields = token.split(b"/", 2)
                v = int(fields[0])
                vertex_index.append(v - 1 if v > 0 else v + vertices if v < 0 else -1)
                t = int(fields[1]) if len(fields) > 1 and fields[1] else 0
                uv_index.append(t - 1 if t > 0 else t + uvs if t < 0 else -1)
        except ValueError:
            raise InputError(
                f"{path} line {number}: the face index {_shown(token)} is not a whole number; export it again."
            ) from None
        if len(tokens) < 3:
            raise InputError(
                f"{path} line {number}: a face needs 3 corners or more, not {len(tokens)}; export it again."
            )
        ends.append(len(vertex_index))
    try:
        return np.array(vertex_index, dtype=np.int64), np.array(uv_index, dtype=np.int64), np.array(ends)
    except OverflowError:
        raise InputError(f"{path}: a face index has 19 digits or more; export it again.") from None


def _lines(rows: list[tuple[int, bytes, int]], count: int) -> np.ndarray | None:
    """Vertices (lines, 2) that polylines join one by one, those alone that can be read; None where there are none."""
    pairs: list[tuple[int, int]] = []
    for _, line, before in rows:
        fields = [token.split(b"/", 1)[0] for token in line.split(b"#", 1)[0].split()[1:]]
        try:
            ends = [int(field) for field in fields]
        except ValueError:
            continue
        ends = [end - 1 if end > 0 else end + before for end in ends]
        pairs += [(a, b) for a, b in pairwise(ends) if 0 <= a < count and 0 <= b < count]
    return np.array(pairs, dtype=np.int64) if pairs else None


def _refuse_out_of_range(
    path: Path, faces: list[tuple[int, bytes, int, int]], corners: np.ndarray, count: int, ends: np.ndarray, what: str
) -> None:
    bad = np.flatnonzero((corners < 0) | (corners >= count))
    if len(bad):
        number, text, *_ = faces[int(np.searchsorted(ends, bad[0], side="right"))]
        raise InputError(
            f"{path} line {number}: face {_shown(text)} names a {what} out of range, the file has {count}; "
            "export it again."
        )


def _shown(text: bytes) -> str:
    return f'"{text.strip()[:60].decode("utf-8", "replace")}"'


def write_obj(path: Path, mesh: PolygonMesh, groups: Sequence[str] = (), seams: np.ndarray | None = None) -> None:
    """Write a mesh in one step: the file appears complete or not at all.

    Its colours and images are written beside it, as NAME.pb4u.mtl and NAME.texture0.png.

    Args:
        path: the file.
        mesh: to write, numbers to nine digits.
        groups: group of each polygon, or none.
        seams: (edges, 2) int64 vertices of edges that are written as lines of the group `seams`.

    Raises:
        InputError: the file cannot be written.
    """
    looks = None if mesh.appearances is None else mesh.appearances.named_apart()
    names = [""] * len(mesh.polygons)
    parts = [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.vertices.tolist()]
    if looks is not None:
        mtl = path.with_name(f"{path.stem}.pb4u.mtl")
        parts.insert(0, f"mtllib {mtl.name}\n")
        of_face = looks.of_face.tolist()
        for k in np.flatnonzero(np.diff(looks.of_face, prepend=-2)).tolist():
            names[k] = f"usemtl {looks.listed[of_face[k]].name if of_face[k] >= 0 else 'none'}\n"
    for k, group in enumerate(groups):
        if k == 0 or group != groups[k - 1]:
            names[k] += f"g {group}\n"
    if mesh.uvs is not None and mesh.polygon_uvs is not None:
        parts += [f"vt {u:.9g} {v:.9g}\n" for u, v in mesh.uvs.tolist()]
        for name, polygon, corners in zip(names, mesh.polygons, mesh.polygon_uvs, strict=True):
            joined = " ".join(f"{v + 1}/{t + 1}" for v, t in zip(polygon.tolist(), corners.tolist(), strict=True))
            parts.append(f"{name}f {joined}\n")
    else:
        parts += [
            f"{name}f " + " ".join(str(v + 1) for v in polygon.tolist()) + "\n"
            for name, polygon in zip(names, mesh.polygons, strict=True)
        ]
    for lines, heading in ((mesh.lines, []), (seams, ["g seams\n"])):
        if lines is not None:
            parts += [*heading, *(f"l {a} {b}\n" for a, b in (lines + 1).tolist())]
    with on_disk(f"{path} cannot be written"):
        if looks is not None:
            write_mtl(mtl, looks.listed)
        replace_file(path, "".join(parts).encode())


def group_name(name: str) -> str:
    """A valid name of an OBJ group: a space would begin another group, and the format states no encoding.

    Args:
        name: any text.
    """
    return "_".join(name.encode("ascii", "replace").decode().split()) or "unnamed"
