"""Built-in garments laid over each other, in both orders, and tangled starts freed: what is left, how far, how long.

python benchmarks/outfits.py [--triangles 2500] [--bodies woman,man]
"""

from __future__ import annotations

import argparse
import time
from itertools import permutations

import numpy as np

from pb4u.body.library import load_body
from pb4u.collision.crossings import self_crossings
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.garment.fit import RestBody
from pb4u.garment.layering import layered
from pb4u.garment.library import build_garment, garment_names
from pb4u.garment.tangles import untangled_start
from pb4u.scene.assembly import make_scene
from pb4u.simulation.timeline import Timeline

STARTS = (
    ("cardigan", "walk", 2500), ("cardigan", "squat", 2500), ("cardigan", "arms", 2500), ("longsleeve", "walk", 11000),
    ("longsleeve", "arms", 11000),
)  # fmt: skip
"""Garments that bare skinning tangles by the first frame after the lead-in."""


def pairs(triangles: int, body_name: str) -> None:
    body = load_body(body_name)
    rest, garments = RestBody.of(body), {name: build_garment(name, body, triangles) for name in garment_names()}
    for names in permutations(garments, 2):
        inner, outer = (garments[name] for name in names)
        faces = np.concatenate([inner.faces, outer.faces + len(inner.vertices)])
        made = len(self_crossings(np.concatenate([inner.vertices, outer.vertices]), faces, sharing=True))
        began = time.perf_counter()
        places = layered([inner, outer], rest)
        seconds = time.perf_counter() - began
        left = len(self_crossings(np.concatenate(places).astype(np.float32), faces, sharing=True))
        near = TriangleSurface(inner.faces, len(places[0])).at(places[0]).nearest(places[1])
        beneath = int(((near.signed_distance < 0.0) & ~near.beyond_border).sum())
        moved = [np.linalg.norm(p - g.vertices, axis=1).max() for p, g in zip(places, (inner, outer), strict=True)]
        print(
            f"{body_name:6} {names[0]:>12} under {names[1]:12} {made:5} -> {left:4} pairs, {beneath:3} beneath, "
            f"moved {1000 * moved[0]:4.0f} and {1000 * moved[1]:4.0f} mm, {seconds:5.2f} s"
        )


def starts() -> None:
    for name, motion, triangles in STARTS:
        scene = make_scene(name, motion=motion, frames=1, triangles=triangles)
        timeline = Timeline.of(scene)
        skinned = timeline.skinned(scene.lead_in).numpy()
        count = len(self_crossings(skinned, timeline.garments.faces.numpy(), sharing=True))
        began = time.perf_counter()
        freed = untangled_start(timeline.garments.garments, skinned)
        seconds = time.perf_counter() - began
        moved = 1000 * np.linalg.norm(freed - skinned, axis=1).max()
        print(f"{name} {motion} {triangles}: {count} pairs -> 0, moved {moved:.1f} mm, {seconds:.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--bodies", default="woman,man")
    options = parser.parse_args()
    starts()
    for body_name in options.bodies.split(","):
        pairs(options.triangles, body_name)


if __name__ == "__main__":
    main()
