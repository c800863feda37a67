"""Rivals on one scene, side by side: each in its own process and in turn, measured by the same means.

    python benchmarks/side_by_side.py [--triangles 2500 11000 38000] [--rivals default network ...] [--repeats 3]
        [--frames 30] [--lead-in 30] [--garment tshirt] [--motion walk] [--blender-python PYTHON]
        [--out side_by_side.md] [--json FILE] [--plot PICTURE.png]
    python benchmarks/side_by_side.py --again FILE.json [FILE.json ..] [--out ..] [--plot ..]

Every round takes each rival once, at each size, so that a machine that slows down slows all alike; times are medians
over the rounds of means over frames, without the first frames of a run, where kernels are compiled and caches filled.
Energies, strain, penetration and crossing triangles are `pb4u.measure`'s for all, whatever the rival minimises. What
else was at work on the machine meanwhile is counted and told: such times are no more than ratios.

Blender needs a Python with the `bpy` package (GPL, no part of pb4u): --blender-python, or `bpy` in this one.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np

WARM_UP = 3
"""Simulated frames left out of the times: with settling, compilation and filling of caches."""

BUSY = 0.1
"""Share of the processor taken by others from which times are called contended."""


@dataclass(frozen=True)
class Rival:
    """One way to simulate the scene.

    Args:
        title: row in the tables.
        options: of `load_simulator`; None for Blender, which has a runner of its own.
        needs: package without which it is left out.
    """

    title: str
    options: dict[str, Any] | None
    needs: str | None = None


RIVALS = {
    "skinning": Rival("bare skinning", {"name": "skinning"}),
    "default": Rival("pb4u, by default", {"name": "auto"}),
    "network": Rival("network alone", {"name": "auto", "refine": 0, "contact": False}),
    "network_float32": Rival(
        "network alone, float32", {"name": "auto", "refine": 0, "contact": False, "precision": "float32"}
    ),
    "quick": Rival("quick solver, no network", {"name": "quick-solver"}),
    "one_iteration": Rival("quick solver, one iteration", {"name": "quick-solver", "refine": 1}),
    "solver": Rival("solver", {"name": "solver"}),
    "newton": Rival("Newton, VBD", {"name": "newton"}, "newton"),
    "blender": Rival("Blender cloth", None),
}


def simulate_one(rival: str, options: argparse.Namespace, target: Path) -> None:
    """Run one rival in this process; its trajectory and figures go into the folder `target`."""
    from pb4u.scene.assembly import make_scene

    scene = make_scene(
        options.garment,
        options.body,
        options.motion,
        triangles=options.triangles[0],
        frames=options.frames,
        lead_in=options.lead_in,
    )
    run = _blender if RIVALS[rival].options is None else _own
    began, busy, own = time.perf_counter(), machine_seconds(), sum(os.times()[:4])
    trajectory, wall, processor, details = run(rival, scene, options)
    elapsed, others = time.perf_counter() - began, None
    now = machine_seconds()
    if busy is not None and now is not None:
        used = sum(os.times()[:4]) - own
        others = max(0.0, now - busy - used) / elapsed / (os.cpu_count() or 1)
    # A frame comes out behind the next step, so that the last one costs a lift alone.
    figures: dict[str, Any] = {
        "wall_ms": 1e3 * mean(wall[WARM_UP:-1]),
        "processor_ms": 1e3 * mean(processor[WARM_UP:-1]),
        "others": others,
        "triangles": len(trajectory.faces),
        "frames": [options.frames, options.lead_in],
        **details,
    }
    if options.measure:
        figures |= quality(trajectory)
    (target / "figures.json").write_text(json.dumps(figures))


def _own(rival: str, scene: Any, options: argparse.Namespace) -> tuple[Any, list[float], list[float], dict[str, Any]]:
    import resource

    from outside_reference import simulator_named

    from pb4u.scene.trajectory import Trajectory
    from pb4u.simulation.simulator import RunRecord

    simulator, record, spent = simulator_named(**RIVALS[rival].options), RunRecord(), [time.process_time()]
    frames = simulator.written_frames(scene, record, lambda *_: spent.append(time.process_time()))
    trajectory = Trajectory.collect(simulator.header(scene), frames)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    details = {"peak_mb": peak / 1024, "unsolved": record.unsolved, "settings": simulator.settings()}
    return trajectory, record.step_seconds, list(np.diff(spent)), details


def _blender(
    rival: str, scene: Any, options: argparse.Namespace
) -> tuple[Any, list[float], list[float], dict[str, Any]]:
    from pb4u.scene.trajectory import Frame, Trajectory
    from pb4u.simulation.simulator import SkinningSimulator

    if any(worn.garment.pinned.any() for worn in scene.garments):
        raise SystemExit("Blender's runner holds no pinned vertices; take a garment without.")
    (worn,), (body,) = scene.garments, scene.colliders
    header = SkinningSimulator().header(scene)
    moved = body.positions(0, scene.total_frames).numpy()
    with tempfile.TemporaryDirectory() as folder:
        source, result = Path(folder) / "scene.npz", Path(folder) / "result.npz"
        np.savez(
            source,
            start=worn.placement.positions(0, 1)[0].numpy(),
            faces=header.faces,
            body_positions=moved,
            body_faces=header.body_faces,
            fps=scene.fps,
            gravity=np.array(scene.environment.gravity),
            mass=float(worn.garment.vertex_masses.sum()),
        )
        runner = Path(__file__).with_name("blender_cloth.py")
        subprocess.run([options.blender_python, runner, source, result], check=True, stdout=subprocess.DEVNULL)
        with np.load(result) as file:
            found = {name: file[name] for name in file.files}
    positions = found["positions"]
    velocities = np.diff(positions, axis=0, prepend=positions[:1]) * scene.fps
    frames = [
        Frame(positions[frame], velocities[frame], moved[frame].astype(np.float32))
        for frame in range(scene.lead_in, scene.total_frames)
    ]
    details = {"peak_mb": float(found["peak_kib"]) / 1024, "settings": {"version": str(found["version"])}}
    return Trajectory.collect(header, iter(frames)), list(found["wall"]), list(found["processor"]), details


def quality(trajectory: Any) -> dict[str, float]:
    """What a trajectory is worth, by means that know nothing of who made it."""
    from pb4u.measures.metrics import measure

    measured = measure(trajectory)
    metrics = measured["metrics"]
    energy = metrics["total"]["mean"] - metrics["gravity"]["mean"]
    return {
        "energy_mj": 1e3 * energy,
        "stretch_mj": 1e3 * metrics["stretch"]["mean"],
        "bending_mj": 1e3 * metrics["bending"]["mean"],
        "strain_p95": metrics["strain_p95"]["mean"],
        "strain_max": metrics["strain_max"]["max"],
        "inside_percent": metrics["penetration_percent"]["mean"],
        "deepest_mm": 1e3 * metrics["penetration_depth_max"]["max"],
        "self_intersections": metrics["self_intersections"]["mean"],
        "body_intersections": metrics["body_intersections"]["mean"],
        "diverged": measured["diverged"],
    }


def machine_seconds() -> float | None:
    """Processor time [s] that all processes of the machine have used since it started; None where it does not tell."""
    try:
        fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    except OSError:
        return None
    user, nice, system = (int(field) for field in fields[:3])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")


def machine() -> dict[str, Any]:
    """What the figures depend on."""
    import torch

    from pb4u.simulation.models import has_bfloat16_units

    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {
        "processor": name,
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "bfloat16 units": has_bfloat16_units("cpu"),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "load before": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }


def rounds(options: argparse.Namespace, rivals: list[str]) -> Iterator[tuple[int, str, dict[str, Any]]]:
    """Triangles asked for, rival and figures of every run, in the order of the runs; the first of each is measured."""
    for repeat in range(options.repeats):
        for triangles in options.triangles:
            for rival in rivals:
                with tempfile.TemporaryDirectory() as folder:
                    command = [
                        sys.executable, __file__, "--one", rival, "--into", folder, "--triangles", str(triangles),
                        "--frames", str(options.frames), "--lead-in", str(options.lead_in),
                        "--garment", options.garment, "--body", options.body,
                        "--motion", options.motion, "--blender-python", options.blender_python,
                        *(["--measure"] if repeat == 0 else []),
                    ]  # fmt: skip
                    subprocess.run(command, check=True)
                    figures = json.loads((Path(folder) / "figures.json").read_text())
                print(
                    f"{triangles:6} {rival:16} {figures['wall_ms']:8.1f} ms by the wall "
                    f"{figures['processor_ms']:8.1f} ms of processor, others {_percent(figures['others'])}",
                    file=sys.stderr,
                    flush=True,
                )
                yield triangles, rival, figures


def summed_up(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Times and memory as medians over the runs of one rival at one size; the rest from its first."""
    result = dict(runs[0])
    for name in ("wall_ms", "processor_ms", "peak_mb"):
        result[name] = median(run[name] for run in runs)
    told = [run["others"] for run in runs if run["others"] is not None]
    result["others"] = max(told) if told else None
    return result


