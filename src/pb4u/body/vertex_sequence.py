"""A body given as the vertices of each frame, without a skeleton."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pb4u.atomic_file import replace_file
from pb4u.body.animated_body import AnimatedBody
from pb4u.body.point_cache import CACHE_SUFFIXES, read_point_cache
from pb4u.body.surface_file import SURFACE_SUFFIXES, read_frames, read_surface, refuse_too_many
from pb4u.errors import InputError, InputWarning

DEFAULT_FPS = 30.0
_PLAUSIBLE_SIZE = (0.1, 10.0)
_CHECKED_FRAMES = 64


class VertexSequence(AnimatedBody):
    """An animated surface stored as vertices, played at any frame rate by linear interpolation.

    Its rest pose, that garments are fitted to, is its first frame.

    Args:
        name: what the user called it.
        vertices: (stored frames, vertices, 3) [m], any float type; may be a memory map.
        faces: (faces, 3) int64.
        stored_fps: frames per second of `vertices`.
        contact: (vertices,) bool, all True when not given.
        fps: frames per second to play at, `stored_fps` when not given.
        held_start: frames for which the first one is held before the motion begins.
    """

    def __init__(
        self,
        name: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        stored_fps: float = DEFAULT_FPS,
        contact: np.ndarray | None = None,
        fps: float | None = None,
        held_start: int = 0,
    ) -> None:
        if not (np.isfinite(stored_fps) and stored_fps > 0):
            raise InputError(f"{name}: {stored_fps:g} frames per second; give a positive frame rate.")
        self.name = name
        self.vertices = vertices
        self.faces = faces
        self.stored_fps = float(stored_fps)
        self.fps = self.stored_fps if fps is None else float(fps)
        self.held_start = held_start
        self.contact = np.ones(vertices.shape[1], dtype=bool) if contact is None else contact
        self.rest_vertices = np.asarray(vertices[0], dtype=np.float64)

    @property
    def frame_count(self) -> int:
        return self.held_start + int((len(self.vertices) - 1) * self.fps / self.stored_fps + 1e-6) + 1

    def positions(self, start: int, stop: int) -> Tensor:
        place = np.maximum(np.arange(start, stop) - self.held_start, 0) * (self.stored_fps / self.fps)
        # Times that differ from a stored frame only by rounding take that frame as it is.
        place = np.where(np.abs(place - np.rint(place)) < 1e-6, np.rint(place), place)
        first = np.minimum(place.astype(np.int64), len(self.vertices) - 1)
        share = (place - first).astype(np.float32)[:, None, None]
        result = self.vertices[first].astype(np.float32)
        if share.any():
            following = self.vertices[np.minimum(first + 1, len(self.vertices) - 1)].astype(np.float32)
            result += share * (following - result)
        return torch.from_numpy(np.ascontiguousarray(result))

    def resampled(self, fps: float) -> VertexSequence:
        """The same motion at another frame rate. Raises InputError when `fps` is not positive."""
        if not (np.isfinite(fps) and fps > 0):
            raise InputError(f"{self.name}: cannot play at {fps:g} frames per second; give a positive frame rate.")
        held = round(self.held_start * fps / self.fps)
        return VertexSequence(self.name, self.vertices, self.faces, self.stored_fps, self.contact, fps, held)

    def with_held_start(self, frames: int) -> VertexSequence:
        """The same motion after `frames` more frames of its first one."""
        return VertexSequence(
            self.name, self.vertices, self.faces, self.stored_fps, self.contact, self.fps, self.held_start + frames
        )


def write_vertex_sequence(
    path: str | Path, vertices: np.ndarray, faces: np.ndarray, fps: float, contact: np.ndarray | None = None
) -> None:
    """Write an .npz that `load_vertex_sequence` reads.

    Args:
        path: the file.
        vertices: (frames, vertices, 3) [m].
        faces: (faces, 3).
        fps: frames per second.
        contact: (vertices,) bool, false where the body neither answers contact nor counts as penetrated; default none.

    Raises InputError when the file cannot be written.
    """
    buffer = io.BytesIO()
    np.savez(
        buffer,
        positions=vertices.astype(np.float32),
        faces=faces.astype(np.int64),
        fps=np.float64(fps),
        contact=np.ones(vertices.shape[1], dtype=bool) if contact is None else contact.astype(bool),
    )
    try:
        replace_file(Path(path), buffer.getvalue())
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}.") from error


def load_vertex_sequence(path: str | Path, fps: float | None = None) -> VertexSequence:
    """Read an .npz, a folder of OBJ or PLY files, or an OBJ with a .pc2 or .mdd point cache of the same name.

    Args:
        path: the file or folder; of an OBJ and its cache, either.
        fps: frames per second of the file, over what the file says; 30 where neither tells.

    Raises InputError on a file that cannot be used. Warns where the body is not closed or seems to be Z up.
    """
    path = Path(path)
    contact: np.ndarray | None = None
    file_fps: float | None = None
    if path.is_dir():
        vertices, faces = read_frames(_frame_files(path))
    elif path.suffix.lower() == ".npz":
        vertices, faces, file_fps, contact = _read_npz(path)
    elif path.suffix.lower() in (*SURFACE_SUFFIXES, *CACHE_SUFFIXES):
        vertices, faces, file_fps = _read_surface_and_cache(path)
    else:
        raise InputError(
            f"{path}: a moving body is an .npz, a folder of OBJ or PLY files, or an OBJ with a .pc2 or .mdd beside it."
        )
    _refuse_unusable(path, vertices, faces)
    stored_fps = next((rate for rate in (fps, file_fps) if rate is not None), DEFAULT_FPS)
    sequence = VertexSequence(path.stem, vertices, _outward(path, vertices[0], faces), stored_fps, contact)
    _warn_of_oddities(path, sequence)
    return sequence


def _frame_files(folder: Path) -> list[Path]:
    """Surface files of a folder in natural order: frame2 before frame10."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in SURFACE_SUFFIXES and not p.name.startswith(".")]
    if not found:
        raise InputError(f"{folder} holds no .obj or .ply files; give a folder with one file per frame.")
    kinds = {p.suffix.lower() for p in found}
    if len(kinds) > 1:
        raise InputError(f"{folder} holds both .obj and .ply files; keep one kind per folder.")
    return sorted(found, key=lambda p: [int(t) if t.isdigit() else t for t in re.split(r"(\d+)", p.stem)])


