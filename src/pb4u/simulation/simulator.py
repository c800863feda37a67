"""What takes a Scene and gives a Trajectory: networks, the solver, bare skinning, an outside solver alike."""

from __future__ import annotations

import statistics
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError, Pb4uError
from pb4u.garment.garment import SourceMap
from pb4u.scene.polygons import Polygons
from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.scene.trajectory import Frame, SourceTrack, Trajectory, TrajectoryHeader, TrajectoryWriter

Progress = Callable[[int, int], None]
"""Called with (frames done, frames in all), lead-in included."""


@dataclass
class RunRecord:
    """What a run cost and whether it came to its end.

    Args:
        step_seconds: wall time of every simulated step, file writing and metrics left out.
        failed_at: written frame at which the state stopped being finite, or None.
        solver_iterations: iterations the solver made, per step.
        unsolved: steps that the solver left above its tolerance.
    """

    step_seconds: list[float] = field(default_factory=list)
    failed_at: int | None = None
    solver_iterations: list[int] = field(default_factory=list)
    unsolved: int = 0

    @property
    def ms_per_step(self) -> float:
        """Median milliseconds a step."""
        return 1000.0 * statistics.median(self.step_seconds) if self.step_seconds else 0.0


class Simulator(ABC):
    """Anything that moves garments.

    Attributes:
        name: what the user called it.
        fps: the frame rate it has to run at [1/s], or None where it takes any.
    """

    name: str
    fps: float | None = None

    @abstractmethod
    def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
        """States of frames 0..total_frames-1, lead-in included.

        Ends early, with `record.failed_at` set, when the state stops being finite.
        """

    def propagation_steps(self, scene: Scene) -> int | None:
        """K of the paper for this scene; None where the method has none."""
        return None

    def settings(self) -> dict[str, Any]:
        """What else to note in a trajectory's metadata."""
        return {}

    def written_frames(
        self, scene: Scene, record: RunRecord | None = None, progress: Progress | None = None
    ) -> Iterator[Frame]:
        """The frames to write, as they are simulated."""
        record = record or RunRecord()
        collider = scene.colliders[0]
        states = self.rollout(scene, record)
        for frame in range(scene.total_frames):
            began = time.perf_counter()
            state = next(states, None)
            if state is None:
                return
            record.step_seconds.append(time.perf_counter() - began)
            if progress:
                progress(frame + 1, scene.total_frames)
            if frame >= scene.lead_in:
                yield Frame(
                    state.positions.detach().cpu().numpy().astype(np.float32),
                    state.velocities.detach().cpu().numpy().astype(np.float32),
                    collider.positions(frame, frame + 1)[0].numpy(),
                )

    def simulate(self, scene: Scene, progress: Progress | None = None) -> Trajectory:
        """Simulate in memory."""
        return Trajectory.collect(self.header(scene), self.written_frames(scene, progress=progress))

    def simulate_to(
        self, scene: Scene, path: str | Path, record: RunRecord | None = None, progress: Progress | None = None
    ) -> Trajectory:
        """Simulate into a file as frames come, and open it. What was simulated is kept when the state fails."""
        record = record or RunRecord()
        with TrajectoryWriter(path, self.header(scene)) as writer:
            for frame in self.written_frames(scene, record, progress):
                writer.append(frame)
        if not writer.frame_count:
            early = -(record.failed_at or 0)
            when = f"{early} frames before the first one to write" if early else "in the very first frame"
            raise Pb4uError(f"The state stopped being finite {when}; nothing was written. Try --model solver.")
        return Trajectory.open(path)

    def header(self, scene: Scene) -> TrajectoryHeader:
        """The static part of the trajectory this simulator makes of `scene`. Raises InputError for several garments."""
        if len(scene.garments) > 1:
            raise InputError(f"{self.name} simulates one garment so far, and the scene has {len(scene.garments)}.")
        worn, collider = scene.garments[0].garment, scene.colliders[0]
        metadata = {
            "garment": scene.labels.get("garment", worn.name),
            "triangles": worn.triangle_count,
            "mean_edge_length": worn.mean_edge_length,
            "motion": scene.labels.get("motion", ""),
            "body": scene.labels.get("body", collider.name),
            "model": self.name,
            "propagation_steps": self.propagation_steps(scene),
            "seed": scene.seed,
            "versions": _versions(),
            "material": asdict(worn.material),
            "gravity": scene.gravity.tolist(),
            "ground_height": scene.ground_height,
            "lead_in": scene.lead_in,
            "heading": _heading(scene),
            "notes": list(scene.notes),
            **self.settings(),
        }
        return TrajectoryHeader(
            faces=worn.faces,
            rest_positions=worn.vertices.astype(np.float32),
            pinned=worn.pinned,
            vertex_garment=np.zeros(len(worn.vertices), dtype=np.int32),
            body_faces=collider.faces,
            body_contact=collider.contact,
            fps=scene.fps,
            metadata=metadata,
            uvs=worn.uvs,
            uv_faces=worn.uv_faces,
            source=None if worn.source is None else _source_track(worn.source),
        )


def _source_track(source_map: SourceMap) -> SourceTrack:
    from pb4u.geometry.triangulation import triangulate

    mesh = source_map.source
    corners, _ = triangulate(mesh.vertices, mesh.polygons)
    uv_faces = None if mesh.polygon_uvs is None else np.concatenate(mesh.polygon_uvs)[corners]
    faces = np.concatenate(mesh.polygons)[corners]
    return SourceTrack(
        faces, source_map.triangle, source_map.barycentric, mesh.uvs, uv_faces,
        Polygons.of(mesh.polygons, mesh.polygon_uvs),
    )  # fmt: skip


def _heading(scene: Scene) -> float:
    """Angle about the vertical [rad] in which the body faces in the first written frame; 0 is +Z."""
    from pb4u.body.body_model import PosedBody

    collider = scene.colliders[0]
    if not isinstance(collider, PosedBody):
        return 0.0
    w, x, y, z = collider.poses.rotations[scene.lead_in, 0]
    forward = np.array([2 * (x * z + w * y), 0.0, 1 - 2 * (x * x + y * y)])
    return float(np.arctan2(forward[0], forward[2]))


def _versions() -> dict[str, str]:
    found = {}
    for package in ("pb4u", "torch", "numpy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found
