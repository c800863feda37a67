"""Sewing patterns dressed on bodies and set in motion: what crosses, how deep, how long, and how it looks.

python benchmarks/patterns.py --data FOLDER --out FOLDER [--bodies woman,man,1] [--motions walk,dance] [--frames 30]

Prints a Markdown row a run: of a dressing the seconds of processor time, pairs of cloth through cloth, of cloth through
body, depth [m] and mean strain; of a motion the seconds, then of each of MEASURES the mean over the frames and the
most. Adds it to rows.jsonl in --out, beside trajectories and pictures; a run that is there is not made again. A body
that is a number is a woman of a shape drawn with that seed.
"""

from __future__ import annotations

import argparse
import json
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import pb4u
from pb4u.export.still_renderer import render
from pb4u.export.view import View
from pb4u.measures.run_report import run_report
from pb4u.pattern.files import write_worn
from pb4u.run import Run, WornGarment
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import simulator_of
from pb4u.simulation.run_simulation import roll_out, scene_for
from pb4u.simulation.simulator import RunRecord

MEASURES = ("self_intersections", "body_intersections", "body_intersections_pinched", "penetration_depth_max",
            "strain_max", "strain_p95", "visible_skin_percent", "limbs_through_cloth")  # fmt: skip


def body_of(name: str) -> tuple[str, dict[str, float]]:
    """Name and shape; a number draws the shape as training does."""
    rng = np.random.default_rng(int(name) if name.isdigit() else 0)
    drawn = {key: round(rng.uniform(0.1, 0.9), 3) for key in pb4u.load_body("woman").shape}
    return ("woman", drawn) if name.isdigit() else (name, {})


def dress(path: Path, body: str, triangles: int, file: Path) -> dict[str, Any]:
    wearer, began = pb4u.load_body(*body_of(body)), time.process_time()
    try:
        dressed = pb4u.dress(pb4u.read_pattern(path), wearer, triangles)
    except pb4u.InputError as refusal:
        return {"refused": str(refusal), "seconds": time.process_time() - began}
    seconds = time.process_time() - began
    write_worn(file, dressed, wearer)
    # The first frame of a lead-in is the body at rest, in the garment as it was dressed.
    run = Run((WornGarment(file),), *body_of(body), frames=1, keep_lead_in=True, model="skinning")
    simulator = simulator_of(run)
    draw(roll_out(run, simulator, scene_for(run, simulator)), 0, file)
    return {**dressed.to_json(), "seconds": seconds}


def move(garment: Path, body: str, motion: str, frames: int, file: Path) -> dict[str, Any]:
    run, record = Run((WornGarment(garment),), *body_of(body), motion=motion, frames=frames), RunRecord()
    simulator, began = simulator_of(run), time.process_time()
    scene = scene_for(run, simulator)
    trajectory = roll_out(run, simulator, scene, file, record)
    seconds, report = time.process_time() - began, run_report(trajectory, simulator, scene, record)
    draw(trajectory, trajectory.frame_count // 2, file)
    measured = {name: report["metrics"][name]["per_frame"] for name in MEASURES if name in report["metrics"]}
    return {"seconds": seconds, "diverged_at": report["diverged_at"], "notes": report["notes"], **measured}


def draw(trajectory: Trajectory, frame: int, file: Path) -> None:
    """From the front, the left and the back."""
    seen = [next(iter(render(trajectory, [frame], View(azimuth=angle)))) for angle in (0.0, 90.0, 180.0)]
    Image.fromarray(np.concatenate(seen, axis=1)).save(file.with_suffix(".png"))


def markdown(name: str, row: dict[str, Any]) -> str:
    shown = [row.get(each) for each in ("refused", "crossings", "body_crossings", "depth", "strain", *MEASURES)]
    told = [each if isinstance(each, str) else f"{np.mean(each):.2g}, {np.max(each):.2g}" if isinstance(each, list)
            else f"{each:.2g}" for each in shown if each is not None]  # fmt: skip
    return " | ".join(["", name, f"{row['seconds']:.1f} s", *told, ""]).strip()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of specifications")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--patterns", default="", help="names, by comma; all by default")
    parser.add_argument("--bodies", default="woman", help="names or seeds of drawn women, by comma")
    parser.add_argument("--triangles", default="5000", help="numbers, by comma")
    parser.add_argument("--motions", default="", help="names, by comma")
    parser.add_argument("--frames", type=int, default=30, help="of each motion")
    options = parser.parse_args()
    out, frames = options.out, options.frames
    out.mkdir(parents=True, exist_ok=True)
    rows = out / "rows.jsonl"
    done = {json.loads(line)["name"] for line in rows.open()} if rows.exists() else set()

    def add(name: str, row: dict[str, Any]) -> None:
        with rows.open("a") as lines:
            lines.write(json.dumps({"name": name, **row}, default=float) + "\n")
        print(markdown(name, row), flush=True)

    paths = [path for path in sorted(options.data.glob("*.json")) if path.stem in (options.patterns or path.stem)]
    motions = ["", *filter(None, options.motions.split(","))]
    for triangles, body, motion, path in product(
        options.triangles.split(","), options.bodies.split(","), motions, paths
    ):
        name = f"{path.stem} {body} {triangles}"
        garment = out / f"{name}.npz"
        clip = f"{name} {motion} {frames}"
        if not motion and name not in done:
            add(name, dress(path, body, int(triangles), garment))
        elif motion and clip not in done and garment.exists():
            add(clip, move(garment, body, motion, frames, out / f"{clip}.npz"))


if __name__ == "__main__":
    main()