def _read_npz(path: Path) -> tuple[np.ndarray, np.ndarray, float | None, np.ndarray | None]:
    """Members of a sequence, or the body of a trajectory of this package."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            keys = set(archive.files)
            prefix = "body_" if {"body_positions", "body_faces"} <= keys else ""
            names = [key for key in (f"{prefix}positions", "vertices") if key in keys]
            if not names or f"{prefix}faces" not in keys:
                raise InputError(
                    f'{path} has the members {", ".join(sorted(keys)) or "(none)"}; a moving body needs "vertices" '
                    '(frames, vertices, 3) and "faces" (faces, 3).'
                )
            vertices, faces = archive[names[0]], archive[f"{prefix}faces"]
            fps = float(archive["fps"]) if "fps" in keys else None
            contact = archive[f"{prefix}contact"] if f"{prefix}contact" in keys else None
    except InputError:
        raise
    except Exception as error:  # zipfile and numpy let through whatever their parsers trip over
        raise InputError(f"{path}: not a readable .npz of plain arrays ({error}).") from error
    if vertices.ndim != 3 or vertices.shape[2] != 3 or not len(vertices) or vertices.dtype.kind != "f":
        raise InputError(
            f'{path}: "{names[0]}" has shape {vertices.shape} of {vertices.dtype}; '
            "it needs (frames, vertices, 3) floating-point numbers."
        )
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise InputError(f'{path}: "faces" has shape {faces.shape} of {faces.dtype}; it needs (faces, 3) integers.')
    if contact is not None and contact.shape != (vertices.shape[1],):
        raise InputError(f'{path}: "contact" has shape {contact.shape}; it needs one value per vertex.')
    return vertices.astype(np.float32), faces.astype(np.int64), fps, None if contact is None else contact.astype(bool)


def _read_surface_and_cache(path: Path) -> tuple[np.ndarray, np.ndarray, float | None]:
    beside = {p.suffix.lower(): p for p in sorted(path.parent.glob("*")) if p.stem == path.stem and p.is_file()}
    if path.suffix.lower() in CACHE_SUFFIXES:
        surface, cache = beside.get(".obj"), path
        if surface is None:
            raise InputError(f"{path}: a point cache has no faces; put the mesh beside it as {path.stem}.obj.")
    else:
        surface, cache = path, next((beside[suffix] for suffix in CACHE_SUFFIXES if suffix in beside), path)
    vertices, faces = read_surface(surface)
    if cache == surface:
        return vertices[None].astype(np.float32), faces, None
    points = read_point_cache(cache)
    if points.positions.shape[1] != len(vertices):
        raise InputError(
            f"{cache} moves {points.positions.shape[1]} points and {surface.name} has {len(vertices)} vertices; "
            "export both from one mesh."
        )
    return points.positions, faces, points.fps


def _refuse_unusable(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    if not len(faces):
        raise InputError(f"{path} has no faces; a body needs a surface.")
    refuse_too_many(path, len(faces))
    if faces.min() < 0 or faces.max() >= vertices.shape[1]:
        raise InputError(f"{path}: a face names a vertex out of range, there are {vertices.shape[1]}.")
    for start in range(0, len(vertices), _CHECKED_FRAMES):
        bad = np.argwhere(~np.isfinite(vertices[start : start + _CHECKED_FRAMES]).all(axis=2))
        if len(bad):
            raise InputError(
                f"{path}: vertex {bad[0, 1]} of frame {start + bad[0, 0]} is not a finite number; export it again."
            )
    size = float(np.ptp(vertices[0], axis=0).max())
    low, high = _PLAUSIBLE_SIZE
    if not low <= size <= high:
        raise InputError(
            f"{path}: the body measures {size:g} m in its first frame; coordinates are metres, "
            f"scale them by {0.001 if size > 1000 else 0.01 if size > high else 100:g} or so and export again."
        )


def _outward(path: Path, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """`faces`, turned round when the closed surface they make is inside out."""
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    volume = np.einsum("fc,fc->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    if volume >= 0:
        return faces
    warnings.warn(f"{path}: the surface is inside out; its faces were turned round.", InputWarning, stacklevel=3)
    return np.ascontiguousarray(faces[:, ::-1])


def _warn_of_oddities(path: Path, sequence: VertexSequence) -> None:
    if not sequence.is_closed:
        message = f"{path}: the body is not closed, so penetration is not reported; fill its holes to have it."
        warnings.warn(message, InputWarning, stacklevel=3)
    _, height, depth = np.ptp(sequence.rest_vertices, axis=0)
    if depth > 2.0 * height:
        message = f"{path}: the body is {depth:.2f} m along Z and {height:.2f} m along Y: Z seems to be up, not Y."
        warnings.warn(message, InputWarning, stacklevel=3)
