"""Polygon meshes in files: OBJ, PLY, STL, glTF and OFF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.geometry.appearance import Appearances
from pb4u.geometry.topology import joined_indices, offsets
from pb4u.io.reading_limits import refusing

_GLTF = "pb4u.geometry.gltf_mesh_file:read_gltf_mesh"
READERS = {
    ".obj": "pb4u.geometry.obj_file:read_obj",
    ".ply": "pb4u.geometry.ply_file:read_ply",
    ".stl": "pb4u.geometry.mesh_file:read_stl",
    ".off": "pb4u.geometry.mesh_file:read_off",
    ".glb": _GLTF,
    ".gltf": _GLTF,
}
"""Suffix -> function of a path that gives its `PolygonMesh`; another format is one more line here."""

MOST_READ = 4_000_000
"""Triangles that a file may have to be read at all, which bounds time and memory."""


@dataclass(frozen=True, eq=False)
class PolygonMesh:
    """A mesh as its author made it: vertex order, polygons and UVs kept.

    Args:
        vertices: (vertices, 3) float64 [m], in the axes of its file.
        polygons: vertex indices of each polygon (triangles, quads, n-gons).
        uvs: (uv points, 2) float64 or None.
        polygon_uvs: UV indices of each polygon's corners, or None.
        appearances: colours and images of the polygons, where the file has any.
        pieces: names that the file gives to polygons, each once.
        piece_of_polygon: (polygons,) int64 which of the `pieces` each polygon belongs to, -1 for none; or None.
        lines: (lines, 2) int64 vertices joined by separate lines in the file, or None.
        objects: names of the objects of the file.
        object_of: (polygons,) int64 number of the object of each polygon, or None.
    """

    vertices: np.ndarray
    polygons: tuple[np.ndarray, ...]
    uvs: np.ndarray | None = None
    polygon_uvs: tuple[np.ndarray, ...] | None = None
    appearances: Appearances | None = None
    pieces: tuple[str, ...] = ()
    piece_of_polygon: np.ndarray | None = None
    lines: np.ndarray | None = None
    objects: tuple[str, ...] = ()
    object_of: np.ndarray | None = None


def named_pieces(names: Sequence[str], of_polygon: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """The `pieces` and `piece_of_polygon` of a mesh; pieces of one name are merged, and names without polygons left
    out.

    Args:
        names: of parts of the file.
        of_polygon: (polygons,) int64 index of the name of each polygon.
    """
    pieces = tuple(dict.fromkeys(name for name in names if name))
    place = {name: number for number, name in enumerate(pieces)}
    return pieces, np.array([place.get(name, -1) for name in names], dtype=np.int64)[of_polygon]


def read_mesh(path: Path, refuse_large: Callable[[int], None]) -> PolygonMesh:
    """The mesh in a file, polygons and UVs kept where the format has them.

    Args:
        path: the file; its suffix, one of `READERS`, says how it is read.
        refuse_large: called with a number of triangles; raises where the file has too many.

    Raises:
        InputError: the file is missing, damaged, empty of faces or too large.
    """
    with refusing(path, "cannot be read as a mesh"):
        # Counted before anything is parsed: a huge file is refused in the time it takes to read it.
        refuse_large(path.read_bytes().count(b"\nf ") if path.suffix.lower() == ".obj" else 0)
        mesh: PolygonMesh = resolve_name(READERS[path.suffix.lower()])(path)
    refuse_large(sum(len(polygon) - 2 for polygon in mesh.polygons))
    return mesh


def read_stl(path: Path) -> PolygonMesh:
    """The triangles of an STL file; coincident corners become one vertex, as the format has no connectivity.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read as a mesh, has no faces, or numbers in it cannot be used.
    """
    import trimesh

    with refusing(path, "cannot be read as a mesh"):
        loaded: Any = trimesh.load(path, process=False)
        parts: list[Any] = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    parts = [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if not parts:
        raise no_faces(path)
    vertices = np.concatenate([part.vertices for part in parts]).astype(np.float64)
    starts = offsets([part.vertices for part in parts])
    faces = joined_indices([part.faces for part in parts], starts).astype(np.int64)
    require_sound(path, vertices, faces)
    vertices, faces = welded(vertices, faces)
    return PolygonMesh(vertices, tuple(faces))


def read_off(path: Path) -> PolygonMesh:
    """The mesh of an OFF file; colours and normals in it are left out.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read as a mesh, has no faces, or numbers in it cannot be used.
    """
    with refusing(path, "cannot be read as a mesh"):
        text = path.read_text(encoding="utf-8-sig", errors="replace")
        (keyword, *counts), *lines = [words for line in text.splitlines() if (words := line.split("#", 1)[0].split())]
        if keyword not in ("OFF", "COFF", "NOFF", "CNOFF", "STOFF", "STCOFF"):
            raise ValueError(f'it begins with "{keyword[:20]}", not with OFF')
        count, face_count = map(int, (counts or lines.pop(0))[:2])
        if min(count, face_count) < 0 or len(lines) < count + face_count:
            raise ValueError("it is cut short")
        if not face_count:
            raise no_faces(path)
        vertices = np.array([words[:3] for words in lines[:count]], dtype=np.float64).reshape(count, 3)
        polygons = []
        for k, words in enumerate(lines[count : count + face_count]):
            polygons.append(np.array(words[1 : int(words[0]) + 1], dtype=np.int64))
            if int(words[0]) < 3 or len(polygons[-1]) != int(words[0]):
                raise InputError(
                    f"{path}: face {k} has {len(polygons[-1])} corners of {words[0]}; a face needs 3 or more."
                )
        require_sound(path, vertices, np.concatenate(polygons))
    return PolygonMesh(vertices, tuple(polygons))


def no_faces(path: Path) -> InputError:
    """Error for a file without faces.

    Args:
        path: the file.
    """
    return InputError(f"{path} has no faces: export it as a polygon mesh.")


def require_sound(path: Path, vertices: np.ndarray, corners: np.ndarray) -> None:
    """Refuse a mesh whose numbers cannot be used.

    Args:
        path: the file that it was read from.
        vertices: (vertices, 3) [m].
        corners: (...) int64 the vertices that its faces name.

    Raises:
        InputError: a vertex is not finite, or a face names one that does not exist.
    """
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}: {len(bad)} vertices are NaN or infinite, the first of them {bad[:5].tolist()}; delete or repair "
            "them and export again."
        )
    if corners.min() < 0 or corners.max() >= len(vertices):
        raise InputError(f"{path}: a face names a vertex out of range, the file has {len(vertices)}; export it again.")


def welded(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coincident vertices merged, in the order of their first occurrence, and the faces with new indices.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
    """
    first, same = np.unique(vertices, axis=0, return_index=True, return_inverse=True)[1:]
    order = np.argsort(first)
    return vertices[first[order]], np.argsort(order)[same.reshape(-1)][faces]
