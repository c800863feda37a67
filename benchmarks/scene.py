"""Where the time of making a scene goes: 300 skinned frames of an 11K garment.

python benchmarks/scene.py [--garment FILE.obj|tshirt] [--motion walk|FILE] [--triangles 11000] [--frames 300]

Imports and the first (cold) dressing are timed apart: the dressing weights are cached on disk.

Measured on 2 cores of a cloud machine (x86-64, 24 GiB), 2026-11-21; see docs/garments.md for the table.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, default=11000)
    parser.add_argument("--frames", type=int, default=300)
    options = parser.parse_args()

    rows: list[tuple[str, float]] = []

    def timed(label: str, work: Callable[[], Any]) -> Any:
        began = time.perf_counter()
        result = work()
        rows.append((label, time.perf_counter() - began))
        return result

    def imports() -> None:
        import igl  # noqa: F401
        import scipy.spatial  # noqa: F401
        import trimesh  # noqa: F401

        import pb4u.scene.assembly  # noqa: F401

    timed("imports", imports)
    from pb4u.body.library import load_body
    from pb4u.garment.dressing import SkinnedPlacement
    from pb4u.garment.garment import Garment
    from pb4u.garment.garment_file import read_garment
    from pb4u.garment.library import build_garment, garment_names
    from pb4u.garment.material import load_material
    from pb4u.geometry.obj_file import write_obj
    from pb4u.motion.library import load_motion

    body = timed("body", lambda: load_body("woman"))
    if options.garment in garment_names():
        built: Garment = timed("garment cut (once)", lambda: build_garment(options.garment, body, options.triangles))
        file = Path(tempfile.mkdtemp()) / "garment.obj"
        from pb4u.geometry.mesh_file import PolygonMesh

        write_obj(file, PolygonMesh(built.vertices, tuple(built.faces)))
    else:
        file = Path(options.garment)
    worn = timed("garment file read", lambda: read_garment(file, load_material("default")))
    clip = timed("motion read", lambda: load_motion(options.motion))
    frames = min(options.frames, clip.available_frames(30.0) or options.frames)
    moving = body.posed(timed("motion retargeted", lambda: clip.poses(body, 30.0, frames)))
    timed("dressing (first time or cached)", lambda: SkinnedPlacement(worn, moving))
    placement = timed("dressing, warm", lambda: SkinnedPlacement(worn, moving))
    timed("body skinned", lambda: moving.positions(0, frames))
    timed("garment skinned", lambda: placement.positions(0, frames))

    once = ("imports", "garment cut (once)", "dressing (first time or cached)")
    print(f"{worn.triangle_count} triangles, {frames} frames, {torch.get_num_threads()} threads\n")
    print("| stage | seconds |\n|---|---|")
    for label, seconds in rows:
        print(f"| {label} | {seconds:.2f} |")
    print(f"| **sum without {', '.join(once)}** | {sum(s for label, s in rows if label not in once):.2f} |")


if __name__ == "__main__":
    main()
