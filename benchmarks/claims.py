"""Rollouts that decide the paper's two claims, by the rules of docs/science/claims.md, and the tables of them.

    python benchmarks/claims.py ROWS.jsonl --weights FOLDER [--recordings FOLDER] [--share 1/4] [--levels 2730]
        [--garments tshirt,dress] [--motions walk] [--seeds 0] [--arms drawn] [--scalings none,per-vertex]
    python benchmarks/claim_tables.py ROWS.jsonl [MORE.jsonl ..]

FOLDER holds the arms, `literal` and `literal-without-control`, and with -seed1 and -seed2: files, as in `weights/arms`,
or folders as `tools/comparison.py` leaves them. `--arms NAME|FILE` takes other weights. Each rollout is one line of the
file; those that stand there are passed over, so that the same command goes on where it was ended. Shares go to several
processes, each with its own file. The solver's rollouts, from which distances are taken, are kept beside the file.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pb4u.errors import Pb4uError
from pb4u.measures.divergence import skinned_centres
from pb4u.measures.excess import distance_to
from pb4u.measures.metrics import measure
from pb4u.motion.library import motion_names
from pb4u.run import Run, WornGarment
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import simulator_of
from pb4u.simulation.run_simulation import roll_out, scene_for
from pb4u.simulation.simulator import RunRecord

LEVELS = (1200, 1970, 2730, 4140, 9600, 19200, 38400)
GARMENTS = ("tshirt", "tanktop", "longsleeve", "dress", "fitted_dress", "cardigan")
MOTIONS = ("walk", "dance", "jump", "07_02")
IN_PART = {"garments": ("tshirt", "dress"), "motions": ("walk",), "from": 19200}
"""What runs of the finest levels, whose rollouts take most of the time."""
ARMS = {"drawn": "literal", "trained at 5": "literal-without-control"}
SCALINGS = ("per-vertex", "none", "band-split", "mean")
CONTROLS = ("solver", "quick-solver", "gradient-descent", "warm-start")
LEAD_IN, FRAMES, LAST = 30, 30, 10
"""Frames of lead-in and of the motion, and how many of the last are measured."""
SEED = 2000


@dataclass(frozen=True)
class Rollout:
    """One line of the plan.

    Args:
        triangles: level.
        garment: built-in garment.
        motion: built-in motion, or name of a recording.
        arm: of which weights, or a control.
        seed: of the training; 0 of a control.
        scaling: rule in use; empty of a control.
        steps: propagation steps in use, 0 by the rule.
    """

    triangles: int
    garment: str
    motion: str
    arm: str
    seed: int = 0
    scaling: str = ""
    steps: int = 0


def plan(options: argparse.Namespace) -> list[Rollout]:
    """All rollouts that the options leave, those of a scene together, the solver's first."""
    found = []
    for triangles in options.levels:
        in_part = triangles >= IN_PART["from"] and not options.whole
        for garment in options.garments:
            for motion in options.motions:
                if in_part and (garment not in IN_PART["garments"] or motion not in IN_PART["motions"]):
                    continue
                scene = (triangles, garment, motion)
                found += [Rollout(*scene, control) for control in options.controls]
                for arm in options.arms:
                    for seed in options.seeds if arm in ARMS else (0,):
                        laws = (5,) if arm == "trained at 5" else options.steps
                        found += [Rollout(*scene, arm, seed, s, k) for s in options.scalings for k in laws]
    return found


def weights_of(rollout: Rollout, folder: Path | None) -> str:
    """Name or file of the weights of an arm."""
    if rollout.arm not in ARMS:
        return rollout.arm
    assert folder is not None
    name = ARMS[rollout.arm] + (f"-seed{rollout.seed}" if rollout.seed else "")
    file = folder / f"{name}.safetensors"
    return str(file if file.exists() else folder / name / "final.safetensors")


def run_of(rollout: Rollout, options: argparse.Namespace) -> Run:
    """The run of a line: network only, contact off."""
    built_in = rollout.motion in motion_names()
    motion = rollout.motion if built_in else next(options.recordings.rglob(f"{rollout.motion}.amc"))
    model: dict[str, Any] = {"model": rollout.arm, "refine": 5 if rollout.arm == "quick-solver" else 0}
    if rollout.arm not in CONTROLS:
        model = {
            "model": weights_of(rollout, options.weights),
            "refine": 0,
            "device": options.device,
            "scaling": rollout.scaling,
            "propagation_steps": rollout.steps or None,
        }
    return Run(
        WornGarment(rollout.garment, triangles=rollout.triangles), motion=motion, lead_in=LEAD_IN,
        frames=options.frames, seed=SEED, contact=False, self_contact=False, **model,
    )  # fmt: skip


