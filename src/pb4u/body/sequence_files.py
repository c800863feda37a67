"""Files of bodies that are given as the vertices of each frame: .npz, .pkl, folders of meshes, point caches."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from pb4u.body.vertex_sequence import DEFAULT_FPS, VertexSequence, refuse_large, require_usable, warn_of_oddities
from pb4u.errors import InputError, InputNote, on_disk, warn
from pb4u.geometry.mesh_file import read_mesh
from pb4u.geometry.obj_file import read_obj_vertices
from pb4u.geometry.ply_file import read_ply
from pb4u.geometry.triangulation import triangulate
from pb4u.io.array_archive import member_names, read_arrays
from pb4u.io.atomic_file import replace_file
from pb4u.io.point_cache import MDD_HEADER, PC2_HEADER, PC2_MAGIC
from pb4u.io.restricted_pickle import load_pickle
from pb4u.io.stored_numbers import Layout, read_members, unrounded_rate

_MESH_SUFFIXES = (".obj", ".ply")


def write_vertex_sequence(
    path: str | Path, vertices: np.ndarray, faces: np.ndarray, fps: float, contact: np.ndarray | None = None
) -> None:
    """Write an .npz that `load_vertex_sequence` reads.

    Args:
        path: the file.
        vertices: (frames, vertices, 3) [m].
        faces: (faces, 3).
        fps: frames per second.
        contact: (vertices,) bool, False where the body takes no part in contact and penetration; by default all True.

    Raises:
        InputError: the file cannot be written.
    """
    buffer = io.BytesIO()
    np.savez(
        buffer,
        positions=vertices.astype(np.float32),
        faces=faces.astype(np.int64),
        fps=np.float64(fps),
        contact=np.ones(vertices.shape[1], dtype=bool) if contact is None else contact.astype(bool),
    )
    with on_disk(f"{path} cannot be written"):
        replace_file(Path(path), buffer.getvalue())


def load_vertex_sequence(path: str | Path, units: str | None = None) -> VertexSequence:
    """Read an .npz, a folder of OBJ or PLY files, or an OBJ with a .pc2 or .mdd point cache of the same name.

    Warns if the body is not closed, leaps, or seems to be Z up.

    Args:
        path: the file or folder; for an OBJ with a cache either of the two. Without a stated rate it plays at 30 frames
            per second.
        units: name of its unit of length; by default recognised by the size of a person.

    Raises:
        InputError: the file cannot be used.
    """
    path = Path(path)
    contact: np.ndarray | None = None
    fps: float | None = None
    if path.is_dir():
        vertices, faces = _read_folder(path)
    elif path.suffix.lower() == ".pkl":
        vertices, faces = _read_pickle(path)
    elif path.suffix.lower() == ".npz":
        vertices, faces, fps, contact = _read_npz(path)
    elif path.suffix.lower() in SUFFIXES:
        vertices, faces, fps = _read_mesh_and_cache(path)
    else:
        raise InputError(
            f"{path}: a moving body is an .npz, a folder of OBJ or PLY files, or an OBJ with a {' or '.join(_CACHES)} "
            "beside it."
        )
    vertices, faces = require_usable(path, vertices, faces, units)
    sequence = VertexSequence(path.stem, vertices, faces, DEFAULT_FPS if fps is None else fps, contact)
    warn_of_oddities(path, sequence)
    return sequence


def surface_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (vertices, 3) float64, in the file's unit, and triangles (faces, 3) int64 of a mesh file.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read, or has too many triangles.
    """
    mesh = read_mesh(path, partial(refuse_large, path))
    return mesh.vertices, np.concatenate(mesh.polygons)[triangulate(mesh.vertices, mesh.polygons)[0]]


