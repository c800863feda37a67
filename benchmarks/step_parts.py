"""Where the time of a solver's step goes, by size; also beside another checkout, or with other numbers of threads.

    python benchmarks/step_parts.py [--triangles 2500 11000 38000] [--frames 8] [--model quick-solver] [--threads 1 2]
        [--against OTHER/src] [--parts]

Every variant (checkout and number of threads) runs in a process of its own. They take their steps in turn, so that a
machine that slows down slows all alike. Times are medians over the steps after the second; `--parts` (of variants with
one thread) are means of processor time, each part without the parts inside it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

PARTS: tuple[tuple[str, str, str], ...] = (
    ("search", "pb4u.collision.surface_tree:SurfaceTree", "pairs"),
    ("stopping", "pb4u.physics.contact.self_contact:CollisionFree", "collision_free_move"),
    ("stopping", "pb4u.physics.contact.self_contact:CollisionFree", "shares"),
    ("pairs", "pb4u.physics.contact.self_contact:ClothPairs", "along"),
    ("pairs", "pb4u.physics.contact.self_contact:ClothPairs", "touching"),
    ("obstacle", "pb4u.physics.contact.obstacle:Obstacle", "at"),
    ("obstacle", "pb4u.physics.contact.obstacle:Obstacle", "over"),
    ("closest points", "pb4u.physics.contact.contact_set", "_renewed"),
    ("clean-up", "pb4u.physics.contact.penetration_cleanup:FaceClearance", "lift"),
    ("response", "pb4u.simulation.penetration_response:ContactResponse", "respond"),
    ("response", "pb4u.simulation.penetration_response:ContactResponse", "cleared"),
    ("start", "pb4u.simulation.step_start:BodyMotionWarmStart", "accelerations"),
    ("energies", "pb4u.physics.step_potential:StepPotential", "energies"),
    ("gradients", "pb4u.physics.step_potential:StepPotential", "energies_and_gradient"),
    ("second derivatives", "pb4u.physics.step_potential:StepPotential", "stiffness"),
    ("second derivatives", "pb4u.physics.step_potential:StepPotential", "pair_stiffness"),
    ("tangents", "pb4u.physics.terms.collision", "_follow"),
    ("tangents", "pb4u.physics.terms.friction", "_follow"),
    ("preconditioner", "pb4u.physics.solver.preconditioner:AgeingPreconditioner", "update"),
    ("linear solves", "pb4u.physics.solver.newton_solver", "conjugate_gradient"),
    ("rest of the solver", "pb4u.physics.solver.newton_solver:Solver", "minimise"),
    ("pierced edges", "pb4u.simulation.refinement", "newly_pierced"),
)


def step_by_step(options: argparse.Namespace) -> None:
    """Take a step for every line of the input, and write its times as a line; positions go into a file."""
    from pb4u.scene.assembly import make_scene
    from pb4u.simulation.models import load_simulator
    from pb4u.simulation.simulator import RunRecord

    spent: dict[str, float] = {}
    if options.parts:
        from benchmarks.training import Stopwatch

        watch = Stopwatch(lambda: None, time.process_time)
        spent = watch.seconds
        for name, place, attribute in PARTS:
            module, _, owner = place.partition(":")
            holder = getattr(import_module(module), owner) if owner else import_module(module)
            for kind in (holder, *holder.__subclasses__()) if owner else (holder,):
                if attribute in vars(kind):
                    watch.watch(name, kind, attribute)
    scene = make_scene(
        options.garment, "woman", options.motion, triangles=options.triangles[0], frames=options.frames + 2, lead_in=0
    )
    record, positions = RunRecord(), []
    states = load_simulator(options.model).rollout(scene, record)
    for number in range(options.frames):
        sys.stdin.readline()
        spent.clear()
        wall, processor = time.perf_counter(), time.process_time()
        state = next(states)
        row = {"wall": time.perf_counter() - wall, "processor": time.process_time() - processor, "parts": dict(spent)}
        positions.append(state.positions.numpy())
        if number == options.frames - 1:
            row["triangles"] = int(sum(len(worn.garment.faces) for worn in scene.garments))
            row["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            row["iterations"] = float(np.mean(record.solver_iterations)) if record.solver_iterations else None
            np.save(options.into, np.stack(positions))
        print(json.dumps(row), flush=True)


def started(source: Path, threads: int, triangles: int, target: Path, options: argparse.Namespace) -> Any:
    """A process that takes steps with the package of `source`."""
    own = Path(__file__).parent.parent
    environment = {
        **os.environ,
        "PYTHONPATH": f"{source}{os.pathsep}{own}",
        **{f"{name}_NUM_THREADS": str(threads) for name in ("OMP", "NUMBA")},
        # As in the command: small products are not shared out.
        **{f"{name}_NUM_THREADS": "1" for name in ("MKL", "OPENBLAS")},
    }
    command = [
        sys.executable, __file__, "--into", str(target), "--triangles", str(triangles), "--frames", str(options.frames),
        "--model", options.model, "--garment", options.garment, "--motion", options.motion,
        *(["--parts"] if options.parts and threads == 1 else []),
    ]  # fmt: skip
    return subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def compared(triangles: int, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Print what each variant takes at one size, and give it back: ms by the wall, MB at most, shares of parts."""
    own = Path(__file__).parent.parent / "src"
    sources = {"this": own} | ({"other": options.against.resolve()} if options.against else {})
    variants = [(f"{name}, {n} thread(s)", source, n) for name, source in sources.items() for n in options.threads]
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{number}.npy" for number in range(len(variants))]
        processes = [
            started(source, threads, triangles, file, options)
            for (_, source, threads), file in zip(variants, files, strict=True)
        ]
        rows: list[list[dict[str, Any]]] = [[] for _ in variants]
        for _ in range(options.frames):
            for process, kept in zip(processes, rows, strict=True):
                process.stdin.write("\n")
                process.stdin.flush()
                kept.append(json.loads(process.stdout.readline()))
        for process in processes:
            process.stdin.close()
            process.wait()
        places = [np.load(file) for file in files]
    print(f"{rows[0][-1]['triangles']} triangles, {options.frames} frames", end="")
    # The quick solver counts none.
    counts = [f"{kept[-1]['iterations']:.2f}" for kept in rows if kept[-1]["iterations"] is not None]
    print(f", iterations a step: {', '.join(counts)}" if counts else "")
    began = min(2, options.frames - 1)
    for number, (name, _, _) in enumerate(variants):
        wall, processor = (
            1e3 * float(np.median([row[kind] for row in rows[number][began:]])) for kind in ("wall", "processor")
        )
        ratios = [
            float(np.median([a[kind] / b[kind] for a, b in zip(rows[number][began:], rows[-1][began:], strict=True)]))
            for kind in ("wall", "processor")
        ]
        apart = 1e3 * float(np.abs(places[number] - places[-1]).max())
        steps = 1e3 * np.array([row["wall"] for row in rows[number][began:]])
        print(
            f"  {name:20} {wall:9.1f} ms by the wall {processor:9.1f} of processor; over the last: {ratios[0]:.3f} "
            f"{ratios[1]:.3f}; positions apart by {apart:.2g} mm; mean {steps.mean():.1f} ms, of 95 % at most "
            f"{np.percentile(steps, 95):.1f}, longest {steps.max():.1f}"
        )
    for part in dict.fromkeys(name for name, _, _ in PARTS) if options.parts else ():
        means = [1e3 * float(np.mean([row["parts"].get(part, 0.0) for row in kept[began:]])) for kept in rows]
        wholes = [1e3 * float(np.mean([row["processor"] for row in kept[began:]])) for kept in rows]
        shares = " ".join(f"{mean:9.1f} ms {mean / whole:6.1%}" for mean, whole in zip(means, wholes, strict=True))
        print(f"    {part:20} {shares}", flush=True)
    return [
        {
            "wall": 1e3 * float(np.median([row["wall"] for row in kept[began:]])),
            "peak_mb": kept[-1]["peak_mb"],
            "triangles": kept[-1]["triangles"],
            "search": sum(row["parts"].get("search", 0.0) for row in kept[began:])
            / sum(row["processor"] for row in kept[began:]),
        }
        for kept in rows
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, nargs="+", default=[2500, 11000, 38000])
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--model", default="quick-solver")
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--threads", type=int, nargs="+", default=[1])
    parser.add_argument("--against", type=Path, help="the folder src of another checkout")
    parser.add_argument("--parts", action="store_true")
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.into:
        step_by_step(options)
        return
    for triangles in options.triangles:
        compared(triangles, options)


if __name__ == "__main__":
    main()
