"""Body through cloth over hard clips: what crosses outside of where the body is inside itself, and what it costs.

    python benchmarks/limbs.py --models auto,quick-solver --out limbs.jsonl
    python benchmarks/limbs.py --only tights --data ../../shared/data --frames 60 --out limbs.jsonl
    python benchmarks/limbs.py --garments tee.json,skirt.npz --motions walk,squat --triangles 5000 --out patterns.jsonl

Recordings and garments of others are read from `--data`; without it those clips are left out. A line of JSON is added
for each clip; clips that the file has already are left out.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pb4u.measures.limbs import Bones, watched
from pb4u.measures.metrics import measure
from pb4u.scene.assembly import make_scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import load_simulator
from pb4u.simulation.simulator import RunRecord

MEASURES = ("body_intersections", "body_intersections_pinched", "visible_skin_percent", "strain_max",
            "penetration_depth_max", "self_intersections")  # fmt: skip


class Clip(NamedTuple):
    """A clip to simulate; garments with a suffix and recordings come from the folder of data."""

    name: str
    garment: str
    motion: str
    body: str = "woman"
    crop: tuple[int, int] | None = None


CLIPS = (
    Clip("arms", "longsleeve", "arms"),
    Clip("jump", "tshirt", "jump"),
    Clip("squat", "skirt", "squat"),
    Clip("dance", "fitted_dress", "dance"),
    Clip("tights", "tights_f_lod0.obj", "49/49_02.amc", crop=(300, 700)),
    Clip("jacket", "longsleeve_m_lod0.obj", "14/14_14.amc", body="man", crop=(200, 600)),
)


def result(clip: Clip, model: str, args: argparse.Namespace) -> dict[str, object]:
    """Figures of a clip."""
    own = not clip.motion.endswith(".amc")
    scene = make_scene(
        garment=clip.garment if own else args.data / "garments" / clip.garment,
        motion=clip.motion if own else args.data / "motions" / "cmu_asfamc" / clip.motion,
        body=clip.body,
        frames=args.frames,
        triangles=args.triangles,
        crop=clip.crop,
    )
    simulator, record = load_simulator(model), RunRecord()
    stamps = [time.perf_counter()]
    frames = []
    for frame in simulator.written_frames(scene, record):
        frames.append(frame)
        stamps.append(time.perf_counter())
    trajectory = Trajectory.collect(simulator.header(scene), iter(frames))
    if args.keep:
        args.keep.mkdir(parents=True, exist_ok=True)
        trajectory.save(args.keep / f"{clip.name}_{model}.npz")
    report = measure(trajectory)
    limbs, _ = watched(Bones.of(scene, trajectory.frame_count, trajectory.fps), trajectory)
    series = {name: np.array(report["metrics"][name]["per_frame"]) for name in MEASURES if name in report["metrics"]}
    free = series["body_intersections"] - series["body_intersections_pinched"]
    return {
        "clip": clip.name,
        "model": model,
        "triangles": args.triangles,
        "frames": trajectory.frame_count,
        "crossing_mean": round(float(free.mean()), 2),
        "crossing_max": int(free.max()),
        "crossing_frames": int((free > 0).sum()),
        "pinched_max": int(series["body_intersections_pinched"].max()),
        "skin_max": round(float(series["visible_skin_percent"].max()), 3),
        "strain_max": round(float(series["strain_max"].max()), 3),
        "depth_mm": round(1e3 * float(series["penetration_depth_max"].max()), 2),
        "self": int(series["self_intersections"].max()),
        "limbs": int(limbs.sum()),
        "ms_median": round(1e3 * float(np.median(np.diff(stamps[2:]))), 1),
        "ms_mean": round(1e3 * float(np.mean(np.diff(stamps[2:]))), 1),
        "failed_at": record.failed_at,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default="auto")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--only", default="", help="names of clips, by comma")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--garments", default="", help="names or files, by comma, to simulate instead of these clips")
    parser.add_argument("--motions", default="walk,dance,squat", help="for --garments")
    parser.add_argument("--keep", type=Path, help="folder for the trajectories")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    clips = CLIPS
    if args.garments:
        worn = (
            (Path(name).stem, name, motion) for name in args.garments.split(",") for motion in args.motions.split(",")
        )
        clips = tuple(Clip(f"{stem}_{motion}", name, motion) for stem, name, motion in worn)
    rows = [json.loads(line) for line in args.out.read_text().splitlines()] if args.out.exists() else []
    done = {(row["clip"], row["model"], row.get("triangles"), row["frames"]) for row in rows}
    for clip in clips:
        if (args.only and clip.name not in args.only.split(",")) or (clip.motion.endswith(".amc") and not args.data):
            continue
        for model in args.models.split(","):
            if (clip.name, model, args.triangles, args.frames) in done:
                continue
            row = result(clip, model, args)
            print(row, flush=True)
            with args.out.open("a") as out:
                out.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