def row(rollout: Rollout, options: argparse.Namespace, references: Path) -> dict[str, Any]:
    """What is measured of a rollout: means over the last frames, the paper's total over all, and whether it is lost."""
    began, record = time.process_time(), RunRecord()
    made = run_of(rollout, options)
    simulator = simulator_of(made)
    scene = scene_for(made, simulator)
    result: dict[str, Any] = {**asdict(rollout), "lost": True, "strain": None, "millimetres": None, "paper_total": None}
    try:
        trajectory = roll_out(made, simulator, scene, record=record)
    except Pb4uError:
        return {**result, "seconds": round(time.process_time() - began, 1)}
    measured = measure(trajectory, skinned_centres(scene, trajectory), contact=False)
    metrics, complete = measured["metrics"], trajectory.frame_count == options.frames
    kept = references / f"{rollout.garment}-{rollout.motion}-{rollout.triangles}.npz"
    if rollout.arm == "solver":
        trajectory.save(kept)
    result |= {
        "lost": bool(measured["diverged"] or not complete),
        "strain_max": float(np.nanmax(metrics["strain_p95"]["per_frame"])),
        "paper_total": measured["metrics_paper"]["total"]["mean"],
        "edge_length": float(scene.garments[0].garment.mean_edge_length),
        "faces": len(trajectory.faces),
        "propagation_steps": simulator.propagation_steps(scene),
        "seconds": round(time.process_time() - began, 1),
    }
    if complete:
        result["strain"] = float(np.mean(metrics["strain_p95"]["per_frame"][-LAST:]))
        if kept.exists() and rollout.arm != "solver":
            result["millimetres"] = 1e3 * float(np.mean(distance_to(trajectory, Trajectory.open(kept))[-LAST:]))
    return result


def run(options: argparse.Namespace) -> None:
    """Make what is missing of this share; scenes are shared out whole, so that their reference is near."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    known = set(Rollout.__dataclass_fields__)
    rows = [json.loads(line) for line in options.rows.read_text().splitlines()] if options.rows.exists() else []
    done = {Rollout(**{name: value for name, value in each.items() if name in known}) for each in rows}
    share, of = (int(part) for part in options.share.split("/"))
    references = options.rows.parent / "references"
    references.mkdir(parents=True, exist_ok=True)
    rollouts = plan(options)
    scenes = list(dict.fromkeys((each.triangles, each.garment, each.motion) for each in rollouts))
    mine = set(scenes[share - 1 :: of])
    with options.rows.open("a") as out:
        for rollout in rollouts:
            if (rollout.triangles, rollout.garment, rollout.motion) not in mine or rollout in done:
                continue
            if rollout.arm in ARMS and not Path(weights_of(rollout, options.weights)).exists():
                continue
            made = row(rollout, options, references)
            out.write(json.dumps(made) + "\n")
            out.flush()
            print(json.dumps(made), flush=True)


def _names(text: str) -> tuple[str, ...]:
    return tuple(part for part in text.split(",") if part)


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in _names(text))


def arguments() -> argparse.Namespace:
    """What the command line asks for."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("rows", type=Path)
    made.add_argument("--weights", type=Path)
    made.add_argument("--recordings", type=Path)
    made.add_argument("--share", default="1/1")
    made.add_argument("--device", default="cpu")
    made.add_argument("--frames", type=int, default=FRAMES)
    made.add_argument("--whole", action="store_true", help="all garments and motions at the finest levels too")
    for name, default, kind in (
        ("levels", LEVELS, _numbers), ("garments", GARMENTS, _names), ("motions", MOTIONS, _names),
        ("seeds", (0, 1, 2), _numbers), ("arms", tuple(ARMS), _names), ("scalings", SCALINGS, _names),
        ("steps", (0, 5), _numbers), ("controls", CONTROLS, _names),
    ):  # fmt: skip
        made.add_argument(f"--{name}", type=kind, default=default)
    options = made.parse_args()
    if options.weights is None and set(options.arms) & set(ARMS):
        made.error("the arms are found in a folder: add --weights FOLDER")
    if options.recordings is None:
        options.motions = tuple(name for name in options.motions if name in motion_names())
    return options


def main() -> None:
    run(arguments())


if __name__ == "__main__":
    main()
