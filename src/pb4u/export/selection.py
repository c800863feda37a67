"""Parts of a trajectory: some of its frames, or its motion carried to the author's own mesh."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from pb4u.errors import InputError, InputWarning
from pb4u.export.lazy_frames import LazyFrames
from pb4u.scene.trajectory import Trajectory


def select_frames(trajectory: Trajectory, span: tuple[int, int] | None, every: int) -> Trajectory:
    """Frames span[0]..span[1]-1, every n-th of them.

    Warns where the span goes beyond the last frame. Raises InputError when none is left.
    """
    if every < 1:
        raise InputError(f"The stride from one kept frame to the next must be 1 or more, not {every}.")
    first, last = (0, trajectory.frame_count) if span is None else (span[0], min(span[1], trajectory.frame_count))
    kept = slice(first, last, every)
    if first >= min(last, trajectory.frame_count):
        raise InputError(
            f"The trajectory has frames 0 to {trajectory.frame_count - 1}; none lies in the range asked for."
        )
    if span is not None and span[1] > last:
        warnings.warn(
            f"The trajectory has {last} frames; of the range {first}:{span[1]}, {first}:{last} is there.",
            InputWarning,
            stacklevel=2,
        )
    return Trajectory(
        replace(trajectory.header, fps=trajectory.fps / every),
        trajectory.positions[kept],
        trajectory.velocities[kept],
        trajectory.body_positions[kept],
    )


def on_source(trajectory: Trajectory) -> Trajectory:
    """The same motion on the author's mesh, carried frame by frame; the trajectory itself where the meshes are one."""
    track = trajectory.header.source
    if track is None:
        return trajectory

    corners = trajectory.faces[track.triangle]
    weights = track.barycentric.astype(np.float32)

    def carry(values: np.ndarray) -> np.ndarray:
        def compute(frames: Any, vertices: Any) -> np.ndarray:
            asked, weight = corners[vertices], weights[vertices]
            at = values[frames][..., asked.ravel(), :]
            return np.einsum("...k,...kd->...d", weight, at.reshape(*at.shape[:-2], *asked.shape, 3))

        return LazyFrames(len(values), len(weights), compute).as_array()

    header = replace(
        trajectory.header,
        faces=track.faces,
        rest_positions=carry(trajectory.header.rest_positions[None])[0],
        pinned=trajectory.header.pinned[corners].all(axis=1),
        vertex_garment=trajectory.header.vertex_garment[corners[:, 0]],
        uvs=track.uvs,
        uv_faces=track.uv_faces,
        source=None,
        polygons=track.polygons,
    )
    return Trajectory(header, carry(trajectory.positions), carry(trajectory.velocities), trajectory.body_positions)


def resampled(trajectory: Trajectory, fps: float, frames: int | None = None) -> Trajectory:
    """The same motion at another frame rate, interpolated in straight lines, and at most `frames` frames of it."""
    seconds = (trajectory.frame_count - 1) / trajectory.fps
    count = int(seconds * fps + 1e-6) + 1
    at = np.arange(min(count, frames or count)) * (trajectory.fps / fps)
    low = np.minimum(at.astype(int), trajectory.frame_count - 1)
    high = np.minimum(low + 1, trajectory.frame_count - 1)
    weight = (at - low).astype(np.float32)[:, None, None]

    def between(values: np.ndarray) -> np.ndarray:
        return (1 - weight) * values[low] + weight * values[high]

    return Trajectory(
        replace(trajectory.header, fps=fps),
        between(trajectory.positions),
        between(trajectory.velocities),
        between(trajectory.body_positions),
    )
