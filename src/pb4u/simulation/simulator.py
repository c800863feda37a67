"""Simulators, which turn a Scene into a Trajectory: networks, the solver, bare skinning, an outside solver."""

from __future__ import annotations

import math
import statistics
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pb4u import __version__
from pb4u.body.body_model import PosedBody
from pb4u.errors import Pb4uError, interrupt_behind
from pb4u.physics.solver.newton_solver import Solution
from pb4u.progress import Progress, no_progress, progress_or_bar
from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader
from pb4u.scene.trajectory_file import TrajectoryWriter

_CHUNK = 32
"""Frames skinned at a time."""


@dataclass
class RunRecord:
    """Cost of a run, and the frame at which it failed.

    Args:
        step_seconds: wall time of every simulated step, file writing and metrics left out.
        failed_at: written frame at which the state stopped being finite, or None.
        solver_iterations: iterations the solver made, per step.
        unsolved: steps that the solver left above its tolerance.
        retried: times that the solver made a step again, because a few iterations left it failed or bodies turned
            strained cloth aside.
    """

    step_seconds: list[float] = field(default_factory=list)
    failed_at: int | None = None
    solver_iterations: list[int] = field(default_factory=list)
    unsolved: int = 0
    retried: int = 0

    def count_retried(self, solution: Solution) -> None:
        """Count a retry, and its iterations where those of its step are counted.

        Args:
            solution: of the retry.
        """
        self.retried += 1
        if self.solver_iterations:
            self.solver_iterations[-1] += solution.iterations

    def lost_early(self) -> Pb4uError:
        """What to raise where there is no frame to write."""
        early = -(self.failed_at or 0)
        when = f"{early} frames before the first one to write" if early else "in the very first frame"
        return Pb4uError(f"The state stopped being finite {when}; nothing was written. Try --model solver.")

    @property
    def ms_per_step(self) -> float:
        """Median wall time of a step [ms]."""
        return 1000.0 * statistics.median(self.step_seconds) if self.step_seconds else 0.0


