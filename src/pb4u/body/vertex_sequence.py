"""A body given as the vertices of each frame, without a skeleton."""

from __future__ import annotations

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.length_units import UNITS, body_unit, extent_of
from pb4u.errors import InputError, warn
from pb4u.geometry.low_pass import is_sampled_enough, low_passed
from pb4u.geometry.mesh_arrays import as_numbers, checked_faces

DEFAULT_FPS = 30.0
MOST_TRIANGLES = 1_000_000
"""Triangles that a body may have; it bounds the search tree that is built each frame, and more are refused."""
# Frames whose numbers are checked at a time, which bounds the memory of a mapped file.
_CHECKED_FRAMES = 64


_FASTEST, _LEAST_LEAP, _LOOKED_AT = 12.0, 0.3, 17
"""Speed [m/s] of a whole body, and way [m] in a frame, above which it leaps; every how many vertices are looked at."""


class VertexSequence(AnimatedBody):
    """An animated surface stored as vertices, played at any frame rate by linear interpolation.

    Its rest pose, to which garments are fitted, is its first frame.

    Args:
        name: as given by the user.
        vertices: (stored frames, vertices, 3) [m], any float type; may be a memory map.
        faces: (faces, 3) int64.
        stored_fps: frames per second of `vertices`.
        contact: (vertices,) bool, False where the body takes no part in contact and penetration; by default all True.

    Raises:
        InputError: `stored_fps` is not a positive number.
    """

    def __init__(
        self,
        name: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        stored_fps: float = DEFAULT_FPS,
        contact: np.ndarray | None = None,
    ) -> None:
        if not (np.isfinite(stored_fps) and stored_fps > 0):
            raise InputError(f"{name}: {stored_fps:g} frames per second; give a positive frame rate.")
        self.name = name
        self.vertices = vertices
        self.faces = faces
        self.stored_fps = float(stored_fps)
        self.fps = self.stored_fps
        #: Frames for which the first one is held before the motion begins.
        self.held_start = 0
        self.contact = np.ones(vertices.shape[1], dtype=bool) if contact is None else contact
        self.rest_vertices = np.asarray(vertices[0], dtype=np.float64)
        #: Whether it was estimated from a video, frame by frame, and trembles.
        self.from_video = False

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

    def recorded_at(self, fps: float) -> VertexSequence:
        """The same frames at another frame rate than that stated or assumed for the file.

        Args:
            fps: frames per second of `vertices`.
        """
        return self._with(stored_fps=fps, fps=fps)

    def resampled(self, fps: float) -> VertexSequence:
        """The same motion at another frame rate.

        Args:
            fps: frames per second.

        Raises:
            InputError: it is not positive.
        """
        if not (np.isfinite(fps) and fps > 0):
            raise InputError(f"{self.name}: cannot play at {fps:g} frames per second; give a positive frame rate.")
        return self._with(fps=fps, held_start=round(self.held_start * fps / self.fps))

    def smoothed(self, cutoff: float) -> VertexSequence:
        """The same motion without frequencies above `cutoff` [Hz], by a low-pass without delay.

        Args:
            cutoff: frequency above which motion is removed [Hz].
        """
        if not is_sampled_enough(len(self.vertices), self.stored_fps, cutoff):
            return self
        calm = low_passed(self.vertices, self.stored_fps, cutoff).astype(np.float32)
        return self._with(vertices=calm, rest_vertices=np.asarray(calm[0], dtype=np.float64), from_video=False)

    def with_contact(self, contact: np.ndarray) -> VertexSequence:
        """The same motion with other vertices left out of contact: `contact` (vertices,) bool is False there.

        Args:
            contact: (vertices,) bool, False where a vertex is left out of contact.
        """
        return self._with(contact=contact)

    def with_held_start(self, frames: int) -> VertexSequence:
        """The same motion after `frames` more frames of its first one.

        Args:
            frames: number of frames to add.
        """
        return self._with(held_start=self.held_start + frames)

    def _with(self, **changed: Any) -> VertexSequence:
        other = copy(self)
        vars(other).update(changed)
        return other


