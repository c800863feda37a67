"""One rollout of an evaluation: what is simulated, by what and how; its address, its simulation and its metrics."""

from __future__ import annotations

import os
import platform
import time
import warnings
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pb4u import __version__
from pb4u.errors import InputWarning
from pb4u.jobs.job import Failure, Job, address, attempted, require_content

# torch and all that needs it is imported where it is used: a worker sets its number of threads before.
if TYPE_CHECKING:
    from pb4u.measures.excess import Reference
    from pb4u.scene.scene import Scene
    from pb4u.scene.trajectory import Trajectory
    from pb4u.simulation.simulator import Simulator

PROTOCOL_VERSION = 2
"""Raised when a rollout or its measuring comes to mean something else, so that no older result is taken for it."""

FPS = 30.0
"""Frames per second of every protocol."""

PICTURED = 0.6
"""Where in the clip, as a fraction of its length, the frame to draw lies: by then every motion is under way."""


@dataclass(frozen=True)
class SceneRecord:
    """A scene to be made.

    Args:
        garment: built-in name, or file.
        body: built-in name, or file.
        motion: built-in name, or file.
        seed: of a built-in motion; None for a recording.
        triangles: resolution asked for.
        frames: frames to write.
        lead_in: frames simulated before them.
        material: name of the cloth; None for the default one.
        shape: (parameter, value) of the body's shape; empty for its default.
        digests: (field, SHA-256) of every field that is a file; a result belongs to a file's content, not to its place.
    """

    garment: str
    body: str
    motion: str
    seed: int | None
    triangles: int
    frames: int
    lead_in: int = 30
    material: str | None = None
    shape: tuple[tuple[str, float], ...] = ()
    digests: tuple[tuple[str, str], ...] = ()

    def identity(self) -> dict[str, Any]:
        """Fields that distinguish this scene from every other, files by their content."""
        fields = asdict(self)
        for field, content in fields.pop("digests"):
            fields[field] = f"{Path(fields[field]).name} {content}"
        # What is left at its default is not told, as before there was a choice.
        return {key: value for key, value in fields.items() if key not in ("material", "shape") or value}

    def label(self, field: str) -> str:
        """Short name of the garment, body or motion."""
        name = Path(getattr(self, field)).stem if field in dict(self.digests) else getattr(self, field)
        return str(name)


@dataclass(frozen=True)
class ModelRecord:
    """A simulator of the run.

    Args:
        name: name or file that `load_simulator` takes.
        label: name in the tables.
        weights: SHA-256 of a network's weights; None for what has none.
        adapts: whether it has a number of propagation steps that can be set.
    """

    name: str
    label: str
    weights: str | None = None
    adapts: bool = False


@dataclass(frozen=True)
class Settings:
    """Settings of a model's run; for what has no such setting, the value here.

    Args:
        propagation_steps: override of K; None follows the model's own rule.
        refine: solver iterations after each step.
        contact: the garment is pushed out of the body after each step.
        self_contact: cloth feels cloth.
        device: "cpu" or "cuda".
    """

    propagation_steps: int | None = None
    refine: int = 0
    contact: bool = False
    self_contact: bool = False
    device: str = "cpu"

    def identity(self) -> dict[str, Any]:
        """Fields that distinguish these settings from all others."""
        # The six energies that the tables compare do not know contact between cloths, so most runs are without.
        return {key: value for key, value in asdict(self).items() if key != "self_contact" or value}


