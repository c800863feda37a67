"""Report of one run: counts, timing and metrics, for `pb4u simulate --json` and for every clip of a dataset."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from pb4u.body.contact_region import share_out_of_contact
from pb4u.measures.divergence import skinned_centres
from pb4u.measures.excess import BEATEN_BY, distance_to, excess_heights, series
from pb4u.measures.limbs import Bones, LimbWatch, limbs_sentence, limbs_through_cloth, watched
from pb4u.measures.metrics import measure
from pb4u.measures.overstretch import overstretched_sentences
from pb4u.progress import Progress, no_progress
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory, TrajectoryHeader
from pb4u.simulation.simulator import RunRecord, Simulator


def run_report(
    trajectory: Trajectory,
    simulator: Simulator,
    scene: Scene,
    record: RunRecord,
    progress: Progress = no_progress,
    excess: bool = False,
    reference: Trajectory | None = None,
    limbs: tuple[np.ndarray, LimbWatch] | None = None,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Names, counts, timing and metrics of a run, as JSON but for numbers that are not finite.

    Args:
        trajectory: the frames as written.
        simulator: the simulator that made them.
        scene: the simulated one.
        record: cost of the run and how it ended.
        progress: called with (frames measured, frames in all).
        excess: also measure `excess_height`, three solves a frame, and count the frames that lie below their reference.
        reference: also measure `distance_to_reference`.
        limbs: limbs found through cloth, from `watched`; by default searched for.
        notes: warnings besides the notes of the scene.

    Raises:
        InputError: the trajectory lacks the materials of its garments, or the reference has other meshes.
    """
    measured = measure(trajectory, skinned_centres(scene, trajectory), progress)
    crossed, watch = limbs or watched(Bones.of(scene, trajectory.frame_count, trajectory.fps), trajectory)
    if watch.bones.names:
        measured["limbs_through_cloth"] = limbs_through_cloth(crossed, watch)
        measured["metrics"]["limbs_through_cloth"] = series(crossed.sum(axis=1).astype(float).tolist())
    if record.failed_at is not None and not measured["diverged"]:
        # The frames that are not finite are not written.
        measured |= {"diverged": True, "diverged_at": trajectory.frame_count}
    if excess:
        heights = excess_heights(trajectory, progress)
        measured["metrics"]["excess_height"] = series(heights)
        measured["frames_below_reference"] = sum(height < -BEATEN_BY for height in heights)
    if reference is not None:
        measured["metrics"]["distance_to_reference"] = series(distance_to(trajectory, reference))
    sentences = [
        limbs_sentence(measured.get("limbs_through_cloth", ()), trajectory),
        *overstretched_sentences(trajectory),
    ]
    facts = run_facts(trajectory.header, simulator, scene, record) | {"frames": trajectory.frame_count}
    return {**facts, **measured, "notes": list(dict.fromkeys((*scene.notes, *notes, *filter(None, sentences))))}


def run_facts(header: TrajectoryHeader, simulator: Simulator, scene: Scene, record: RunRecord) -> dict[str, Any]:
    """Names, counts and timing of a run, successful or not, as JSON; no frames.

    Args:
        header: of its trajectory.
        simulator: the simulator that made it.
        scene: the simulated one.
        record: cost of the run.
    """
    return {
        **{name: header.metadata[name] for name in ("garment", "body", "motion", "model")},
        "triangles": len(header.faces),
        "vertices": len(header.rest_positions),
        "mean_edge_length": header.metadata["mean_edge_length"],
        "propagation_steps": simulator.propagation_steps(scene),
        "frames": 0,
        "fps": header.fps,
        "device": simulator.settings().get("device", "cpu"),
        "ms_per_step": record.ms_per_step,
        "solver_iterations": record.solver_iterations,
        "unsolved_steps": record.unsolved,
        "retried_steps": record.retried,
        "body_out_of_contact_percent": _out_of_contact(scene),
        "notes": list(scene.notes),
    }


def _out_of_contact(scene: Scene) -> float | None:
    """Percentage of the bodies' area that takes no part in contact; None without a body."""
    if not scene.colliders:
        return None
    shares = [share_out_of_contact(body.rest_vertices, body.faces, body.contact) for body in scene.colliders]
    return round(100.0 * float(np.mean(shares)), 1)


def machine(device: str) -> dict[str, Any]:
    """Processor, threads and versions that times depend on.

    Args:
        device: "cpu" or "cuda".
    """
    described: dict[str, Any] = {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }
    return described | ({"device": torch.cuda.get_device_name()} if device == "cuda" else {})


def _processor() -> str:
    with open("/proc/cpuinfo", encoding="utf-8") if os.path.exists("/proc/cpuinfo") else open(os.devnull) as lines:
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    return model or platform.processor() or platform.machine()
