"""Our solver beside Newton's on one scene: energies, strain, penetration and time, in one run, as a Markdown table.

    python benchmarks/outside_reference.py [--garment tshirt] [--body woman] [--motion walk] [--triangles 2500]
        [--frames 60] [--models solver newton] [--still FOLDER] [--json FILE]

Times are medians over the simulated frames, the first three, where kernels are compiled, left out. On a busy machine
compare the times of one run only.
"""

from __future__ import annotations

import argparse
import json
import platform
from pathlib import Path
from statistics import median
from typing import Any

from newton_cloth import simulator_named

from pb4u.measures.metrics import ENERGIES, measure
from pb4u.scene.assembly import make_scene
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord

WARM_UP = 3


def compared(model: str, scene: Scene) -> tuple[dict[str, Any], Trajectory]:
    """Figures of one model, and its trajectory."""
    simulator, record = simulator_named(model), RunRecord()
    trajectory = Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record))
    measured = measure(trajectory)
    metrics = measured["metrics"]
    figures = {f"{name} [mJ]": 1000.0 * metrics[name]["mean"] for name in ENERGIES}
    figures["strain_p95, mean"] = metrics["strain_p95"]["mean"]
    figures["strain_p95, max"] = metrics["strain_p95"]["max"]
    figures["strain_max, max"] = metrics["strain_max"]["max"]
    figures["vertices inside, mean [%]"] = metrics["penetration_percent"]["mean"]
    figures["deepest [mm]"] = 1000.0 * metrics["penetration_depth_max"]["max"]
    figures["ms a frame"] = 1000.0 * median(record.step_seconds[WARM_UP:] or record.step_seconds)
    figures["diverged"] = measured["diverged"]
    return figures, trajectory


def table(columns: dict[str, dict[str, Any]]) -> str:
    """The figures of all models, a model a column."""
    lines = ["| |" + "".join(f" {model} |" for model in columns), "|---|" + "---|" * len(columns)]
    for row in next(iter(columns.values())):
        values = (columns[model][row] for model in columns)
        cells = (("yes" if v else "no") if isinstance(v, bool) else f"{v:.4g}" for v in values)
        lines.append(f"| {row} |" + "".join(f" {cell} |" for cell in cells))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--body", default="woman")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=60, help="frames to write, after the lead-in")
    parser.add_argument("--models", nargs="+", default=["solver", "newton"])
    parser.add_argument("--still", type=Path, help="folder for a strip of pictures of each model")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    scene = make_scene(
        arguments.garment,
        arguments.body,
        arguments.motion,
        triangles=arguments.triangles,
        frames=arguments.frames,
    )
    columns = {}
    for model in arguments.models:
        columns[model], trajectory = compared(model, scene)
        if arguments.still:
            from pb4u.export.picture import write_still

            arguments.still.mkdir(parents=True, exist_ok=True)
            write_still(trajectory, arguments.still / f"{model}.png")
    print(
        f"{arguments.garment} of {len(trajectory.faces)} triangles on {arguments.body}, {arguments.motion}, "
        f"{arguments.frames} frames after {scene.lead_in} of lead-in; {platform.processor() or platform.machine()}.\n"
    )
    print(table(columns))
    if arguments.json:
        arguments.json.write_text(json.dumps(columns, indent=1) + "\n")


if __name__ == "__main__":
    main()
