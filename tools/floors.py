"""Computes the reference energies of every catalogue test scene: what the solver reaches at its tolerance.

python tools/floors.py [--levels base,11K] [--only test/tshirt/walk-2000,...] [--recordings FOLDER] [--frames 30]

Results go to src/pb4u/paper/reference_energies.json, one entry a scene, level and number of frames; entries already
there are kept.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

from pb4u.garment.library import LEVELS
from pb4u.measures.metrics import ENERGIES, measure
from pb4u.paper.reference_energies import REFERENCE_FILE
from pb4u.scene.assembly import make_scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.stepwise_simulator import SolverSimulator
from pb4u.training.catalogue import MOTIONS, RECORDINGS, SEEDS, TRAINING_GARMENTS, UNSEEN_GARMENTS


def scenes(recordings: Path | None) -> dict[str, tuple[str, str, int]]:
    """Garment, motion and seed of each test scene by its name, recordings last."""
    seed, garments = SEEDS["test"][0], (*TRAINING_GARMENTS, *UNSEEN_GARMENTS)
    named = {f"test/{g}/{m}-{seed}": (g, m, seed) for g in garments for m in MOTIONS["test"]}
    trials = {} if recordings is None else {t: recordings / t.split("_")[0] / f"{t}.amc" for t in RECORDINGS["test"]}
    return named | {f"test/{g}/{t}": (g, str(file), 0) for g in garments for t, file in trials.items()}


def floor_of(scene: tuple[str, str, int], triangles: int, frames: int) -> dict[str, object]:
    """What the solver reaches on one scene, contact response off so that nothing but the potential is at work."""
    garment, motion, seed = scene
    made = make_scene(garment, motion=motion, triangles=triangles, frames=frames, seed=seed, rest_shape="moulded")
    simulator, record = SolverSimulator(), RunRecord()
    trajectory = Trajectory.collect(simulator.header(made), simulator.written_frames(made, record))
    measured = measure(trajectory)
    return {
        "triangles": len(trajectory.faces),
        "energies": {term: measured["metrics"][term]["mean"] for term in ENERGIES},
        "strain_p95": measured["metrics"]["strain_p95"]["mean"],
        "unsolved_steps": record.unsolved,
    }


def main() -> None:
    """Run what is missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--levels", default="base")
    parser.add_argument("--only", help="scenes by name; without it all")
    parser.add_argument("--recordings", type=Path)
    parser.add_argument("--frames", type=int, default=30)
    options = parser.parse_args()
    floors = json.loads(REFERENCE_FILE.read_text()) if REFERENCE_FILE.exists() else {}
    for level in options.levels.split(","):
        named = scenes(options.recordings)
        wanted = set(options.only.split(",")) if options.only else set(named)
        if unknown := wanted - set(named):
            parser.error(f"no such test scene: {', '.join(sorted(unknown))}")
        for name in (each for each in named if each in wanted):
            known = floors.setdefault(f"{name}@{level}", {})
            if str(options.frames) in known:
                continue
            began = time.perf_counter()
            known[str(options.frames)] = floor_of(named[name], LEVELS[level], options.frames)
            beside = REFERENCE_FILE.with_suffix(".part")
            beside.write_text(json.dumps(dict(sorted(floors.items())), indent=1) + "\n")
            os.replace(beside, REFERENCE_FILE)
            print(f"{name}@{level}: {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
