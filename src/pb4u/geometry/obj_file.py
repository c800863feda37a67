"""Wavefront OBJ files, read and written with vertex order, polygons and UVs as their author left them.

trimesh splits quads and n-gons into triangles and splits vertices at UV seams even with process=False, so it cannot
give the author's mesh back; what is needed of OBJ (v, vt, f) is read here.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pb4u.errors import InputError
from pb4u.geometry.appearance import Appearance, Appearances, read_mtl, write_mtl
from pb4u.geometry.mesh_file import MOST_READ, PolygonMesh
from pb4u.io.atomic_file import replace_file

_KINDS = {b"v ", b"f ", b"vt", b"us", b"mt"}
_BLOCK = 1 << 22
"""Bytes of a file that are parsed at once: their lines take some twenty times as much while they are."""
_MOST_LINE = 1 << 22
"""Bytes of a line, its continuations included."""
_LARGEST = 1e9
"""Coordinates beyond which products of areas lose all digits; no unit of length makes a garment so large."""
_MOST_VERTICES = 2 * MOST_READ
Lines = list[tuple[int, bytes]]
"""Lines of a file with their numbers, from 1."""


class _Block(NamedTuple):
    """Lines of a part of a file; of a face also the vertices and texture coordinates before it in the part.

    Of `usemtl` and `mtllib` the name, with the faces before it in the part.
    """

    vertices: Lines
    uvs: Lines
    faces: list[tuple[int, bytes, int, int]]
    used: list[tuple[int, str]]
    libraries: list[str]


def read_obj(path: Path) -> PolygonMesh:
    """The mesh of an OBJ file, all objects and groups together, with colours and images of its MTL.

    Args:
        path: the file.

    Raises:
        InputError: a number cannot be read, a vertex is not finite, an index is out of range (naming the line), or the
            file has no faces or too many vertices.
        OSError: the file cannot be read.
    """
    vertices, uvs = _Table(path, 3, "vertex"), _Table(path, 2, "texture coordinate")
    faces = _Faces(path)
    used, libraries = [(0, "")], dict[str, None]()
    for block in _blocks(path):
        used += [(faces.count + before, name) for before, name in block.used]
        libraries |= dict.fromkeys(block.libraries)
        faces.add(block.faces, vertices.count, uvs.count)
        vertices.add(block.vertices)
        uvs.add(block.uvs)
    if not faces.count:
        raise InputError(f"{path} has no faces ({vertices.count} vertices): export it as a polygon mesh.")
    polygons, polygon_uvs = faces.polygons(vertices.count, uvs.count)
    looks = _appearances(path, faces.count, used, list(libraries), polygon_uvs is not None)
    return PolygonMesh(vertices.rows(), polygons, None if polygon_uvs is None else uvs.rows(), polygon_uvs, looks)


def _appearances(
    path: Path, count: int, used: list[tuple[int, str]], libraries: list[str], laid_on: bool
) -> Appearances | None:
    """Of `count` faces from those that `used` names at the first face of each; images only where UVs lay them on."""
    known: dict[str, Appearance] = {}
    for name in libraries:
        if (path.parent / name).is_file():
            known |= read_mtl(path.parent / name)
    listed = [known[name] for name in dict.fromkeys(name for _, name in used) if name in known]
    if not listed:
        return None
    places = {each.name: k for k, each in enumerate(listed)}
    starts = np.array([start for start, _ in used])
    of_part = np.array([places.get(name, -1) for _, name in used])
    of_face = of_part[np.searchsorted(starts, np.arange(count), side="right") - 1]
    return Appearances(tuple(each if laid_on else replace(each, image=None) for each in listed), of_face)


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
    vertices, digest = _Table(path, 3, "vertex"), hashlib.sha256()
    for block in _blocks(path):
        vertices.add(block.vertices)
        digest.update(b"\n".join([line for _, line, _, _ in block.faces] + [b""]))
    return vertices.rows(), digest.digest()


def _blocks(path: Path) -> Iterator[_Block]:
    """Lines of vertices, texture coordinates and faces, some at a time; continued lines count as one."""
    number = 0
    for text in _whole_lines(path):
        block = _Block([], [], [], [], [])
        for line in text.split(b"\n"):
            number += 1
            kind = line[:2]
            if kind not in _KINDS:
                line = line.lstrip()
                kind = line[:2]
            if kind == b"v " or kind == b"v\t":
                block.vertices.append((number, line))
            elif kind == b"f " or kind == b"f\t":
                # Negative indices count back from what has been read so far.
                block.faces.append((number, line, len(block.vertices), len(block.uvs)))
            elif kind == b"vt":
                block.uvs.append((number, line))
            elif line.startswith((b"usemtl", b"mtllib")):
                name = line[6:].strip().decode("utf-8", "replace")
                if kind == b"us":
                    block.used.append((len(block.faces), name))
                else:
                    block.libraries.append(name)
        yield block


def _whole_lines(path: Path) -> Iterator[bytes]:
    """The file in blocks of whole lines, continued lines joined, without the last line break of each."""
    with path.open("rb") as stream:
        rest = b""
        while block := stream.read(_BLOCK):
            text = rest + block
            end = text.rfind(b"\n")
            while end > 0 and text[max(0, end - 2) : end].rstrip(b"\r").endswith(b"\\"):
                end = text.rfind(b"\n", 0, end)
            if end >= 0:
                yield text[:end].replace(b"\\\n", b" ").replace(b"\\\r\n", b" ")
            rest = text[end + 1 :]
            if len(rest) > _MOST_LINE:
                raise InputError(f"{path} has a line of over {_MOST_LINE:,} bytes, which no OBJ has; export it again.")
        yield rest.replace(b"\\\n", b" ").replace(b"\\\r\n", b" ")


class _Table:
    """Rows of numbers, added some at a time.

    Args:
        path: the file, for messages.
        width: numbers of a row.
        what: what a row is.
    """

    def __init__(self, path: Path, width: int, what: str) -> None:
        self.path, self.width, self.what = path, width, what
        self.count = 0
        self._parts: list[np.ndarray] = []

    def add(self, lines: Lines) -> None:
        """Add the rows of some lines.

        Raises:
            InputError: a line is bad; the first is named.
        """
        if not lines:
            return
        self._parts.append(self._numbers(lines))
        self.count += len(lines)
        if self.count > _MOST_VERTICES:
            raise InputError(
                f"{self.path} has over {_MOST_VERTICES:,} lines of a {self.what}, more than can be read; decimate it "
                "in the program it comes from."
            )

    def rows(self) -> np.ndarray:
        """(rows, width) float64."""
        return np.concatenate(self._parts) if self._parts else np.zeros((0, self.width))

    def _numbers(self, lines: Lines) -> np.ndarray:
        path, what, width = self.path, self.what, self.width
        try:
            values = np.array([line.split(None, width + 1)[1 : width + 1] for _, line in lines], dtype=bytes)
            table = values.reshape(len(lines), width).astype(np.float64)
        except ValueError:
            number = next(number for number, line in lines if not _readable(line, width))
            raise InputError(
                f"{path} line {number}: a {what} needs {width} numbers; mend or export it again."
            ) from None
        bad = np.flatnonzero(~(np.abs(table) <= _LARGEST).all(axis=1))
        if len(bad):
            raise InputError(
                f"{path}: {len(bad)} {what} line(s) hold NaN or infinite numbers, or such above {_LARGEST:g}, first at "
                f"line {lines[bad[0]][0]} ({what} {self.count + bad[0] + 1}); delete or mend them and export again."
            )
        return table


def write_obj(path: Path, mesh: PolygonMesh, groups: Sequence[str] = ()) -> None:
    """Write a mesh in one step: the file appears whole or not at all.

    Its colours and images lie beside it, as NAME.pb4u.mtl and NAME.texture0.png.

    Args:
        path: the file.
        mesh: what is written, numbers to nine digits.
        groups: group of each polygon, or none.

    Raises:
        InputError: the file cannot be written.
    """
    looks, names = mesh.appearances, [""] * len(mesh.polygons)
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
    try:
        if looks is not None:
            write_mtl(mtl, looks.listed)
        replace_file(path, "".join(parts).encode())
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}.") from None


def group_name(name: str) -> str:
    """A name as OBJ groups have them: a space would begin another group, and the format states no encoding."""
    return "_".join(name.encode("ascii", "replace").decode().split()) or "unnamed"


def _readable(line: bytes, width: int) -> bool:
    try:
        return len([float(token) for token in line.split()[1 : width + 1]]) == width
    except ValueError:
        return False


class _Faces:
    """Corners of polygons, added some at a time.

    Args:
        path: the file, for messages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = 0
        self._vertices: list[np.ndarray] = []
        self._uvs: list[np.ndarray] = []
        self._sizes: list[np.ndarray] = []
        self._lines: list[np.ndarray] = []

    def add(self, lines: Sequence[tuple[int, bytes, int, int]], vertices_before: int, uvs_before: int) -> None:
        """Add the polygons of some lines.

        Args:
            lines: number and text of each, and the vertices and texture coordinates before it in its block.
            vertices_before: vertices before the block.
            uvs_before: texture coordinates before the block.

        Raises:
            InputError: an index is no whole number, or a face has too few corners.
        """
        vertex_index: list[int] = []
        uv_index: list[int] = []
        sizes: list[int] = []
        for number, line, vertices, uvs in lines:
            tokens = line.split(b"#", 1)[0].split()[1:]
            sizes.append(len(tokens))
            try:
                for token in tokens:
                    fields = token.split(b"/", 2)
                    v = int(fields[0])
                    vertex_index.append(v - 1 if v > 0 else v + vertices_before + vertices if v < 0 else -1)
                    t = int(fields[1]) if len(fields) > 1 and fields[1] else 0
                    uv_index.append(t - 1 if t > 0 else t + uvs_before + uvs if t < 0 else -1)
            except ValueError:
                raise InputError(
                    f"{self.path} line {number}: the face index {_shown(token)} is not a whole number."
                ) from None
            if len(tokens) < 3:
                raise InputError(f"{self.path} line {number}: a face needs 3 corners or more, not {len(tokens)}.")
        try:
            self._vertices.append(np.array(vertex_index, dtype=np.int64))
            self._uvs.append(np.array(uv_index, dtype=np.int64))
        except OverflowError:
            raise InputError(f"{self.path}: a face index has 19 digits or more; export it again.") from None
        self._sizes.append(np.array(sizes, dtype=np.int64))
        self._lines.append(np.array([number for number, *_ in lines], dtype=np.int64))
        self.count += len(sizes)

    def polygons(
        self, vertex_count: int, uv_count: int
    ) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...] | None]:
        """Vertex indices of each polygon, and UV indices where every corner has one.

        Args:
            vertex_count: vertices of the file.
            uv_count: texture coordinates of the file.

        Raises:
            InputError: an index is out of range.
        """
        corners, uv_corners = np.concatenate(self._vertices), np.concatenate(self._uvs)
        ends = np.cumsum(np.concatenate(self._sizes))
        self._refuse_out_of_range(corners, vertex_count, ends, "vertex")
        polygons = _split(corners, ends)
        # Faces without a texture beside faces with one: there is no UV map of the whole garment then.
        if not uv_count or (uv_corners == -1).any():
            return polygons, None
        self._refuse_out_of_range(uv_corners, uv_count, ends, "texture coordinate")
        return polygons, _split(uv_corners, ends)

    def _refuse_out_of_range(self, corners: np.ndarray, count: int, ends: np.ndarray, what: str) -> None:
        bad = np.flatnonzero((corners < 0) | (corners >= count))
        if len(bad):
            number = np.concatenate(self._lines)[int(np.searchsorted(ends, bad[0], side="right"))]
            text = next(face[1] for block in _blocks(self.path) for face in block.faces if face[0] == number)
            raise InputError(
                f"{self.path} line {number}: face {_shown(text)} names a {what} out of range, the file has {count}; "
                "export it again."
            )


def _split(corners: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, ...]:
    stops = ends.tolist()
    return tuple(corners[a:b] for a, b in zip([0, *stops[:-1]], stops, strict=True))


def _shown(text: bytes) -> str:
    return f'"{text.strip()[:60].decode("utf-8", "replace")}"'