def _read_pickle(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (frames, vertices, 3) float32 and triangles (faces, 3) of a mesh sequence of the released code."""

    def refuse(what: str) -> InputError:
        return InputError(f"{path} is not a moving body: {what}.")

    layout: Layout = {"verts": ("f", ("frames", "vertices", 3)), "faces": ("iu", ("faces", 3))}
    members, _ = read_members(load_pickle(path), layout, refuse)
    refuse_large(path, len(members["faces"]))
    return members["verts"].astype(np.float32), members["faces"].astype(np.int64)


def _read_folder(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (frames, vertices, 3) float32 of the files of one topology in a folder, and its triangles (faces, 3)."""
    files = [p for p in folder.iterdir() if p.suffix.lower() in _MESH_SUFFIXES and not p.name.startswith(".")]
    if not files:
        raise InputError(f"{folder} holds no .obj or .ply files; give a folder with one file per frame.")
    if len({p.suffix.lower() for p in files}) > 1:
        raise InputError(f"{folder} holds both .obj and .ply files; keep one kind per folder.")
    files.sort(key=by_number)
    warn_of_gaps(folder, files)
    first, faces = surface_of(files[0])
    _, first_faces = _read_frame(files[0])
    frames = np.empty((len(files), *first.shape), dtype=np.float32)
    frames[0] = first
    for index, path in enumerate(files[1:], 1):
        vertices, own_faces = _read_frame(path)
        if len(vertices) != len(first) or own_faces != first_faces:
            same = len(vertices) == len(first)
            difference = "other faces than" if same else f"{len(vertices)} vertices, not the number of"
            raise InputError(
                f"{path} has {difference} {files[0].name}; all frames need one topology: export them from one mesh."
            )
        frames[index] = vertices
    return frames, faces


def by_number(file: Path) -> list[object]:
    """Order of numbered files: frame2 before frame10.

    Args:
        file: a file of the sequence.
    """
    return [int(word) if word.isdigit() else word for word in re.split(r"(\d+)", file.stem)]


def warn_of_gaps(folder: Path, files: Sequence[Path]) -> None:
    """Warn of missing frames, where the numbers of a folder's frames rise by more than their common step.

    Args:
        folder: path of the folder, for the message.
        files: its frames, in their order.
    """
    words = [by_number(file) for file in files]
    varying = [column for column in zip(*words, strict=False) if len(set(column)) > 1]
    # Names without a number of their own, or with two of them, tell no order of time.
    if len({len(entry) for entry in words}) > 1 or len(varying) != 1:
        return
    numbers = np.array([number for number in varying[0] if isinstance(number, int)])
    if len(numbers) < len(files):
        return
    steps, counts = np.unique(np.diff(numbers), return_counts=True)
    step = max(int(steps[counts.argmax()]), 1)
    missing = np.diff(numbers) // step - 1
    if missing.max() > 0:
        warn(
            f"{folder}: frames are missing, {missing.clip(0).sum()} in all and the first after "
            f"{files[int(np.argmax(missing > 0))].name}; the motion jumps there, and ends earlier."
        )


def _read_frame(path: Path) -> tuple[np.ndarray, bytes]:
    """Vertices (vertices, 3), and what is equal between files with the same faces."""
    if path.suffix.lower() == ".obj":
        return read_obj_vertices(path)
    mesh = read_ply(path)
    return mesh.vertices, np.concatenate([[len(polygon) for polygon in mesh.polygons], *mesh.polygons]).tobytes()


def _read_npz(path: Path) -> tuple[np.ndarray, np.ndarray, float | None, np.ndarray | None]:
    keys = set(member_names(path))
    prefix = "body_" if {"body_positions", "body_faces"} <= keys else ""
    positions = next((key for key in (f"{prefix}positions", "vertices") if key in keys), "vertices")
    faces, contact, origins = f"{prefix}faces", f"{prefix}contact", "body_position_origins"

    def refuse(what: str) -> InputError:
        return InputError(
            f'{path} is not a moving body: {what}; it needs "vertices" (frames, vertices, 3) and "faces".'
        )

    layout: Layout = {
        positions: ("f", ("frames", "vertices", 3)),
        faces: ("iu", ("faces", 3)),
        "fps": ("fiu", ()),
        contact: ("fiub", ("vertices",)),
        origins: ("f", ("frames", 3)),
    }
    members, _ = read_members(read_arrays(path, layout), layout, refuse, ("fps", contact, origins))
    places = members[positions].astype(np.float32, copy=False)
    if origins in members:  # a trajectory in half precision
        places = places + members[origins].astype(np.float32)[:, None]
    surface = places, members[faces].astype(np.int64, copy=False)
    fps = float(members["fps"]) if "fps" in members else None
    return *surface, fps, members[contact].astype(bool) if contact in members else None


def _read_mesh_and_cache(path: Path) -> tuple[np.ndarray, np.ndarray, float | None]:
    beside = {p.suffix.lower(): p for p in sorted(path.parent.glob("*")) if p.stem == path.stem and p.is_file()}
    if path.suffix.lower() in _CACHES:
        surface, cache = beside.get(".obj"), path
        if surface is None:
            raise InputError(f"{path}: a point cache has no faces; put the mesh beside it as {path.stem}.obj.")
    else:
        surface, cache = path, next((beside[suffix] for suffix in _CACHES if suffix in beside), path)
    vertices, faces = surface_of(surface)
    if cache == surface:
        if unread := [file.name for suffix, file in beside.items() if suffix in _UNREAD]:
            warn(
                f"{path}: {', '.join(unread)} beside it is not read, so the mesh does not move; a body is animated by "
                f"{' or '.join(_CACHES)}."
            )
        return vertices[None].astype(np.float32), faces, None
    positions, fps = _CACHES[cache.suffix.lower()](cache)
    if positions.shape[1] != len(vertices):
        raise InputError(
            f"{cache} moves {positions.shape[1]} points and {surface.name} has {len(vertices)} vertices; "
            "export both from one mesh."
        )
    return positions, faces, fps


def _read_pc2(path: Path) -> tuple[np.ndarray, float | None]:
    """Positions (frames, points, 3) float32, mapped from the file, and frames per second where it states them."""
    with path.open("rb") as file:
        header = file.read(PC2_HEADER.size)
    if len(header) < PC2_HEADER.size or not header.startswith(PC2_MAGIC):
        raise InputError(f'{path}: not a PC2 point cache: the file does not begin with "POINTCACHE2"; export it again.')
    _, _, points, _, rate, frames = PC2_HEADER.unpack(header)
    # Programs differ in what the rate counts, and the file does not hold that of its scene.
    if rate != 1.0:
        warn(
            f"{path}: its sample rate is {rate:g}, but each sample is played as one frame; export it with one sample "
            "a frame."
        )
    return _map_points(path, PC2_HEADER.size, frames, points, "<f4"), None


def _read_mdd(path: Path) -> tuple[np.ndarray, float | None]:
    with path.open("rb") as file:
        header = file.read(MDD_HEADER.size)
        if len(header) < MDD_HEADER.size:
            raise InputError(f"{path}: not an MDD point cache: the file ends within its header; export it again.")
        frames, points = MDD_HEADER.unpack(header)
    positions = _map_points(path, MDD_HEADER.size + 4 * max(frames, 0), frames, points, ">f4")
    times = np.memmap(path, dtype=">f4", mode="r", offset=MDD_HEADER.size, shape=(frames,))
    duration = float(times[-1] - times[0])
    if duration == frames - 1 > 0:
        warn(f"{path}: its samples are a second apart, so their times are read as frame numbers.", InputNote)
        return positions, None
    return positions, unrounded_rate((frames - 1) / duration) if duration > 0 else None


def _map_points(path: Path, offset: int, frames: int, points: int, dtype: str) -> np.ndarray:
    if frames < 1 or points < 1:
        raise InputError(f"{path} holds {frames} frames of {points} points; export it again.")
    needed, size = offset + 12 * frames * points, path.stat().st_size
    if size < needed:
        raise InputError(
            f"{path} is cut short: {frames} frames of {points} points need {needed} bytes and it has {size}; "
            "export or copy it again."
        )
    return np.memmap(path, dtype=dtype, mode="r", offset=offset, shape=(frames, points, 3))


_CACHES = {".pc2": _read_pc2, ".mdd": _read_mdd}
"""Readers of positions (frames, points, 3) [m] and frames per second, None where the file has none; an OBJ has the
faces."""

_UNREAD = (".pc16", ".pc", ".mcx", ".mc", ".mcc", ".xml", ".abc", ".bphys", ".ptc", ".cache")
"""Suffixes of other programs' caches, and of point caches in half precision."""

SUFFIXES = (*_MESH_SUFFIXES, *_CACHES)
