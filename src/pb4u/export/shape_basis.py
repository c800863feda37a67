"""A few shapes whose blends give every frame of a surface: its principal components about the first frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.export.shading import unit_normals
from pb4u.progress import Progress, no_progress

_SAMPLED_VERTICES = 3000
"""Vertices that the principal directions are taken from; more do not change them."""
_VERTICES_AT_ONCE = 1024
"""A block over 1,000 frames takes 12 MB."""
_FRAMES_AT_ONCE = 64
"""Normals of 64 frames of 20,000 vertices take 15 MB."""
_CANDIDATES = 32
"""How many lengths of the basis are tried; in between the next longer one is taken."""


@dataclass(frozen=True, eq=False)
class ShapeBasis:
    """Shapes and weights: positions[t] = start + sum over k of weights[t, k] * shapes[k], within `error`.

    Args:
        start: (vertices, 3) float32 the first frame [m].
        shapes: (shapes, vertices, 3) float32 offsets [m].
        start_normals: (vertices, 3) float32 unit normals of the first frame.
        normal_shapes: (shapes, vertices, 3) float32 offsets of the normals for the same weights, by least squares.
        weights: (frames, shapes) float32 in [0, 1], since Blender clamps weights to this range; the first shape, whose
            weight is always 1, contains the offset needed for that.
        error: largest distance [m] of any vertex in any frame from where it should be.
    """

    start: np.ndarray
    shapes: np.ndarray
    start_normals: np.ndarray
    normal_shapes: np.ndarray
    weights: np.ndarray
    error: float


def fit_shapes(
    positions: np.ndarray, faces: np.ndarray, tolerance: float, most: int, progress: Progress = no_progress
) -> ShapeBasis:
    """The shortest basis that keeps every vertex of every frame within `tolerance` [m], of at most `most` shapes.

    Principal components of an animation: Alexa and Mueller, "Representing animations by principal components",
    2000. Besides the basis only a block of vertices or one frame is in memory.

    Args:
        positions: (frames, vertices, 3) [m], finite.
        faces: (faces, 3) int64.
        tolerance: largest distance of a vertex from where it should be [m].
        most: bound on the number of shapes, at least 2.
        progress: called after each pass over the frames.
    """
    frames, vertices = positions.shape[:2]
    start = np.array(positions[0], dtype=np.float32)
    directions = _directions(positions, start)[:, : most - 1]
    shapes, error = _project(positions, start, directions, tolerance)
    directions = directions[:, : len(shapes)]
    start_normals = unit_normals(start, faces)
    normal_shapes = np.zeros((len(shapes), vertices * 3), dtype=np.float32)
    for first in range(0, frames, _FRAMES_AT_ONCE):
        batch = range(first, min(first + _FRAMES_AT_ONCE, frames))
        offsets = np.stack([unit_normals(positions[t], faces) - start_normals for t in batch])
        normal_shapes += directions[first : batch.stop].T.astype(np.float32) @ offsets.reshape(len(batch), -1)
        progress(batch.stop, frames)
    low, high = directions.min(axis=0), directions.max(axis=0)
    span = np.maximum(high - low, 1e-12)
    weights = (directions - low) / span
    if len(shapes):
        weights = np.column_stack([np.ones(frames), weights])
    return ShapeBasis(
        start,
        _from_zero(shapes, low, span),
        start_normals,
        _from_zero(normal_shapes.reshape(shapes.shape), low, span),
        weights.astype(np.float32),
        error,
    )


def _from_zero(shapes: np.ndarray, low: np.ndarray, span: np.ndarray) -> np.ndarray:
    """Shapes for weights that run from 0 to 1, where those given run from `low` to `low` + `span`."""
    if not len(shapes):
        return shapes
    common = np.einsum("k,kvd->vd", low.astype(np.float32), shapes)
    return np.concatenate([common[None], shapes * span.astype(np.float32)[:, None, None]])


def _directions(positions: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(frames, shapes) orthonormal columns, most important first; the first row is 0 but for rounding."""
    frames, vertices = positions.shape[:2]
    sample = slice(None, None, -(-vertices // _SAMPLED_VERTICES))
    sampled = np.stack([positions[t, sample] - start[sample] for t in range(frames)])
    flat = sampled.reshape(frames, -1).astype(np.float64)
    values, vectors = np.linalg.eigh(flat @ flat.T)
    moving = values > values[-1] * 1e-14 if values[-1] > 0 else np.zeros(frames, dtype=bool)
    return vectors[:, moving][:, ::-1]


def _project(
    positions: np.ndarray, start: np.ndarray, directions: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float]:
    """Shapes along as many of the directions as it takes, and the largest distance that remains [m]."""
    vertices = positions.shape[1]
    shapes = np.empty((directions.shape[1], vertices, 3), dtype=np.float32)
    rows = directions.astype(np.float32)
    counts = np.unique(np.linspace(0, directions.shape[1], _CANDIDATES + 1).round().astype(int))
    remaining = np.zeros(len(counts))
    for first in range(0, vertices, _VERTICES_AT_ONCE):
        block = slice(first, first + _VERTICES_AT_ONCE)
        residual = np.asarray(positions[:, block], dtype=np.float32) - start[block]
        shapes[:, block] = np.tensordot(rows.T, residual, 1)
        for place, count in enumerate(counts):
            rows_of_block = slice(counts[place - 1] if place else 0, count)
            residual = residual - np.tensordot(rows[:, rows_of_block], shapes[rows_of_block, block], 1)
            distance = float(np.sqrt((residual**2).sum(axis=-1).max()))
            remaining[place] = max(remaining[place], distance)
    enough = np.flatnonzero(remaining <= tolerance)
    place = int(enough[0]) if len(enough) else len(counts) - 1
    return shapes[: counts[place]].copy(), float(remaining[place])
