"""What is told of one run: counts, timing and metrics, for `pb4u simulate --json` and for every clip of a dataset."""

from __future__ import annotations

from typing import Any

from pb4u.measures.divergence import skinned_centres
from pb4u.measures.limbs import Bones, limbs_sentence
from pb4u.measures.metrics import measure
from pb4u.progress import Progress, unheard
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord, Simulator


def run_report(
    trajectory: Trajectory, simulator: Simulator, scene: Scene, record: RunRecord, progress: Progress = unheard
) -> dict[str, Any]:
    """Names, counts, timing and metrics of a run, as JSON but for numbers that are not finite.

    Args:
        trajectory: the frames as written.
        simulator: what made them.
        scene: what was simulated.
        record: cost of the run and how it ended.
        progress: called with (frames measured, frames in all).

    Raises:
        InputError: the trajectory does not say what its garments are made of.
    """
    bones = Bones.of(scene, trajectory)
    measured = measure(trajectory, skinned_centres(scene, trajectory), progress, bones)
    if record.failed_at is not None and not measured["diverged"]:
        # The frames that are not finite are not written.
        measured |= {"diverged": True, "diverged_at": trajectory.frame_count}
    said = limbs_sentence(measured.get("limbs_through_cloth", ()), trajectory.frame_count)
    noted = ("garment", "body", "motion", "model")
    return {
        **{name: trajectory.metadata[name] for name in noted},
        "triangles": len(trajectory.faces),
        "vertices": trajectory.positions.shape[1],
        "mean_edge_length": trajectory.metadata["mean_edge_length"],
        "propagation_steps": simulator.propagation_steps(scene),
        "frames": trajectory.frame_count,
        "fps": trajectory.fps,
        "device": simulator.settings().get("device", "cpu"),
        "ms_per_step": record.ms_per_step,
        "solver_iterations": record.solver_iterations,
        "unsolved_steps": record.unsolved,
        "steps_made_anew": record.made_anew,
        "notes": [*scene.notes, *([said] if said else [])],
        **measured,
    }
