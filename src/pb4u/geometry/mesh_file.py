"""Polygon meshes in files: OBJ, PLY, STL, glTF and OFF, and how large a file is before it is parsed."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.geometry.appearance import Appearance, Appearances, as_png
from pb4u.io.reading_limits import MOST_NUMBERS_TEXT, MOST_TEXT, Allowance, parse_json, read_text, require_size

_TRIMESH = "pb4u.geometry.mesh_file:read_with_trimesh"
READERS = {
    ".obj": "pb4u.geometry.obj_file:read_obj",
    ".ply": _TRIMESH, ".stl": _TRIMESH, ".glb": _TRIMESH, ".gltf": _TRIMESH, ".off": _TRIMESH,
}  # fmt: skip
"""Suffix -> function of a path that gives its `PolygonMesh`; another format is one more line here."""

MOST_READ = 4_000_000
"""Triangles that a file may have to be read at all, which bounds time and memory; larger ones are refused unparsed."""
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Bytes of an OBJ that are counted at a time.
_BLOCK = 1 << 24


@dataclass(frozen=True, eq=False)
class PolygonMesh:
    """A mesh as its author made it: vertex order, polygons and UVs kept.

    Args:
        vertices: (vertices, 3) float64 [m], in the axes of its file.
        polygons: vertex indices of each polygon (triangles, quads, n-gons).
        uvs: (uv points, 2) float64 or None.
        polygon_uvs: UV indices of each polygon's corners, or None.
        appearances: colours and images of the polygons, where the file has any.
    """

    vertices: np.ndarray
    polygons: tuple[np.ndarray, ...]
    uvs: np.ndarray | None = None
    polygon_uvs: tuple[np.ndarray, ...] | None = None
    appearances: Appearances | None = None


def read_mesh(path: Path, refuse_large: Callable[[int], None]) -> PolygonMesh:
    """The mesh in a file, polygons and UVs kept where the format has them (OBJ).

    Args:
        path: the file; its suffix, one of `READERS`, says how it is read.
        refuse_large: called with a number of triangles; raises where the file has too many.

    Raises:
        InputError: the file is missing, damaged, empty of faces or too large.
    """
    # Counted before anything is parsed: a huge file is refused in the time it takes to read it.
    try:
        refuse_large(least_triangles(path, MOST_READ))
        mesh: PolygonMesh = resolve_name(READERS[path.suffix.lower()])(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    refuse_large(sum(len(polygon) - 2 for polygon in mesh.polygons))
    return mesh


def read_with_trimesh(path: Path) -> PolygonMesh:
    """The triangles of a file in any format that trimesh reads, with colours and images of a glTF.

    Corners in the same place are one vertex in STL, which has no connectivity, and in glTF, which copies vertices at
    every UV seam.

    Args:
        path: the file; its suffix says the format.

    Raises:
        InputError: it cannot be read as a mesh, has no faces, or numbers in it cannot be used.
    """
    import trimesh

    try:
        loaded: Any = trimesh.load(path, process=False)
        parts: list[Any] = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    except Exception as error:  # each format's reader raises its own kinds
        raise InputError(f"{path} cannot be read as a mesh: {str(error) or type(error).__name__}.") from None
    parts = [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if not parts:
        raise InputError(f"{path} has no faces: export it as a polygon mesh.")
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts]).astype(np.float64)
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]).astype(np.int64)
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}: {len(bad)} vertices are NaN or infinite, first {bad[:5].tolist()}; delete or mend them and "
            "export again."
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{path}: a face names a vertex out of range, the file has {len(vertices)}; export it again.")
    corners = faces
    if path.suffix.lower() in (".stl", ".glb", ".gltf"):
        first, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)[1:]
        order = np.argsort(first)
        vertices, faces = vertices[first[order]], np.argsort(order)[same.reshape(-1)][faces]
    known = [getattr(part.visual, "uv", None) for part in parts]
    if all(uvs is None or len(uvs) != len(part.vertices) for uvs, part in zip(known, parts, strict=True)):
        return PolygonMesh(vertices, tuple(faces), appearances=_appearances(parts, False))
    uvs = [np.zeros((len(part.vertices), 2)) if uv is None else uv for uv, part in zip(known, parts, strict=True)]
    return PolygonMesh(
        vertices, tuple(faces), np.concatenate(uvs).astype(np.float64), tuple(corners), _appearances(parts, True)
    )


def _appearances(parts: list[Any], laid_on: bool) -> Appearances | None:
    """Base colours and images of glTF's meshes; images only where UVs say how they are laid on."""
    found: list[Appearances | None] = []
    for part in parts:
        material: Any = getattr(part.visual, "material", None)
        factor = getattr(material, "baseColorFactor", None)
        image = getattr(material, "baseColorTexture", None) if laid_on else None
        if factor is None and image is None:
            found.append(None)
            continue
        linear = np.ones(3) if factor is None else np.asarray(factor[:3], dtype=np.float64) / 255.0
        red, green, blue = (linear ** (1 / 2.2)).tolist()
        content = None if image is None else as_png(image)
        listed = (Appearance(str(material.name or "material"), (red, green, blue), content),)
        found.append(Appearances(listed, np.zeros(len(part.faces), dtype=np.int64)))
    return Appearances.joined(found, [len(part.faces) for part in parts])


