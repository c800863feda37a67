"""Contact between cloth elements over many clips: what crosses, how near cloth comes, and what it costs.

    python benchmarks/self_contact.py --set motions --models auto,solver --frames 200 --out clips.jsonl
    python benchmarks/self_contact.py --set outfits,fine,drawn --models auto --out clips.jsonl

Each clip is simulated with self-contact on, and with `--against` off too; positions are rounded to float32 as they are
written, and triangles that cross are found by exact predicates, those that share a vertex included. A line of JSON is
added for each clip; clips that the file holds already are left out, so that a long run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from pb4u.collision.crossings import self_crossings
from pb4u.errors import Pb4uError
from pb4u.garment.library import garment_names
from pb4u.garment.material import material_names
from pb4u.geometry.principal_stretch import face_strains
from pb4u.measures.metrics import PENETRATION_TOLERANCE, Ruler
from pb4u.motion.library import motion_names
from pb4u.scene.assembly import make_scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import load_simulator
from pb4u.simulation.simulator import RunRecord

OUTFITS = (
    ("tanktop", "cardigan"),
    ("tshirt", "skirt"),
    ("trousers", "tshirt"),
    ("skirt", "longsleeve"),
    ("tanktop", "trousers", "cardigan"),
)
WITHIN = 3e-4
"""Distance [m] within which elements are looked for to find the smallest gap."""
MEASURED_EVERY = 10
"""Frames from one measure of the energies to the next; crossings, gaps, strains and depths are of every frame."""


@dataclass(frozen=True)
class Clip:
    """A clip to simulate."""

    garments: tuple[str, ...]
    motion: str
    triangles: int
    frames: int
    model: str
    self_contact: bool
    shape: tuple[tuple[str, float], ...] = ()
    body: str = "woman"
    material: str = "default"
    seed: int = 0


def clips(kind: str, model: str, frames: int | None, self_contact: bool) -> Iterator[Clip]:
    """The clips of a set."""

    def clip(garments: tuple[str, ...], motion: str, triangles: int, most: int, **more: object) -> Clip:
        return Clip(garments, motion, triangles, frames or most, model, self_contact, **more)  # type: ignore[arg-type]

    if kind == "motions":
        for motion in motion_names():
            for garment in garment_names():
                yield clip((garment,), motion, 2500, 200)
    elif kind == "fine":
        for garment, motion in (("longsleeve", "arms"), ("dress", "dance"), ("skirt", "squat"), ("cardigan", "walk")):
            yield clip((garment,), motion, 11_000, 60)
        yield clip(("tshirt",), "walk", 38_000, 20)
    elif kind == "outfits":
        for motion in ("walk", "squat", "dance"):
            for outfit in OUTFITS:
                yield clip(outfit, motion, 2500, 60)
    elif kind == "drawn":
        draw = np.random.default_rng(0)
        for seed in range(300):
            alone = draw.random() < 0.7
            garments = (str(draw.choice(garment_names())),) if alone else OUTFITS[draw.integers(len(OUTFITS))]
            shape = tuple((name, float(draw.uniform(0.1, 0.9))) for name in ("height", "weight", "muscle"))
            body = str(draw.choice(["woman", "man"]))
            motion, material = str(draw.choice(motion_names())), str(draw.choice(material_names()))
            yield clip(garments, motion, 1500, 60, shape=shape, body=body, material=material, seed=seed)
    else:
        raise SystemExit(f"There is no set {kind}: motions, fine, outfits or drawn.")


def result(clip: Clip) -> dict[str, object]:
    """Figures of a clip."""
    scene = make_scene(
        garment=list(clip.garments) if len(clip.garments) > 1 else clip.garments[0],
        motion=clip.motion,
        frames=clip.frames,
        triangles=clip.triangles,
        body=clip.body,
        body_shape=dict(clip.shape),
        material=clip.material,
        seed=clip.seed,
    )
    simulator, record = load_simulator(clip.model, self_contact=clip.self_contact), RunRecord()
    began = time.perf_counter()
    trajectory = Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record))
    seconds = time.perf_counter() - began
    ruler = Ruler(trajectory)
    crossing, gaps, strains, heights = [], [], [], []
    for t, written in enumerate(trajectory.positions):
        x = np.asarray(written, dtype=np.float32).astype(np.float64)
        crossing.append(len(self_crossings(x, trajectory.faces, sharing=True)))
        near = ruler.garments.surface_tree.pairs(x, WITHIN)
        gaps.append(near.nearest(x)[0].min(initial=np.inf))
        strains.append(face_strains(torch.from_numpy(x), ruler.garments.faces, ruler.garments.inverse_rest_shape))
        if ruler.surface is not None:
            body = torch.from_numpy(np.asarray(trajectory.body_positions[t], dtype=np.float64))
            heights.append(ruler.surface.at(body).nearest(torch.from_numpy(x)).signed_distance)
    strain, height = torch.stack(strains), torch.stack(heights) if heights else torch.zeros(1)
    energies = [ruler.frame(t).metrics["stretch"] for t in range(0, trajectory.frame_count, MEASURED_EVERY)]

    return {
        "frames_made": trajectory.frame_count,
        "seconds_a_step": seconds / (scene.total_frames - 1),
        "load": os.getloadavg()[0],
        "crossing_mean": float(np.mean(crossing)),
        "crossing_max": int(max(crossing)),
        "smallest_gap": float(min(gaps)),
        "strain_max": float(strain.max()),
        "depth_max": max(0.0, -float(height.min())),
        "penetration_percent": 100.0 * float((height < -PENETRATION_TOLERANCE).double().mean()),
        "stretch": float(np.mean(energies)),
        "iterations": float(np.mean(record.solver_iterations)) if record.solver_iterations else None,
        "unsolved": record.unsolved,
        "failed_at": record.failed_at,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", default="motions")
    parser.add_argument("--models", default="auto")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--against", action="store_true", help="simulate each clip with self-contact off too")
    parser.add_argument("--part", default="1/1", help="the k-th of n parts, as k/n, for several processes")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    wanted = [
        clip
        for kind in options.set.split(",")
        for model in options.models.split(",")
        for pair in zip(
            *(clips(kind, model, options.frames, on) for on in (True, False)[: 1 + options.against]), strict=True
        )
        for clip in pair
    ]
    done = []
    if options.out.is_file():
        done = [json.loads(line)["clip"] for line in options.out.read_text().splitlines()]
    k, n = (int(number) for number in options.part.split("/"))
    for clip in wanted[k - 1 :: n]:
        key = json.loads(json.dumps(asdict(clip)))
        if key in done:
            continue
        try:
            figures = result(clip)
        except Pb4uError as error:
            figures = {"error": str(error)}
        with options.out.open("a") as file:
            file.write(json.dumps({"clip": key, **figures}) + "\n")
        told = "+".join(clip.garments), clip.motion, clip.triangles, clip.model, "on" if clip.self_contact else "off"
        print(*told, {name: round(v, 5) if isinstance(v, float) else v for name, v in figures.items()}, flush=True)


if __name__ == "__main__":
    main()
