"""What the quick solver takes by cores and sizes: threads, growth, the search's share, memory, Blender, first frame.

    python -m benchmarks.cores [--triangles 2500 11000 38000 100000] [--frames 8] [--blender-python PYTHON]
        [--blender-triangles 2500 11000 38000] [--blender-frames 10]

On a machine with nothing else at work. Steps with one thread and with two are taken in turn. A share p of a step that
is parallel gives the ratio r of both: p = 2 (1 - 1 / r); what more cores would take is an estimate from it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.step_parts import compared

COMMAND = "import sys; from pb4u.cli.main import main; sys.exit(main())"


def threads_by_size(options: argparse.Namespace) -> list[str]:
    """Lines of one thread beside two, for every size, and of the growth."""
    lines, walls, sizes = [], [], []
    for triangles in options.triangles:
        asked = argparse.Namespace(**vars(options), model="quick-solver", threads=[1, 2], against=None, parts=True)
        one, two = compared(triangles, asked)
        ratio = one["wall"] / two["wall"]
        parallel = min(max(2.0 * (1.0 - 1.0 / ratio), 0.0), 1.0)
        eight, sixteen = (one["wall"] * (1.0 - parallel + parallel / n) for n in (8, 16))
        lines.append(
            f"{one['triangles']:7,} triangles: {one['wall']:,.0f} ms with one thread, {two['wall']:,.0f} with two, "
            f"ratio {ratio:.2f}; parallel {parallel:.0%}, estimated {eight:,.0f} ms on 8 cores, {sixteen:,.0f} on 16; "
            f"search {one['search']:.0%} of a step; {two['peak_mb']:,.0f} MB"
        )
        sizes.append(one["triangles"])
        walls.append((one["wall"], two["wall"]))
    if len(sizes) > 1:
        grown = np.polyfit(np.log(sizes), np.log(walls), 1)[0]
        lines.append(f"growth: T^{grown[0]:.2f} with one thread, T^{grown[1]:.2f} with two")
    return lines


def beside_blender(options: argparse.Namespace) -> list[str]:
    """Lines of the quick solver beside Blender's cloth, for every size."""
    with tempfile.TemporaryDirectory() as folder:
        figures = Path(folder) / "figures.json"
        command = [
            sys.executable, str(Path(__file__).with_name("side_by_side.py")), "--rivals", "quick", "blender",
            "--triangles", *map(str, options.blender_triangles), "--frames", str(options.blender_frames),
            "--lead-in", str(options.blender_frames), "--repeats", "1", "--json", str(figures), "--garment", "tshirt",
            "--motion", "walk", "--blender-python", options.blender_python,
        ]  # fmt: skip
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        found: dict[str, dict[str, Any]] = json.loads(figures.read_text())["figures"]
    lines = []
    for size, rows in found.items():
        line = "; ".join(f"{name} {row['wall_ms']:,.0f} ms, {row['energy_mj']:.1f} mJ" for name, row in rows.items())
        if "blender" in rows:
            line += f"; quick over blender {rows['quick']['wall_ms'] / rows['blender']['wall_ms']:.2f}"
        lines.append(f"{int(size):7,} triangles: {line}")
    return lines


def first_frame() -> str:
    """A line of the time that `pb4u simulate` takes to write one frame, kernels cached; the better of two."""
    taken = []
    for _ in range(3):
        with tempfile.TemporaryDirectory() as folder:
            command = [
                sys.executable,
                "-c",
                COMMAND,
                "simulate",
                "--frames",
                "1",
                "--out",
                str(Path(folder) / "out.npz"),
            ]
            began = time.perf_counter()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            taken.append(time.perf_counter() - began)
    return f"pb4u simulate --frames 1: {min(taken[1:]):.1f} s from Enter to its end"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, nargs="+", default=[2500, 11000, 38000, 100000])
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--blender-triangles", type=int, nargs="+", default=[2500, 11000, 38000])
    parser.add_argument("--blender-frames", type=int, default=10)
    parser.add_argument("--blender-python", default=sys.executable, help="a Python that has bpy")
    options = parser.parse_args()
    began = time.perf_counter()
    lines = [first_frame(), *threads_by_size(options), *beside_blender(options)]
    print("", *lines, f"all of it took {(time.perf_counter() - began) / 60.0:.1f} min", sep="\n")


if __name__ == "__main__":
    main()
