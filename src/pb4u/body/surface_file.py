"""Vertices and triangles of OBJ and PLY files, for surfaces that move frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pb4u.errors import InputError
from pb4u.geometry.mesh_file_size import least_triangles
from pb4u.geometry.triangulation import triangulate

SURFACE_SUFFIXES = (".obj", ".ply")
MOST_TRIANGLES = 1_000_000
"""Triangles that a body may have."""


@dataclass(frozen=True, eq=False)
class _RawSurface:
    """One file: vertices (vertices, 3) float64, and its faces as the file writes them, quick to compare."""

    path: Path
    vertices: np.ndarray
    faces: list[bytes] | np.ndarray

    def has_faces_of(self, other: _RawSurface) -> bool:
        if isinstance(self.faces, np.ndarray) and isinstance(other.faces, np.ndarray):
            return np.array_equal(self.faces, other.faces)
        return bool(self.faces == other.faces)

    def triangles(self) -> np.ndarray:
        """(faces, 3) int64. Raises InputError on a face that cannot be used."""
        if not len(self.vertices) or not len(self.faces):
            raise InputError(
                f"{self.path} has no surface ({len(self.vertices)} vertices, {len(self.faces)} faces): export a mesh."
            )
        if isinstance(self.faces, np.ndarray):
            polygons = list(self.faces)
        else:
            polygons = [self._polygon(line) for line in self.faces]
        corners = np.concatenate(polygons)
        if corners.min() < 0 or corners.max() >= len(self.vertices):
            raise InputError(
                f"{self.path}: a face names a vertex out of range, the file has {len(self.vertices)}; export it again."
            )
        return corners[triangulate(self.vertices, polygons)[0]]

    def _polygon(self, line: bytes) -> np.ndarray:
        try:
            corners = np.array([int(token.split(b"/", 1)[0]) for token in line.split()[1:]], dtype=np.int64)
        except (ValueError, OverflowError):
            corners = np.zeros(0, dtype=np.int64)
        if len(corners) < 3 or not corners.all():
            shown = line.decode("utf-8", "replace").strip()[:60]
            raise InputError(f'{self.path}: the face "{shown}" does not have three or more vertex numbers.')
        # Negative numbers count back from the end: the files of a sequence list their vertices first.
        return np.where(corners > 0, corners - 1, corners + len(self.vertices))


def read_surface(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (vertices, 3) float64 and triangles (faces, 3) int64, in the order of the file.

    Raises InputError when the file cannot be read, has no faces or too many, or names vertices that it does not have.
    """
    _refuse_huge(path)
    raw = _read(path)
    return raw.vertices, raw.triangles()


def read_frames(paths: list[Path]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (frames, vertices, 3) float32 of files that share one topology, and its triangles (faces, 3) int64.

    Raises InputError naming the first file whose faces or vertex count differ from those of the first.
    """
    _refuse_huge(paths[0])
    first = _read(paths[0])
    faces = first.triangles()
    frames = np.empty((len(paths), len(first.vertices), 3), dtype=np.float32)
    frames[0] = first.vertices
    for index, path in enumerate(paths[1:], 1):
        raw = _read(path)
        same_count = len(raw.vertices) == len(first.vertices)
        if not same_count or not raw.has_faces_of(first):
            difference = "other faces than" if same_count else f"{len(raw.vertices)} vertices, not the number of"
            raise InputError(
                f"{path} has {difference} {paths[0].name}: all frames need one topology, export them from one mesh."
            )
        frames[index] = raw.vertices
    return frames, faces


def refuse_too_many(path: Path, triangles: int) -> None:
    """Raises InputError when a body has more triangles than can be used."""
    if triangles > MOST_TRIANGLES:
        raise InputError(
            f"{path} has {triangles:,} triangles or more, and {MOST_TRIANGLES:,} are the most that a body may have; "
            "decimate it in the program it comes from."
        )


def _refuse_huge(path: Path) -> None:
    """Before the file is parsed, which takes minutes where counting takes a second."""
    try:
        refuse_too_many(path, least_triangles(path, MOST_TRIANGLES))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error


def _read(path: Path) -> _RawSurface:
    return _read_ply(path) if path.suffix.lower() == ".ply" else _read_obj(path)


def _read_obj(path: Path) -> _RawSurface:
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    positions = [line.split(None, 4)[1:4] for line in lines if line.startswith(b"v ")]
    try:
        vertices = np.array(positions, dtype=np.float64).reshape(-1, 3)
    except ValueError:
        raise InputError(f"{path}: a vertex line does not hold three numbers; export it again.") from None
    return _RawSurface(path, vertices, [line for line in lines if line.startswith(b"f ")])


def _read_ply(path: Path) -> _RawSurface:
    import trimesh

    try:
        mesh = trimesh.load_mesh(path, process=False)
        return _RawSurface(path, np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))
    except Exception as error:
        # trimesh lets through whatever its PLY parser trips over.
        raise InputError(f"{path}: not a readable PLY mesh ({error}).") from error
