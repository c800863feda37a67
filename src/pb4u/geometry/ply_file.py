"""PLY files, text or binary, polygons and UVs kept: those of corners, as MeshLab writes them, or of vertices.

Source: G. Turk, The PLY polygon file format, 1994.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pb4u.errors import InputError
from pb4u.geometry.mesh_file import PolygonMesh, no_faces, require_sound
from pb4u.io.reading_limits import refusing

_KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


class _Property(NamedTuple):
    """A column of an element, and of a list the kind of the number before it."""

    name: str
    kind: str
    size_kind: str = ""


def read_ply(path: Path) -> PolygonMesh:
    """The mesh of a PLY file.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read as a mesh, has no faces, or numbers in it cannot be used.
    """
    with refusing(path, "cannot be read as a mesh"):
        elements = _elements(path.read_bytes())
        points, face = elements.get("vertex", {}), elements.get("face", {})
        polygons = [row.astype(np.int64) for row in face.get("vertex_indices", face.get("vertex_index", ()))]
        if not polygons:
            raise no_faces(path)
        if few := [k for k, polygon in enumerate(polygons) if len(polygon) < 3]:
            raise InputError(
                f"{path}: face {few[0]} has {len(polygons[few[0]])} corners; a face needs 3 or more; export it again."
            )
        vertices = np.column_stack([points[axis] for axis in "xyz"]).astype(np.float64)
        require_sound(path, vertices, np.concatenate(polygons))
        if "texcoord" in face:
            return PolygonMesh(vertices, tuple(polygons), *_corner_uvs(polygons, face["texcoord"]))
        names = next((pair for pair in _UV_NAMES if pair[0] in points and pair[1] in points), None)
        if names is None:
            return PolygonMesh(vertices, tuple(polygons))
        uvs = np.column_stack([points[name] for name in names]).astype(np.float64)
        return PolygonMesh(vertices, tuple(polygons), uvs, tuple(polygons))


def _corner_uvs(polygons: list[np.ndarray], rows: Sequence[np.ndarray]) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """UV points (points, 2), each once, and those of the corners of each polygon; (0, 0) of one without."""
    corner_rows = [
        row if len(row) == 2 * len(polygon) else np.zeros(2 * len(polygon))
        for polygon, row in zip(polygons, rows, strict=True)
    ]
    uvs, places = np.unique(np.concatenate(corner_rows).astype(np.float64).reshape(-1, 2), axis=0, return_inverse=True)
    return uvs, tuple(np.split(places.reshape(-1), np.cumsum([len(polygon) for polygon in polygons])[:-1]))


def _elements(content: bytes) -> dict[str, Mapping[str, Any]]:
    """Columns of each element by name: (count,) numbers, or of a list an array of each row."""
    head, mark, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not mark:
        raise ValueError("it has no header of a PLY file")
    body = body[body.find(b"\n") + 1 :] if b"\n" in head else body[1:]
    order, is_text = "<", False
    columns: dict[str, tuple[int, list[_Property]]] = {}
    name = ""
    for words in map(str.split, head.decode("utf-8", "replace").splitlines()):
        if words[:1] == ["format"]:
            order, is_text = _ORDERS[words[1]], words[1] == "ascii"
        elif words[:1] == ["element"]:
            name = words[1]
            columns[name] = (int(words[2]), [])
        elif words[:1] == ["property"]:
            kinds = [order + _KINDS[kind] for kind in words[1:-1] if kind != "list"]
            columns[name][1].append(_Property(words[-1], *reversed(kinds)))
    if is_text:
        # Text becomes bytes of one kind, so that both are read in one way.
        body = np.array(body.split(), dtype=np.float64).astype("<f8").tobytes()
        columns = {
            name: (count, [_Property(entry.name, "<f8", entry.size_kind and "<f8") for entry in properties])
            for name, (count, properties) in columns.items()
        }
    elements, place = {}, 0
    for name, (count, properties) in columns.items():
        elements[name], place = _columns(body, place, count, properties)
    return elements


def _columns(content: bytes, place: int, count: int, properties: list[_Property]) -> tuple[Mapping[str, Any], int]:
    """Columns of an element whose rows begin at a place, and where they end."""
    if not count or not properties:
        return {}, place
    first, _ = _row(content, place, properties)
    fields: list[tuple[Any, ...]] = []
    for entry in properties:
        if entry.size_kind:
            fields.append((f"{entry.name} size", entry.size_kind))
        fields.append((entry.name, entry.kind, (len(first[entry.name]),) if entry.size_kind else ()))
    kind = np.dtype(fields)
    if place + count * kind.itemsize <= len(content):
        table = np.frombuffer(content, kind, count, place)
        lists = [entry.name for entry in properties if entry.size_kind]
        if all((table[f"{name} size"] == len(first[name])).all() for name in lists):
            return {entry.name: table[entry.name] for entry in properties}, place + count * kind.itemsize
    rows: dict[str, list[np.ndarray]] = {entry.name: [] for entry in properties}
    for _ in range(count):
        row, place = _row(content, place, properties)
        for name, values in row.items():
            rows[name].append(values)
    return {e.name: rows[e.name] if e.size_kind else np.concatenate(rows[e.name]) for e in properties}, place


def _row(content: bytes, place: int, properties: list[_Property]) -> tuple[dict[str, np.ndarray], int]:
    """Values of one row at a place, and where it ends."""
    values = {}
    for name, kind, size_kind in properties:
        size = 1
        if size_kind:
            size = int(np.frombuffer(content, size_kind, 1, place)[0])
            place += np.dtype(size_kind).itemsize
        if size < 0:
            raise ValueError("a list has a negative length")
        values[name] = np.frombuffer(content, kind, size, place) if size else np.zeros(0, dtype=kind)
        place += size * np.dtype(kind).itemsize
    return values, place