def least_triangles(path: Path, enough: int) -> int:
    """Triangles that the polygons of a mesh file come to, or fewer; 0 where only reading it whole tells.

    Exact up to `enough` for an OBJ written plainly, above that at least the number of its polygons. A PLY tells its
    number of polygons, of which each is a triangle or more.

    Args:
        path: the file, which is read once, without parsing it.
        enough: number of triangles above which a lower bound will do.

    Raises:
        OSError: the file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".obj":
        polygons = sum(lines.count(b"\nf ") for lines in _obj_lines(path))
        return polygons if polygons > enough else sum(_obj_triangles(lines) for lines in _obj_lines(path))
    with path.open("rb") as stream:
        head = stream.read(1 << 12)
    if suffix == ".ply" and (declared := re.search(rb"element face (\d+)", head)):
        return int(declared.group(1))
    if suffix == ".stl" and not head.lstrip().startswith(b"solid"):
        return max(0, path.stat().st_size - 84) // 50
    if suffix in (".glb", ".gltf"):
        return _gltf_triangles(path)
    if suffix in (".stl", ".off") or b"format ascii" in head:
        require_size(path, MOST_NUMBERS_TEXT // 4, "a mesh written as text")
    return 0


def _gltf_triangles(path: Path) -> int:
    """Triangles of a glTF scene, a mesh counted for each of its nodes. Refuses more data than the file may take."""
    try:
        header = _gltf_header(path)
        allowance = Allowance(path)
        accessors = [_counts(entry) for entry in header.get("accessors", [])]
        for entry, count in zip(header.get("accessors", []), accessors, strict=True):
            allowance.take(count * _COMPONENTS.get(entry["type"], 16) * 8, "its arrays")
        sizes = [
            sum(
                accessors[primitive["indices"] if "indices" in primitive else primitive["attributes"]["POSITION"]]
                for primitive in mesh["primitives"]
            )
            for mesh in header.get("meshes", [])
        ]
        return sum(sizes[node["mesh"]] for node in header.get("nodes", []) if "mesh" in node) // 3
    except InputError:
        raise
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"{path} cannot be read as glTF: {error!r}.") from None


def _counts(accessor: dict[str, Any]) -> int:
    if not isinstance(accessor["count"], int) or accessor["count"] < 0:
        raise ValueError(f"an accessor of {accessor['count']!r} entries")
    return accessor["count"]


def _gltf_header(path: Path) -> dict[str, Any]:
    """The JSON of a .glb or .gltf, embedded data left out."""
    if path.suffix.lower() == ".glb":
        with path.open("rb") as stream:
            magic, _, _, length, _ = struct.unpack("<4sIIII", stream.read(20))
            if magic != b"glTF":
                raise ValueError("it does not begin with glTF")
            text = stream.read(min(length, MOST_TEXT + 1))
    else:
        text = read_text(path, "a glTF text", MOST_NUMBERS_TEXT).encode()
    header = parse_json(re.sub(rb'"data:[^"]*"', b'""', text), path)
    if not isinstance(header, dict):
        raise ValueError("its header is no object")
    return header


def _obj_lines(path: Path) -> Iterator[bytes]:
    """The file in blocks of whole lines, a line break before the first and after the last of each."""
    with path.open("rb") as stream:
        rest = b""
        while block := stream.read(_BLOCK):
            whole, _, rest = (rest + block).rpartition(b"\n")
            yield b"\n" + whole + b"\n"
        yield b"\n" + rest + b"\n"


def _obj_triangles(lines: bytes) -> int:
    """Corners of all face lines less two a line; a line with a comment counts as a triangle."""
    text = np.frombuffer(lines, dtype=np.uint8)
    ends = np.flatnonzero(text == ord("\n"))
    starts, stops = ends[:-1] + 1, ends[1:]
    blank = text <= ord(" ")
    face = (text[starts] == ord("f")) & blank[np.minimum(starts + 1, len(text) - 1)] & (stops > starts + 1)
    starts, stops = starts[face], stops[face]
    if not len(starts):
        return 0
    first, last = int(starts[0]), int(stops[-1]) + 1
    # A token begins where a blank ends; counted up to every place, their number in a line is a difference.
    tokens = np.cumsum(blank[first:last][:-1] & ~blank[first:last][1:], dtype=np.int32)
    comments = np.cumsum(text[first:last] == ord("#"), dtype=np.int32)
    corners = tokens[stops - first - 1] - tokens[starts - first]
    commented = comments[stops - first] > comments[starts - first]
    return int(np.maximum(np.where(commented, 3, corners) - 2, 1).sum())
