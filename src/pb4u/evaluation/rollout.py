"""Runs one rollout of an evaluation and measures it. What a worker does."""

from __future__ import annotations

import os
import platform
import tempfile
import time
import traceback
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from pb4u.errors import InputError, InputWarning, Pb4uError
from pb4u.evaluation.rollout_job import FPS, RolloutJob, SceneRecord, digest

PICTURED = 0.6
"""Where in the clip, as a fraction of its length, the frame lies that is kept to be drawn."""


@dataclass(frozen=True)
class Rolled:
    """A rollout that was made.

    Args:
        result: counts, timing and metrics, as JSON; numbers that are not finite are None.
        still: one frame of it as the bytes of a trajectory file; None where no frame was written.
    """

    result: dict[str, Any]
    still: bytes | None


@dataclass(frozen=True)
class Refused:
    """A rollout that could not be made.

    Args:
        sentence: why, in plain words.
        trace: where, for the maintainers.
    """

    sentence: str
    trace: str


def attempt(job: RolloutJob) -> Rolled | Refused:
    """Run a job; whatever goes wrong comes back as a sentence."""
    try:
        return run(job)
    except Pb4uError as error:
        return Refused(" ".join(str(error).split()), traceback.format_exc())
    except MemoryError:
        return Refused("There was not enough memory for it.", traceback.format_exc())
    except Exception as error:
        sentence = f"It broke off unexpectedly: {type(error).__name__}: {error}"
        return Refused(" ".join(sentence.split()), traceback.format_exc())


def run(job: RolloutJob) -> Rolled:
    """Simulate and measure. Raises InputError where something of it cannot be used, or changed since it was planned."""
    from pb4u.simulation.models import load_simulator
    from pb4u.simulation.simulator import RunRecord

    began = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", InputWarning)
        scene = _scene(job.scene)
        _check_weights(job)
        simulator = load_simulator(
            job.model.name,
            contact=job.settings.contact,
            refine=job.settings.refine,
            propagation_steps=job.settings.propagation_steps,
            device=job.settings.device,
        )
        record = RunRecord()
        frames = list(simulator.written_frames(scene, record))
        header, steps = simulator.header(scene), simulator.propagation_steps(scene)
    worn = scene.garments[0].garment
    result: dict[str, Any] = {
        "triangles": worn.triangle_count,
        "vertices": len(worn.vertices),
        "mean_edge_length": worn.mean_edge_length,
        "propagation_steps": steps,
        "own_steps": _own_steps(simulator, worn.mean_edge_length) or steps,
        "frames": len(frames),
        "failed_at": record.failed_at,
        "ms_per_step": record.ms_per_step,
        "solver_iterations": sum(record.solver_iterations),
        "unsolved_steps": record.unsolved,
        "machine": _machine(job.settings.device),
        "notes": list(dict.fromkeys([*scene.notes, *(str(each.message) for each in caught)])),
        "metrics": {},
        "metrics_paper": {},
        "diverged": True,
        "diverged_at": 0,
    }
    still = None
    if frames:
        from pb4u.evaluation.metrics import measure
        from pb4u.evaluation.skinned_centres import skinned_centres
        from pb4u.scene.trajectory import Trajectory

        trajectory = Trajectory.collect(header, frames)
        measured = measure(trajectory, skinned=skinned_centres(scene, trajectory))
        result |= measured
        if record.failed_at is not None and not measured["diverged"]:
            result |= {"diverged": True, "diverged_at": len(frames)}
        result["pictured_frame"] = min(round(PICTURED * (job.scene.frames - 1)), len(frames) - 1)
        still = _still(trajectory, result["pictured_frame"])
    result["seconds"] = time.perf_counter() - began
    return Rolled(finite(result), still)


# Jobs come sorted by scene: the garment is cut and meshed once for all the models.
@lru_cache(maxsize=1)
def _scene(record: SceneRecord) -> Any:
    from pb4u.scene.assembly import make_scene

    for field, expected in record.digests:
        _check_content(Path(getattr(record, field)), expected)
    return make_scene(
        record.garment,
        record.body,
        record.motion,
        triangles=record.triangles,
        frames=record.frames,
        lead_in=record.lead_in,
        fps=FPS,
        seed=record.seed or 0,
    )


def _check_weights(job: RolloutJob) -> None:
    from pb4u.simulation.checkpoint import weights_file

    if job.model.weights:
        with weights_file(job.model.name) as path:
            _check_content(path, job.model.weights)


def _check_content(path: Path, expected: str) -> None:
    if not path.is_file():
        raise InputError(f"The file {path} is not there on the machine that was to use it.")
    if digest(path) != expected:
        raise InputError(f"The file {path} changed after the run was planned; start the run again.")


def _own_steps(simulator: Any, mean_edge_length: float) -> int | None:
    """K that a network's own rule takes, whatever it was told; None for what has none."""
    from pb4u.simulation.stepwise_simulator import NetworkSimulator

    if not isinstance(simulator, NetworkSimulator):
        return None
    return simulator.checkpoint.model.network.propagation_steps(mean_edge_length) or None


def _still(trajectory: Any, frame: int) -> bytes:
    from pb4u.scene.trajectory import Trajectory

    kept = slice(frame, frame + 1)
    single = Trajectory(
        trajectory.header, trajectory.positions[kept], trajectory.velocities[kept], trajectory.body_positions[kept]
    )
    with tempfile.TemporaryDirectory() as folder:
        return single.save(Path(folder) / "still.npz").read_bytes()


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


def finite(value: Any) -> Any:
    """`value` as JSON that every reader takes: numbers that are not finite become None."""
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return value