@dataclass(frozen=True)
class RolloutJob(Job):
    """A rollout to make.

    Args:
        scene: the scene that is simulated.
        model: the simulator.
        settings: settings of the simulator.
        excess: also measure what single steps leave on states shared by all models, and the distance from the solver's
            rollout; costs two solves a frame for each scene.
    """

    scene: SceneRecord
    model: ModelRecord
    settings: Settings
    excess: bool = False

    @property
    def key(self) -> str:
        """Address of the result: the same for the same work, another for any other."""
        identity = {
            "protocol_version": PROTOCOL_VERSION,
            "pb4u": __version__,
            "scene": self.scene.identity(),
            "model": self.model.weights or self.model.name,
            "settings": self.settings.identity(),
            **({"excess": True} if self.excess else {}),
        }
        return address(identity)

    @property
    def device(self) -> str:
        return self.settings.device

    def __str__(self) -> str:
        scene = self.scene
        steps = "" if self.settings.propagation_steps is None else f", K {self.settings.propagation_steps}"
        worn = " ".join(scene.label(field) for field in ("garment", "body", "motion"))
        worn += f" of seed {scene.seed} in {scene.material}" if scene.material else ""
        return f"{self.model.label} on {worn} at {scene.triangles:,} triangles{steps}"


@dataclass(frozen=True)
class Rollout:
    """A rollout that was made.

    Args:
        result: counts, timing and metrics, as JSON but for numbers that are not finite.
        still: one frame of it as the bytes of a trajectory file; None where no frame was written.
    """

    result: dict[str, Any]
    still: bytes | None


def attempt(job: RolloutJob) -> Rollout | Failure:
    """Run a job; whatever goes wrong comes back as a `Failure` with a sentence."""
    return attempted(run, job)


def run(job: RolloutJob) -> Rollout:
    """Simulate and measure.

    Args:
        job: the rollout to make.

    Raises:
        InputError: something of it cannot be used, or changed since it was planned.
    """
    from pb4u.measures.divergence import hold_shifts, skinned_centres, slid_from
    from pb4u.measures.limbs import Bones
    from pb4u.measures.metrics import measure
    from pb4u.scene.trajectory import Trajectory
    from pb4u.simulation.models import load_simulator
    from pb4u.simulation.simulator import RunRecord

    began = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", InputWarning)
        scene = _scene(job.scene)
        _check_weights(job)
        simulator = load_simulator(job.model.name, precision="float32", **asdict(job.settings))
        record = RunRecord()
        frames = list(simulator.written_frames(scene, record))
        header, steps = simulator.header(scene), simulator.propagation_steps(scene)
    mean_edge_length = header.metadata["mean_edge_length"]
    result: dict[str, Any] = {
        "triangles": len(header.faces),
        "vertices": len(header.rest_positions),
        "mean_edge_length": mean_edge_length,
        "propagation_steps": steps,
        "own_steps": _own_steps(simulator, mean_edge_length) or steps,
        "frames": len(frames),
        "failed_at": record.failed_at,
        "ms_per_step": record.ms_per_step,
        "solver_iterations": sum(record.solver_iterations),
        "unsolved_steps": record.unsolved,
        "retried_steps": record.retried,
        "machine": _machine(job.settings.device),
        "notes": list(dict.fromkeys([*scene.notes, *(str(each.message) for each in caught)])),
        "metrics": {},
        "metrics_paper": {},
        "diverged": True,
        "diverged_at": 0,
    }
    still = None
    if frames:
        trajectory = Trajectory.collect(header, frames)
        result |= measure(trajectory, skinned_centres(scene, trajectory), bones=Bones.of(scene, trajectory))
        if record.failed_at is not None and not result["diverged"]:
            result |= {"diverged": True, "diverged_at": len(frames)}
        if job.excess:
            result["metrics"] |= _against_reference(job.scene, simulator, trajectory)
        shifts = hold_shifts(scene, trajectory)
        result["hold_shift"] = {"per_frame": shifts.max(axis=1).tolist(), "max": float(shifts.max())}
        result["slid_at"] = slid_from(shifts)
        result["pictured_frame"] = min(round(PICTURED * (job.scene.frames - 1)), len(frames) - 1)
        still = _still(trajectory, (result["pictured_frame"], _worst_frame(result, len(frames))))
    result["seconds"] = time.perf_counter() - began
    return Rollout(result, still)


