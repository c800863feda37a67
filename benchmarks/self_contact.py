"""Contact over many clips: what crosses cloth and body, where skin shows, how near cloth comes, and what it costs.

    python benchmarks/self_contact.py --set motions --models auto,solver --out clips
    python benchmarks/self_contact.py --set fine,outfits,drawn,fabrics --seeds 0:300 --out clips
    python benchmarks/self_contact.py --set others --data ../../shared/data --triangles 8000 --out clips
    python benchmarks/self_contact.py --garments tee.json,dress --motions walk,squat --triangles 1200 --out clips

Each clip is a job of the folder `--out`: the same command goes on where it stopped. At the end, or with `--table` at
once, it prints the clips that are done as CSV, the worst first. Positions are rounded to float32 as they
are written, and crossings are found by exact predicates. Recordings and garments of others are read from `--data`, and
the garments mended by `pb4u check --fix`.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.collision.crossings import self_crossings
from pb4u.garment.cuts import CUTS
from pb4u.garment.material import FABRICS, MATERIALS
from pb4u.jobs.job import Failure, Made
from pb4u.jobs.job_folder import JobFolder, quiet
from pb4u.jobs.worker_pool import LocalPool
from pb4u.measures import run_job
from pb4u.measures.job_planner import JobPlanner
from pb4u.measures.metrics import packed_garments
from pb4u.measures.run_job import RunJob
from pb4u.motion.library import motion_names
from pb4u.run import Run, WornGarment
from pb4u.scene.trajectory import Trajectory

OUTFITS = (
    ("tanktop", "cardigan"),
    ("tshirt", "skirt"),
    ("trousers", "tshirt"),
    ("skirt", "longsleeve"),
    ("tanktop", "trousers", "cardigan"),
)
FINE = (
    ("longsleeve", "arms"), ("dress", "dance"), ("skirt", "squat"), ("cardigan", "walk"),
    ("tshirt", "jump"), ("trousers", "run"), ("fitted_dress", "turn"), ("tanktop", "dance"),
)  # fmt: skip
OTHERS = ("tights_f_lod0", "longsleeve_m_lod0", "pants_f_lod0", "skirt_long_f_lod0", "shorts_f_lod0", "tshirt_f_lod0",
          "tshirt_m_lod0", "croptop_f_lod1", "pants_f_lod1", "longsleeve_m_lod1")  # fmt: skip
RECORDINGS = (("49/49_02", (300, 700)), ("14/14_14", (200, 600)), ("05/05_03", None), ("02/02_06", None),
              ("16/16_35", None), ("05/05_20", None))  # fmt: skip
WITHIN = 3e-4
"""Distance [m] within which elements are looked for to find the smallest gap: the most that the table shows."""


def runs(kind: str, args: argparse.Namespace) -> Iterator[Run]:
    """The runs of a set, by the default model."""

    def run(
        garments: tuple[str, ...], motion: str, triangles: int | None, frames: int, material: str | None = None,
        **more: Any,
    ) -> Run:  # fmt: skip
        worn = tuple(WornGarment(name, material, triangles=args.triangles or triangles) for name in garments)
        return Run(garments=worn, motion=motion, frames=args.frames or frames, **more)

    if kind == "motions":
        for motion, garment in product(motion_names(), CUTS):
            yield run((garment,), motion, 2500, 200)
    elif kind == "given":
        for garment, motion in product(args.garments.split(","), args.motions.split(",")):
            yield run((garment,), motion, None, 60)
    elif kind == "fine":
        for (garment, motion), triangles in product(FINE, (1000, 11_000, 38_000)):
            yield run((garment,), motion, triangles, 60)
    elif kind == "outfits":
        for motion, outfit in product(("walk", "squat", "dance"), OUTFITS):
            yield run(outfit, motion, 2500, 60)
    elif kind == "others":
        for garment, (motion, crop) in product(OTHERS, RECORDINGS):
            body = "man" if "_m_" in garment else "woman"
            file, worn = args.data / "motions" / "cmu_asfamc" / f"{motion}.amc", mended(garment, body, args)
            yield run((str(worn),), str(file), None, 60, body=body, crop=crop)
    elif kind in ("drawn", "fabrics"):
        names = tuple(MATERIALS if kind == "drawn" else FABRICS)
        draw, (first, stop) = np.random.default_rng(0), map(int, args.seeds.split(":"))
        for seed in range(stop):
            alone = draw.random() < 0.7
            garments = (str(draw.choice(tuple(CUTS))),) if alone else OUTFITS[draw.integers(len(OUTFITS))]
            shape = {name: float(draw.uniform(0.1, 0.9)) for name in ("height", "weight", "muscle")}
            body = str(draw.choice(["woman", "man"]))
            motion, material = str(draw.choice(motion_names())), str(draw.choice(names))
            if seed >= first:
                yield run(garments, motion, 1500, 60, body_shape=shape, body=body, material=material, seed=seed)
    else:
        raise SystemExit(f"There is no set {kind}: motions, fine, outfits, others, drawn or fabrics.")


def mended(garment: str, body: str, args: argparse.Namespace) -> Path:
    """A garment of others as `pb4u check --fix` leaves it beside the folder of clips; its own file where that fails."""
    file = args.data / "garments" / f"{garment}.obj"
    fixed = args.out.with_name(f"{args.out.name}_garments") / file.name
    fixed.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-c", "from pb4u.cli.main import main; raise SystemExit(main())", "check", file]
    if not fixed.exists():
        subprocess.run([*command, "--body", body, "--fix", fixed], check=False, capture_output=True)
    return fixed if fixed.exists() else file


def attempt(job: RunJob, keep: bool) -> Made | Failure:
    """A clip with its metrics, the crossings of cloth that share a vertex, and the smallest gap."""
    outcome = run_job.attempt(job)
    assert not isinstance(outcome, list)
    if isinstance(outcome, Failure) or outcome.trajectory is None:
        return outcome
    with tempfile.NamedTemporaryFile(suffix=".npz") as file:
        file.write(outcome.trajectory)
        file.flush()
        trajectory = Trajectory.open(file.name)
        tree, gaps, crossing = packed_garments(trajectory).surface_tree, [], []
        for written in trajectory.positions:
            x = np.array(written, dtype=np.float64)
            crossing.append(len(self_crossings(x, trajectory.faces, sharing=True)))
            gaps.append(tree.pairs(x, WITHIN).nearest(x)[0].min(initial=WITHIN))
    found = {"crossing_sharing": crossing, "smallest_gap": float(min(gaps))}
    return Made(outcome.result | found, outcome.trajectory if keep else None)


Rated = tuple[tuple[float, ...], list[str]]
"""How bad a clip is, higher is better, and the cells of its row."""


def row(job: RunJob, result: dict[str, Any] | None, failure: Failure | None) -> Rated | None:
    """How bad a clip is, worst first, and its row of the table; None of one that is not done."""
    labels, counts = job.labels, "+".join(str(each.triangles or "own") for each in job.run.garments)
    name = f"{labels['garment']}, {Path(labels['motion']).stem}, {labels['model']}"
    name += f", seed {labels['seed']}" if labels["seed"] else ""
    name += "" if job.run.self_contact is None else ", self-contact off"
    if result is None:
        return None if failure is None else ((-np.inf,), [name, counts, f"refused: {failure.sentence}"])
    series = {key: np.array(each["per_frame"]) for key, each in result["metrics"].items()}
    pinched = series["body_intersections_pinched"]
    free, limbs = series["body_intersections"] - pinched, series.get("limbs_through_cloth", np.zeros(1))
    cloth, skin = max(result["crossing_sharing"]), series["visible_skin_percent"].max()
    lost = result["diverged"] or result["frames"] < labels["frames_asked"]
    cells = [
        f"{name}{' lost' if lost else ''}", str(result["triangles"]), str(result["frames"]),
        f"{free.mean():.2f}", f"{free.max():.0f}", f"{(free > 0).sum()}", f"{pinched.max():.0f}",
        f"{(limbs > 0).sum()}", f"{skin:.2f}", f"{1e3 * series['penetration_depth_max'].max():.1f}",
        f"{series['strain_max'].max():.2f}",
        f"{cloth}", f"{1e3 * result['smallest_gap']:.2f}", f"{result['ms_per_step']:.0f}",
    ]  # fmt: skip
    return (-lost, -cloth, -(limbs > 0).sum(), -free.mean(), -skin), cells


HEAD = (
    "clip", "triangles", "frames", "body pairs, mean", "body pairs, most", "body pairs, frames",
    "of them pinched, most", "limbs through, frames",
    "skin, most [%]", "deepest [mm]", "strain, most", "cloth pairs, most", "gap [mm]", "step [ms]",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", default="motions", help="motions, fine, outfits, others, drawn, fabrics, by comma")
    parser.add_argument("--garments", default="", help="names or files, by comma, to simulate in place of a set")
    parser.add_argument("--motions", default="walk,dance,squat", help="for --garments")
    parser.add_argument("--models", default="auto")
    parser.add_argument("--refine", type=int, default=Run.refine, help="most iterations a step")
    parser.add_argument("--frames", type=int, help="of each clip, in place of those of its set")
    parser.add_argument("--triangles", type=int, help="of each garment, in place of those of its set")
    parser.add_argument("--seeds", default="0:300", help="first and last scene of drawn or fabrics, the last left out")
    parser.add_argument("--data", type=Path, default=Path("../../shared/data"), help="garments and motions of others")
    parser.add_argument("--against", action="store_true", help="simulate each clip with self-contact off too")
    parser.add_argument("--keep", action="store_true", help="keep the trajectories")
    parser.add_argument("--table", action="store_true", help="only print what is done")
    parser.add_argument("--out", type=Path, required=True, help="folder")
    args = parser.parse_args()
    planner, ways = JobPlanner(), ({}, {"self_contact": False})[: 1 + args.against]
    wanted = [run for kind in ("given" if args.garments else args.set).split(",") for run in runs(kind, args)]
    jobs = [
        planner.job(run.with_entries({"model": model, "refine": args.refine, **way}))
        for model, run, way in product(args.models.split(","), wanted, ways)
    ]
    with JobFolder(args.out, "clips in contact", {}) as folder:
        folder.write_manifest(jobs)
        missing = [] if args.table else folder.still_to_do(jobs, "clips", False, partial(print, file=sys.stderr))
        folder.complete(jobs, missing, "clips", lambda: LocalPool(1, partial(attempt, keep=args.keep)), quiet)
        rows = sorted(filter(None, (row(job, folder.result(job), folder.failure(job)) for job in jobs)))
    print(f"{len(rows)} of {len(jobs)} clips done.", file=sys.stderr)
    csv.writer(sys.stdout, lineterminator="\n").writerows((HEAD, *(cells for _, cells in rows)))


if __name__ == "__main__":
    main()