class Simulator(ABC):
    """A method that moves garments.

    Attributes:
        name: name that the user gives.
        fps: the frame rate it has to run at [1/s], or None where it takes any.
    """

    name: str
    fps: float | None = None

    @abstractmethod
    def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
        """States of frames 0..total_frames-1, lead-in included.

        Ends early, with `record.failed_at` set, when the state stops being finite.

        Args:
            scene: garments and bodies.
            record: receives the cost of the run and how it ended.
        """

    def propagation_steps(self, scene: Scene) -> int | None:
        """Number K of propagation steps for a scene; None where the method has none.

        Args:
            scene: the scene.
        """
        return None

    def settings(self) -> dict[str, Any]:
        """Further entries of a trajectory's metadata."""
        return {}

    def written_frames(
        self,
        scene: Scene,
        record: RunRecord | None = None,
        progress: Progress = no_progress,
        simulated: Iterable[State] | None = None,
    ) -> Iterator[Frame]:
        """Frames to write, as they are simulated.

        Args:
            scene: garments and bodies.
            record: receives the cost of the run and how it ended.
            progress: called with (frames done, frames in all), lead-in included.
            simulated: its states, where they are there already, and noted in `record`.
        """
        record = record or RunRecord()
        states = self.rollout(scene, record) if simulated is None else iter(simulated)
        for frame in range(scene.total_frames):
            began = time.perf_counter()
            try:
                state = next(states, None)
            except SystemError as error:
                raise interrupt_behind(error) or error from None
            if state is None:
                return
            if simulated is None:
                record.step_seconds.append(time.perf_counter() - began)
            progress(frame + 1, scene.total_frames)
            if frame >= scene.lead_in:
                yield written_frame(scene, state)

    def simulate(self, scene: Scene, progress: Progress | None = None) -> Trajectory:
        """Simulate a scene in memory.

        Args:
            scene: garments and bodies.
            progress: called with (frames done, frames in all), lead-in included; by default a bar on standard error
                where that is a terminal. `pb4u.progress.no_progress` is quiet.

        Raises:
            Pb4uError: the state stopped being finite before the first frame to write.
        """
        record = RunRecord()
        with progress_or_bar(progress, self.name) as heard:
            rows = list(self.written_frames(scene, record, heard))
        if not rows:
            raise record.lost_early()
        return Trajectory.collect(self.header(scene), rows)

    def simulate_to(
        self,
        scene: Scene,
        path: str | Path,
        record: RunRecord | None = None,
        progress: Progress | None = None,
        seen: Callable[[Frame], None] | None = None,
    ) -> Trajectory:
        """Simulate into a file as frames come, and open it; frames are kept when the state stops being finite.

        Args:
            scene: garments and bodies.
            path: trajectory file to write.
            record: receives the cost of the run and how it ended.
            progress: called with (frames done, frames in all), lead-in included; a bar by default, as in `simulate`.
            seen: called with every frame that was written.

        Raises:
            Pb4uError: the state stopped being finite before the first frame to write.
        """
        record = record or RunRecord()
        with TrajectoryWriter(path, self.header(scene)) as writer, progress_or_bar(progress, self.name) as heard:
            for frame in self.written_frames(scene, record, heard):
                writer.append(frame)
                if seen is not None:
                    seen(frame)
        if not writer.frame_count:
            raise record.lost_early()
        return Trajectory.open(path)

    def header(self, scene: Scene) -> TrajectoryHeader:
        """Static part of the trajectory that this simulator makes of `scene`.

        Args:
            scene: the scene.
        """
        garments = [dressed.garment for dressed in scene.garments]
        edges = sum(len(garment.edge_lengths) for garment in garments)
        shape = scene.labels.get("body_shape")
        metadata = {
            "garment": scene.labels.get("garment", "+".join(garment.name for garment in garments)),
            "triangles": sum(garment.triangle_count for garment in garments),
            "mean_edge_length": sum(len(g.edge_lengths) / edges * g.mean_edge_length for g in garments),
            "motion": scene.labels.get("motion", ""),
            "body": scene.labels.get("body", "+".join(body.name for body in scene.colliders)),
            **({"body_shape": shape} if shape else {}),
            "model": self.name,
            "propagation_steps": self.propagation_steps(scene),
            "seed": scene.seed,
            "versions": {"pb4u": __version__, "torch": torch.__version__, "numpy": np.__version__},
            **scene.environment.metadata,
            "rest_shape": scene.labels.get("rest_shape", "moulded"),
            "lead_in": scene.lead_in,
            "heading": _heading(scene),
            "notes": list(scene.notes),
            **self.settings(),
        }
        return TrajectoryHeader.of(scene, metadata)


class SkinningSimulator(Simulator):
    """Bare skinning: the garments carried by the bodies without any physics."""

    name = "skinning"

    def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
        previous = None
        for start in range(0, scene.total_frames, _CHUNK):
            stop = min(start + _CHUNK, scene.total_frames)
            block = torch.cat([dressed.placement.positions(start, stop) for dressed in scene.garments], dim=1)
            for offset, positions in enumerate(block):
                velocities = (positions - (positions if previous is None else previous)) / scene.dt
                previous = positions
                yield State(positions, velocities, start + offset)


def written_frame(scene: Scene, state: State) -> Frame:
    """The frame that a state is written as; beyond the last of the scene its bodies stay where they are then.

    Args:
        scene: garments and bodies.
        state: of the garments, and the number of the frame.
    """
    positions, velocities = (
        values.detach().cpu().numpy().astype(np.float32) for values in (state.positions, state.velocities)
    )
    frame = min(state.frame, scene.total_frames - 1)
    bodies = [body.positions(frame, frame + 1)[0].numpy() for body in scene.colliders]
    return Frame(positions, velocities, np.concatenate([np.zeros((0, 3), dtype=np.float32), *bodies]))


def _heading(scene: Scene) -> float:
    """Angle about the vertical [rad] in which the first body faces in the first written frame; 0 is +Z."""
    collider = next(iter(scene.colliders), None)
    if not isinstance(collider, PosedBody):
        return 0.0
    forward = collider.transforms[scene.lead_in, 0, :, 2].double()
    return math.atan2(forward[0], forward[2])