def body_from_arrays(
    vertices: ArrayLike,
    faces: ArrayLike,
    fps: float = DEFAULT_FPS,
    name: str = "body",
    contact: ArrayLike | None = None,
    units: str = "metres",
) -> VertexSequence:
    """A body of your own, moving or standing, from arrays or lists.

    Warns if the body is not closed, leaps, or seems to be Z up.

    Args:
        vertices: (frames, vertices, 3), or (vertices, 3) of a body that does not move [m], Y up.
        faces: (faces, 3) vertex indices from 0, counter-clockwise from outside.
        fps: frames per second.
        name: its name.
        contact: (vertices,) bool, False where the body takes no part in contact; by default all True.
        units: unit of the vertices, one of `pb4u.body.length_units.UNITS`.

    Raises:
        InputError: an array has another shape or unusable values, or its size in these units is impossible for a
            person.
    """
    points = as_numbers(name, "vertices", vertices)
    points = points[None] if points.ndim == 2 else points
    if points.ndim != 3 or points.shape[2] != 3 or not points.size:
        raise InputError(
            f"{name}: its vertices have the shape {np.shape(vertices)}; it must be (frames, vertices, 3) or "
            "(vertices, 3)."
        )
    corners = checked_faces(name, faces, points.shape[1])
    if units == "metres" and (unit := body_unit(name, extent_of(points[0]))[0]) != units:
        raise InputError(
            f"{name}: the body measures {extent_of(points[0]):.3g} m in its first frame; coordinates must be in "
            "metres, "
            f'and these seem to be {unit}: give units="{unit}", or scale them by {UNITS[unit]:g}.'
        )
    points, corners = require_usable(name, points, corners, units)
    touched = None if contact is None else np.asarray(contact)
    if touched is not None and (touched.shape != (points.shape[1],) or touched.dtype != bool):
        raise InputError(f"{name}: contact must hold one bool for each of its {points.shape[1]} vertices.")
    sequence = VertexSequence(name, points, corners, fps, touched)
    warn_of_oddities(name, sequence)
    return sequence


def refuse_large(path: Path | str, triangles: int) -> None:
    """Refuse more triangles than a body may have.

    Args:
        path: file of the body, for the message.
        triangles: number of triangles.

    Raises:
        InputError: there are more than `MOST_TRIANGLES`.
    """
    if triangles > MOST_TRIANGLES:
        raise InputError(
            f"{path} has {triangles:,} triangles or more; a body may have at most {MOST_TRIANGLES:,}; "
            "decimate it in the program it comes from."
        )


def require_usable(
    path: Path | str, vertices: np.ndarray, faces: np.ndarray, units: str | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in metres and faces turned outward, of a body that can be used.

    Args:
        path: its file, for the message.
        vertices: (frames, vertices, 3), in the unit of the file.
        faces: (faces, 3) int64.
        units: name of the unit; by default recognised by the extent of the first frame.

    Returns:
        The same, in metres; warns of what was changed.

    Raises:
        InputError: it has no faces or too many, a face names a missing vertex, or a number is not finite or not a
            possible length.
    """
    if not len(faces) or not len(vertices):
        raise InputError(f"{path} has no faces, or no frames; a body needs a surface: export it as polygons.")
    refuse_large(path, len(faces))
    if faces.min() < 0 or faces.max() >= vertices.shape[1]:
        raise InputError(f"{path}: a face names a vertex out of range, there are {vertices.shape[1]}.")
    for start in range(0, len(vertices), _CHECKED_FRAMES):
        bad = np.argwhere(~np.isfinite(vertices[start : start + _CHECKED_FRAMES]).all(axis=2))
        if len(bad):
            raise InputError(
                f"{path}: vertex {bad[0, 1]} of frame {start + bad[0, 0]} is not a finite number; export it again."
            )
    unit, note = body_unit(path, extent_of(vertices[0]), units)
    if note is not None:
        warn(f"{path}: {note}")
    if unit != "metres":
        vertices = np.asarray(vertices, dtype=np.float32) * np.float32(UNITS[unit])
    return vertices, _outward(path, vertices[0], faces)


def _outward(path: Path | str, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """`faces`, turned round when the closed surface they make is inside out."""
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    volume = np.einsum("fc,fc->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    if volume >= 0:
        return faces
    warn(f"{path}: the surface is inside out; its faces were flipped.")
    return np.ascontiguousarray(faces[:, ::-1])


def warn_of_oddities(path: Path | str, sequence: VertexSequence) -> None:
    """Warn of a body that is not closed, leaps, or seems to be Z up.

    Args:
        path: its file, for the message.
        sequence: the body.
    """
    if not sequence.is_closed:
        message = f"{path}: the body is not closed, so penetration is not reported; fill its holes to have it."
        warn(message)
    middles = np.array([np.mean(frame[::_LOOKED_AT], axis=0, dtype=np.float64) for frame in sequence.vertices])
    steps = np.linalg.norm(np.diff(middles, axis=0), axis=1)
    if (leaps := steps > max(_FASTEST / sequence.stored_fps, _LEAST_LEAP)).any():
        worst = int(steps.argmax())
        message = (
            f"{path}: the body leaps {leaps.sum()} time(s), farthest by {steps[worst]:.1f} m from frame {worst} to "
            f"{worst + 1}; cloth cannot follow, so cut the sequence there."
        )
        warn(message)
    _, height, depth = np.ptp(sequence.rest_vertices, axis=0)
    if depth > 2.0 * height:
        message = (
            f"{path}: the body is {depth:.2f} m along Z and {height:.2f} m along Y: Z seems to be up, not Y; export it "
            "with Y up."
        )
        warn(message)
