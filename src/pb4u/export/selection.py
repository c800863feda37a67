"""Trajectories made of another: some of its frames, or its motion on the author's own mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, cast

import numpy as np
from scipy.spatial import cKDTree

from pb4u.errors import InputError, warn
from pb4u.geometry.appearance import Appearances
from pb4u.scene.author_mesh import Polygons
from pb4u.scene.trajectory import Trajectory, TrajectoryHeader, ranges_of

Compute = Callable[[Any, Any], np.ndarray]
"""(index of frames, index of vertices) -> positions of those; an int as the first drops the frame axis."""

_ALL = slice(None)


class LazyFrames:
    """Behaves like an array (frames, vertices, 3) float32, but computes only the parts that are read.

    `frames[t]`, `frames[a:b]`, `frames[:, vertices]` and iteration compute only that part; any other use computes the
    full array.

    Args:
        frames: how many there are.
        vertices: how many each has.
        compute: gives positions [m] of some vertices at some frames.
    """

    def __init__(self, frames: int, vertices: int, compute: Compute) -> None:
        self.shape = (frames, vertices, 3)
        self.dtype = np.dtype(np.float32)
        self.ndim = 3
        self._compute = compute

    def as_array(self) -> np.ndarray:
        """This object, typed as an array (frames, vertices, 3) float32 [m]."""
        return cast(np.ndarray, self)

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[t] for t in range(len(self)))

    def __getitem__(self, key: Any) -> np.ndarray:
        keys = key if isinstance(key, tuple) else (key,)
        if len(keys) > 2 or any(k is Ellipsis or k is None for k in keys):
            return np.asarray(self)[key]
        frames, vertices = (*keys, _ALL)[:2]
        if isinstance(frames, int | np.integer):
            if not -len(self) <= frames < len(self):
                raise IndexError(f"There is no frame {frames} in {len(self)}.")
            frames = int(frames) % len(self)
        return self._compute(frames, vertices)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self._compute(_ALL, _ALL), dtype=dtype)


def select_frames(trajectory: Trajectory, span: tuple[int, int] | None, every: int) -> Trajectory:
    """A trajectory of some of the frames; an InputWarning says where the span goes beyond the last one.

    Args:
        trajectory: to take them from.
        span: first frame kept and the one after the last; all by default.
        every: stride from one kept frame to the next.

    Raises:
        InputError: no frame is left.
    """
    if every < 1:
        raise InputError(f"The stride from one kept frame to the next must be 1 or more, not {every}.")
    first, last = (0, trajectory.frame_count) if span is None else (span[0], min(span[1], trajectory.frame_count))
    frames = slice(first, last, every)
    if first >= min(last, trajectory.frame_count):
        raise InputError(f"The trajectory has frames 0 to {trajectory.frame_count - 1}; none lies in the range.")
    if every > 1 and last - first > 1 and every >= last - first:
        raise InputError(f"Every {every}th of {last - first} frames is a single frame; give a smaller stride.")
    if span is not None and span[1] > last:
        warn(f"The trajectory has {last} frames; of the range {first}:{span[1]}, only {first}:{last} exists.")
    return trajectory.with_frames(lambda values: values[frames], trajectory.fps / every)


def looks_are_on_source(header: TrajectoryHeader) -> bool:
    """Whether a garment has its colours and images only on the author's mesh, as after remeshing.

    Args:
        header: of the trajectory.
    """
    track = header.source
    if track is None or track.appearances is None:
        return False

    def coloured(looks: Appearances | None, outlines: Polygons, owners: np.ndarray) -> set[int]:
        if looks is None:
            return set()
        first = outlines.corners[np.cumsum(outlines.sizes) - outlines.sizes]
        return set(owners[first[looks.of_face >= 0]].tolist())

    there = track.polygons or Polygons.of_triangles(track.faces, None)
    simulated = coloured(header.appearances, header.outlines, header.vertex_garment)
    return not coloured(track.appearances, there, source_garments(header)) <= simulated


def on_source(trajectory: Trajectory) -> Trajectory:
    """The same motion on the author's mesh, frame by frame; the trajectory itself where it has no other mesh.

    Args:
        trajectory: the trajectory.
    """
    track = trajectory.header.source
    if track is None:
        return trajectory
    on_mesh, owners = source_motion(trajectory.header), source_garments(trajectory.header)
    beneath, layers = track.triangle[track.faces[:, 0]], trajectory.header.material_layers
    trims, buttons = trajectory.header.trims, trajectory.header.buttons
    rest = on_mesh(trajectory.header.rest_positions[None])[0]
    header = replace(
        trajectory.header,
        metadata=_counted_anew(trajectory.header, owners, beneath),
        faces=track.faces,
        rest_positions=rest,
        pinned=trajectory.header.pinned[trajectory.faces[track.triangle]].all(axis=1),
        vertex_garment=owners,
        uvs=track.uvs,
        uv_faces=track.uv_faces,
        source=None,
        polygons=track.polygons,
        appearances=track.appearances,
        rest_uv=None,
        material_layers=None if layers is None else layers[beneath],
        # What elastic gathers is not gathered at rest on the author's mesh.
        trims=None if trims is None else np.column_stack([trims[beneath, 0], np.ones(len(beneath))]),
        buttons=None if buttons is None else cKDTree(rest).query(trajectory.header.rest_positions[buttons])[1],
    )
    return Trajectory(header, on_mesh(trajectory.positions), on_mesh(trajectory.velocities), trajectory.body_positions)


def _counted_anew(header: TrajectoryHeader, vertices: np.ndarray, beneath: np.ndarray) -> dict[str, Any]:
    """Metadata with the rows of each garment and material on another mesh.

    Args:
        header: of the trajectory.
        vertices: (vertices,) int32 the garment of each vertex of the other mesh.
        beneath: (faces,) int64 the simulated face under each of its faces.
    """
    faces = header.vertex_garment[header.faces[beneath, 0]]

    def rows(owners: np.ndarray, number: int) -> list[int]:
        return np.searchsorted(owners, [number, number + 1]).tolist()

    garments = [
        {**entry, "vertices": rows(vertices, number), "triangles": rows(faces, number)}
        for number, entry in enumerate(header.garments)
    ]
    materials = [{**material, "faces": ranges_of(faces[beneath])} for material, faces in header.materials]
    return {**header.metadata, "triangles": len(beneath), "garments": garments, "materials": materials}


def source_motion(header: TrajectoryHeader) -> Callable[[np.ndarray], np.ndarray]:
    """Function that maps values (frames, vertices, 3) to the author's mesh (frames, source vertices, 3).

    Args:
        header: of the trajectory; where it has no other mesh, values stay as they are.
    """
    if header.source is None:
        return lambda values: values
    corners = header.faces[header.source.triangle]
    weights = header.source.barycentric.astype(np.float32)

    def on_mesh(values: np.ndarray) -> np.ndarray:
        def compute(frames: Any, vertices: Any) -> np.ndarray:
            chosen, weight = corners[vertices], weights[vertices]
            at = values[frames][..., chosen.ravel(), :]
            return np.einsum("...k,...kd->...d", weight, at.reshape(*at.shape[:-2], *chosen.shape, 3))

        return LazyFrames(len(values), len(weights), compute).as_array()

    return on_mesh


def source_garments(header: TrajectoryHeader) -> np.ndarray:
    """Garment (source vertices,) int32 of each vertex of the author's mesh; of the simulated one where it is the same.

    Args:
        header: of the trajectory.
    """
    if header.source is None:
        return header.vertex_garment
    return header.vertex_garment[header.faces[header.source.triangle, 0]]


def resampled_count(frames: int, fps: float, rate: float) -> int:
    """Number of frames of the same time at another rate.

    Args:
        frames: there are now.
        fps: their rate [1/s].
        rate: the other rate [1/s].
    """
    return int((frames - 1) / fps * rate + 1e-6) + 1


def resampled(trajectory: Trajectory, fps: float, frames: int | None = None) -> Trajectory:
    """The same motion at another frame rate, interpolated in straight lines.

    Args:
        trajectory: to interpolate.
        fps: frames per second.
        frames: most frames to keep; all by default.
    """
    count = resampled_count(trajectory.frame_count, trajectory.fps, fps)
    at = np.arange(min(count, frames or count)) * (trajectory.fps / fps)
    low = np.minimum(at.astype(int), trajectory.frame_count - 1)
    high = np.minimum(low + 1, trajectory.frame_count - 1)
    weight = (at - low).astype(np.float32)[:, None, None]

    def between(values: np.ndarray) -> np.ndarray:
        return (1 - weight) * values[low] + weight * values[high]

    return trajectory.with_frames(between, fps)