COLUMNS: tuple[tuple[str, Callable[[dict[str, Any]], str]], ...] = (
    ("ms a frame", lambda f: f"{f['wall_ms']:,.0f}"),
    ("processor ms", lambda f: f"{f['processor_ms']:,.0f}"),
    ("energy [mJ]", lambda f: f"{f['energy_mj']:,.1f}"),
    ("stretch", lambda f: f"{f['stretch_mj']:,.1f}"),
    ("bending", lambda f: f"{f['bending_mj']:,.2f}"),
    ("strain p95", lambda f: f"{f['strain_p95']:.3f}"),
    ("inside [%]", lambda f: f"{f['inside_percent']:.2f}"),
    ("deepest [mm]", lambda f: f"{f['deepest_mm']:.1f}"),
    ("self-intersections", lambda f: f"{f['self_intersections']:.1f}"),
    ("through the body", lambda f: f"{f['body_intersections']:.1f}"),
    ("peak [MB]", lambda f: f"{f['peak_mb']:,.0f}"),
    ("others", lambda f: _percent(f["others"])),
)


def _percent(share: float | None) -> str:
    return "unknown" if share is None else f"{100 * share:.0f} %"


def page(found: dict[str, Any]) -> str:
    """The figures as a page of Markdown."""
    asked, of = found["asked"], found["machine"]
    lines = [
        "# Performance, side by side",
        "",
        f"Made by `python benchmarks/side_by_side.py`: {asked['garment']} on {asked['body']}, {asked['motion']}, "
        f"{asked['frames']} frames after {asked['lead_in']} of lead-in, medians of rounds: {asked['repeats']}, "
        "every rival in a process of its own and in turn. Energies (without gravity, of our materials), strain, "
        "penetration and crossing triangles are `pb4u.measure`'s for all; Blender keeps its own stiffnesses.",
        "",
        "By default is `pb4u simulate` without flags, the network alone `--refine 0 --contact off`: its energy is low "
        "where it lies in the skin. Self-intersections and through the body are pairs of triangles that cross, a "
        "frame; others is the share of the processor that other programs took. What is missing was not run.",
        "",
        ", ".join(f"{name}: {value}" for name, value in of.items()) + ".",
        "",
    ]
    contended = [
        figures["others"]
        for rows in found["figures"].values()
        for figures in rows.values()
        if figures["others"] is not None and figures["others"] > BUSY
    ]
    if contended:
        lines += [
            f"**Others used up to {_percent(max(contended))} of the processor meanwhile: read the times as ratios of "
            "processor time, not as those of a quiet machine.**",
            "",
        ]
    for triangles, rows in found["figures"].items():
        lines += [f"## {int(triangles):,} triangles", ""]
        frames, lead_in = next(iter(rows.values()))["frames"]
        if [frames, lead_in] != [asked["frames"], asked["lead_in"]]:
            lines += [f"{frames} frames after {lead_in} of lead-in.", ""]
        lines.append("| |" + "".join(f" {title} |" for title, _ in COLUMNS))
        lines.append("|---|" + "---|" * len(COLUMNS))
        for rival, figures in rows.items():
            name = RIVALS[rival].title + (" (diverged)" if figures["diverged"] else "")
            lines.append(f"| {name} |" + "".join(f" {cell(figures)} |" for _, cell in COLUMNS))
        lines.append("")
    if len(found["figures"]) > 1:
        sizes = {rival: of for rival, (of, _) in _times(found).items()}
        grown = ", ".join(
            f"{RIVALS[rival].title} T^{power:.2f} (to {max(sizes[rival]):,})"
            for rival, power in exponents(found).items()
        )
        lines += [f"Growth of the time with the triangles T, fitted over the sizes run: {grown}.", ""]
    if found["left_out"]:
        lines += ["Left out: " + "; ".join(f"{name} ({why})" for name, why in found["left_out"].items()) + ".", ""]
    return "\n".join(lines)


