"""The tables of docs/models.md: what a network does on whole test clips, against the floor of the solver.

    python benchmarks/weights_table.py --out FOLDER [--model pb4u-small] [--tables alone,refined,motions]

Each rollout is kept in the folder, under its weights, its trajectory too, to be looked at. A run that was stopped goes
on where it was, and several may share the folder. The floor is the stored one of the base level over as many frames, or
over 30 where there is none of so many.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from pb4u.garment.library import LEVELS
from pb4u.io.atomic_file import replace_file
from pb4u.jobs.job import digest
from pb4u.measures.metrics import ENERGIES, measure
from pb4u.paper.reference_energies import ratio, stored_reference
from pb4u.scene.assembly import make_scene
from pb4u.scene.catalogue import SEEDS, TRAINING_GARMENTS
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.checkpoint import weights_file
from pb4u.simulation.models import load_simulator
from pb4u.simulation.simulator import RunRecord

REFINE = 5
ALL, MAIN, OTHERS = TRAINING_GARMENTS, ("tshirt", "dress"), ("tanktop", "longsleeve")
WALK, OTHER_MOTIONS = ("walk",), ("dance", "jump", "turn")

ROLLED = {
    "alone": (
        ("base", 200, ALL, WALK),
        ("11K", 200, MAIN, WALK),
        ("11K", 60, OTHERS, WALK),
        ("18K", 40, MAIN, WALK),
        ("25K", 40, MAIN, WALK),
        ("38K", 30, MAIN, WALK),
    ),
    "refined": (
        ("base", 200, ALL, WALK),
        ("11K", 30, ALL, WALK),
        ("18K", 15, MAIN, WALK),
        ("25K", 10, MAIN, WALK),
        ("38K", 8, MAIN, WALK),
    ),
    "motions": (("base", 200, MAIN, OTHER_MOTIONS),),
}
"""Table -> level, frames, garments and motions: whole clips where a processor affords them."""


@dataclass(frozen=True)
class Clip:
    """One rollout: a test clip at a level, by the network alone or with the solver and contact behind it."""

    garment: str
    motion: str
    level: str
    frames: int
    refined: bool = False

    @property
    def scene(self) -> str:
        return f"test/{self.garment}/{self.motion}-{SEEDS['test'][0]}"

    @property
    def name(self) -> str:
        return f"{self.garment}_{self.motion}_{self.level}_{self.frames}{'_refined' if self.refined else ''}"


def clips(table: str) -> list[Clip]:
    """The rollouts of a table, coarse ones first."""
    return [
        Clip(garment, motion, level, frames, table == "refined")
        for level, frames, garments, motions in ROLLED[table]
        for garment in garments
        for motion in motions
    ]


def roll(model: str, clip: Clip, folder: Path) -> dict[str, Any]:
    """Simulate and measure a clip; its trajectory is kept beside the result."""
    simulator = load_simulator(model, contact=clip.refined, refine=REFINE * clip.refined, device="cpu")
    triangles, seed = LEVELS[clip.level], SEEDS["test"][0]
    scene = make_scene(clip.garment, motion=clip.motion, triangles=triangles, frames=clip.frames, seed=seed)
    record, began = RunRecord(), time.process_time()
    trajectory = Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record))
    spent = time.process_time() - began
    trajectory.save(folder / f"{clip.name}.npz")
    measured = measure(trajectory)
    metrics = measured["metrics"]
    return {
        "frames": trajectory.frame_count,
        "diverged": measured["diverged"] or record.failed_at is not None,
        "energies": {term: metrics[term]["mean"] for term in ENERGIES},
        "strain_p95": metrics["strain_p95"]["mean"],
        "inside": metrics["penetration_percent"]["max"],
        "deepest": metrics["penetration_depth_max"]["max"],
        "seconds_per_frame": spent / (trajectory.frame_count + scene.lead_in),
    }


def result(model: str, clip: Clip, folder: Path) -> dict[str, Any] | None:
    """The result from the folder, or made; None where another process is making it."""
    kept = folder / f"{clip.name}.json"
    try:
        with FileLock(folder / f"{clip.name}.lock", timeout=0):
            if not kept.is_file():
                made = roll(model, clip, folder)
                replace_file(kept, json.dumps(made, indent=1).encode())
                print(f"{clip.name}: {made}", flush=True)
    except Timeout:
        return None
    return dict(json.loads(kept.read_text(encoding="utf-8")))


def above_floor(clip: Clip, made: dict[str, Any]) -> str:
    """Energy without gravity over the reference's."""
    floor = stored_reference(clip.scene, "base", clip.frames) or stored_reference(clip.scene, "base", 30)
    return f"{ratio(made['energies'], floor):.2f}" if floor else "-"


def cells(of: list[dict[str, Any]]) -> list[str]:
    """Penetration and time of a row."""
    times = [1e3 * each["seconds_per_frame"] for each in of]
    return [
        f"{max(each['inside'] for each in of):.2f}",
        f"{1e3 * max(each['deepest'] for each in of):.1f}",
        f"{sum(each['diverged'] for each in of)} of {len(of)}",
        f"{min(times):.0f} to {max(times):.0f}",
    ]


def markdown(results: dict[Clip, dict[str, Any]]) -> str:
    """One row a level and motion."""
    tail = ("T-shirt's stretch [J]", "inside, most [%]", "deepest [mm]", "diverged", "ms a frame")
    lines = [["level", "motion", "frames", *TRAINING_GARMENTS, *tail], ["---"] * (8 + len(TRAINING_GARMENTS))]
    for level, motion, frames in dict.fromkeys((clip.level, clip.motion, clip.frames) for clip in results):
        row = {
            clip.garment: (above_floor(clip, each), each)
            for clip, each in results.items()
            if (clip.level, clip.motion, clip.frames) == (level, motion, frames)
        }
        ratios = [row[g][0] if g in row else "" for g in TRAINING_GARMENTS]
        stretch = f"{row['tshirt'][1]['energies']['stretch']:.3f}" if "tshirt" in row else ""
        lines.append([level, motion, str(frames), *ratios, stretch, *cells([each for _, each in row.values()])])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--model", default="pb4u-small")
    parser.add_argument("--tables", default="alone,refined,motions")
    options = parser.parse_args()
    with weights_file(options.model) as weights:
        folder = options.out / f"{Path(options.model).stem}_{digest(weights)[:8]}"
    folder.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    for table in options.tables.split(","):
        made = {clip: result(options.model, clip, folder) for clip in clips(table)}
        print(f"\n{table}\n\n{markdown({clip: each for clip, each in made.items() if each})}\n", flush=True)


if __name__ == "__main__":
    main()