# Jobs come sorted by scene: the garment is cut and meshed once for all the models.
@lru_cache(maxsize=1)
def _scene(record: SceneRecord) -> Scene:
    from pb4u.scene.assembly import make_scene

    for field, expected in record.digests:
        require_content(Path(getattr(record, field)), expected)
    return make_scene(
        record.garment,
        record.body,
        record.motion,
        triangles=record.triangles,
        frames=record.frames,
        lead_in=record.lead_in,
        material=record.material,
        body_shape=dict(record.shape),
        fps=FPS,
        seed=record.seed or 0,
    )


@lru_cache(maxsize=1)
def _reference(record: SceneRecord) -> Reference:
    """Solver's rollout of a scene, and the states that all models are compared on."""
    from pb4u.measures.excess import Reference
    from pb4u.simulation.first_frame import Settled
    from pb4u.simulation.simulator import RunRecord
    from pb4u.simulation.stepwise_simulator import SolverSimulator
    from pb4u.simulation.timeline import Timeline

    scene = _scene(record)
    timeline = Timeline.of(scene)
    first = next(iter(Settled().states(timeline, SolverSimulator().method(timeline, RunRecord()))))
    return Reference.of(timeline, first, scene.total_frames, scene.lead_in)


def _against_reference(record: SceneRecord, simulator: Simulator, trajectory: Trajectory) -> dict[str, Any]:
    """Distance [m] of each frame from the reference's, and excess heights [m] on its shared states."""
    from pb4u.measures.excess import BEATEN_BY, series
    from pb4u.simulation.simulator import RunRecord
    from pb4u.simulation.stepwise_simulator import StepwiseSimulator

    reference = _reference(record)
    states = reference.states[record.lead_in :]
    pairs = zip(trajectory.positions, states, strict=False)
    away = [float(np.linalg.norm(x - y.positions.numpy(), axis=1).mean()) for x, y in pairs]
    found: dict[str, Any] = {"distance_to_reference": series(away)}
    if isinstance(simulator, StepwiseSimulator):
        heights = reference.excess(simulator.method(reference.timeline, RunRecord()))
        below = sum(height < -BEATEN_BY for height in heights)
        found["excess_height"] = {**series(heights), "states": len(heights), "below_reference": below}
    return found


def _check_weights(job: RolloutJob) -> None:
    from pb4u.simulation.checkpoint import weights_file

    if job.model.weights:
        with weights_file(job.model.name) as path:
            require_content(path, job.model.weights)


def _own_steps(simulator: Simulator, mean_edge_length: float) -> int | None:
    """K that a network's own rule takes, whatever it was told; None for what has none."""
    from pb4u.simulation.stepwise_simulator import NetworkSimulator

    if not isinstance(simulator, NetworkSimulator):
        return None
    return simulator.checkpoint.model.network.propagation_steps(mean_edge_length) or None


def _worst_frame(result: dict[str, Any], frames: int) -> int:
    """The frame that shows best what is wrong: where it diverged or slid for good, else where most is inside."""
    if result["diverged"]:
        return min(int(result["diverged_at"]), frames - 1)
    if result["slid_at"] is not None:
        return _highest(result["hold_shift"]["per_frame"])
    return _highest(result["metrics"].get("penetration_percent", {}).get("per_frame", [0.0]))


def _highest(values: list[float]) -> int:
    return max(range(len(values)), key=values.__getitem__)


def _still(trajectory: Trajectory, frames: tuple[int, ...]) -> bytes:
    kept = list(frames)
    single = replace(
        trajectory,
        positions=trajectory.positions[kept],
        velocities=trajectory.velocities[kept],
        body_positions=trajectory.body_positions[kept],
    )
    return single.encode()


def _machine(device: str) -> dict[str, Any]:
    import torch

    described: dict[str, Any] = {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }
    if device == "cuda":
        described["device"] = torch.cuda.get_device_name()
    return described


def _processor() -> str:
    with open("/proc/cpuinfo", encoding="utf-8") if os.path.exists("/proc/cpuinfo") else open(os.devnull) as lines:
        named = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    return named or platform.processor() or platform.machine()