def _times(found: dict[str, Any]) -> dict[str, tuple[list[float], list[float]]]:
    """Triangles and milliseconds a frame of each rival, in the order of the sizes."""
    times: dict[str, tuple[list[float], list[float]]] = {}
    for rows in found["figures"].values():
        for rival, figures in rows.items():
            sizes, spent = times.setdefault(rival, ([], []))
            sizes.append(figures["triangles"])
            spent.append(figures["wall_ms"])
    return times


def exponents(found: dict[str, Any]) -> dict[str, float]:
    """Power of the triangles that each rival's time grows with: slope of a line through the logarithms."""
    return {
        rival: float(np.polyfit(np.log(sizes), np.log(spent), 1)[0])
        for rival, (sizes, spent) in _times(found).items()
        if len(sizes) > 1
    }


def plot(found: dict[str, Any], target: Path) -> None:
    """Time a frame against triangles, both in logarithms, as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.5))
    powers = exponents(found)
    for rival, (sizes, spent) in _times(found).items():
        grown = f", T^{powers[rival]:.2f}" if rival in powers else ""
        axes.loglog(sizes, spent, marker="o", label=RIVALS[rival].title + grown)
    axes.set_xlabel("triangles")
    axes.set_ylabel("milliseconds a frame, by the wall")
    axes.set_title(f"{found['machine']['processor']}, {found['machine']['cores']} cores", fontsize=9)
    axes.grid(True, which="both", linewidth=0.3)
    axes.legend(frameon=False)
    figure.tight_layout()
    figure.savefig(target, dpi=120)


def absent(rival: str, blender_python: str) -> str | None:
    """Why a rival cannot run here, or None where it can."""
    needs = RIVALS[rival].needs
    if needs is not None and find_spec(needs) is None:
        return f"the package {needs} is not installed"
    if RIVALS[rival].options is None:
        try:
            subprocess.run([blender_python, "-c", "import bpy"], capture_output=True, check=True)
        except (OSError, subprocess.CalledProcessError):
            return "no Python with bpy; give --blender-python"
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, nargs="+", default=[2500, 11000, 38000])
    parser.add_argument("--rivals", nargs="+", choices=RIVALS, default=list(RIVALS))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--frames", type=int, default=30, help="frames to write, after the lead-in")
    parser.add_argument("--lead-in", type=int, default=30, help="frames simulated before; few of them set in abruptly")
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--body", default="woman")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--blender-python", default=sys.executable, help="a Python that has bpy")
    parser.add_argument("--out", type=Path, help="page to write")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--plot", type=Path, help="picture of times against triangles")
    parser.add_argument(
        "--again", type=Path, nargs="+", help="page and picture of figures that --json kept, all in one; nothing is run"
    )
    parser.add_argument("--one", choices=RIVALS, help=argparse.SUPPRESS)
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        simulate_one(options.one, options, options.into)
        return
    if options.again:
        show(together([json.loads(path.read_text()) for path in options.again]), options)
        return
    reasons = {rival: absent(rival, options.blender_python) for rival in options.rivals}
    left_out = {RIVALS[rival].title: why for rival, why in reasons.items() if why}
    rivals = [rival for rival, why in reasons.items() if why is None]
    at_start = machine()
    runs: dict[int, dict[str, list[dict[str, Any]]]] = {}
    for triangles, rival, figures in rounds(options, rivals):
        runs.setdefault(triangles, {}).setdefault(rival, []).append(figures)
    asked = {name: getattr(options, name) for name in ("garment", "body", "motion", "frames", "lead_in", "repeats")}
    found = {
        "machine": at_start,
        "asked": asked,
        "left_out": left_out,
        "figures": {size: {rival: summed_up(each) for rival, each in rows.items()} for size, rows in runs.items()},
    }
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    show(found, options)


def together(kept: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of several runs of one scene on one machine as those of one, coarse sizes first."""
    sizes = {size: rows for found in kept for size, rows in found["figures"].items()}
    return {**kept[0], "figures": {size: sizes[size] for size in sorted(sizes, key=int)}}


def show(found: dict[str, Any], options: argparse.Namespace) -> None:
    """Print the page; write it and the picture where asked to."""
    print(page(found))
    if options.out:
        options.out.write_text(page(found))
    if options.plot:
        plot(found, options.plot)


if __name__ == "__main__":
    main()
