"""How near the minimum of a step its passes come: ranks networks, where whole clips differ by a tenth by chance.

    python benchmarks/pass_convergence.py [--models pb4u-wide,FILE] [--garments tshirt,dress] [--motions walk,jump]
        [--triangles 2500] [--frames 30] [--every 4] [--json FILE]

Along a rollout of the quick solver, every few frames: the height to which the energy above the minimum would lift the
garment, where the step starts, after each pass, and where the network leaves it; the minimum is the solver's from where
the rollout goes. Every network sees the same states; the step before is taken as well, so that its last move is known.
"""

from __future__ import annotations

import argparse
import json
import warnings
from pathlib import Path

import numpy as np

from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.newton_solver import Solver
from pb4u.scene.assembly import make_scene
from pb4u.simulation.models import load_simulator
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import predictions, take
from pb4u.simulation.stepwise_simulator import NetworkSimulator, StepwiseSimulator
from pb4u.simulation.timeline import Timeline

LEAD_IN = 12
"""Frames before the motion's first: by then the cloth moves with the body."""

_SMALLEST = 1e-3
"""Height [mm] that a geometric mean takes for less: the solver's tolerance."""


def heights(models: dict[str, StepwiseSimulator], scene: str, options: argparse.Namespace) -> dict[str, np.ndarray]:
    """Heights (steps, stages) [mm] left by each model: at the start, after each of its own passes, and at the end."""
    garment, motion = scene.split(":")
    made = make_scene(
        garment,
        "woman",
        motion,
        triangles=options.triangles,
        frames=options.frames,
        lead_in=LEAD_IN,
        seed=2000,
        rest_shape="moulded",
    )
    timeline, record, potential = Timeline.of(made), RunRecord(), IncrementalPotential()
    quick = load_simulator("quick-solver", contact=False, self_contact=False)
    assert isinstance(quick, StepwiseSimulator)
    going = quick.method(timeline, record)
    states = [next(iter(quick.first_frame.states(timeline, going))).state]
    for _ in range(made.total_frames - 1):
        states.append(take(timeline.step_from(states[-1]), going).state)
    left: dict[str, list[list[float]]] = {name: [] for name in models}
    for frame in range(LEAD_IN, len(states) - 1, options.every):
        step = timeline.step_from(states[frame])
        lowest = Solver().minimise(potential.of(step), states[frame + 1].positions)
        evaluated = potential.of(step)
        least = float(evaluated.energies(lowest.positions).total)
        weight = float(step.garments.world_weights.sum())
        for name, model in models.items():
            method = model.method(timeline, record)
            *_, earlier = predictions(timeline.step_from(states[frame - 1]), method)
            begun = timeline.step_from(states[frame])
            made = [each.state.positions for each in predictions(begun, method, earlier.last_move)]
            energies = [float(evaluated.energies(x).total) for x in made]
            stages = [*energies[: method.network.passes + 1], energies[-1]]
            left[name].append([1e3 * (energy - least) / weight for energy in stages])
    return {name: np.array(rows) for name, rows in left.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default="pb4u-wide")
    parser.add_argument("--garments", default="tshirt,tanktop,longsleeve,dress,trousers,skirt")
    parser.add_argument("--motions", default="walk,dance,jump")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    models: dict[str, StepwiseSimulator] = {}
    for name in options.models.split(","):
        simulator = load_simulator(name, contact=False, self_contact=False, refine=0, device="cpu")
        assert isinstance(simulator, NetworkSimulator)
        models[name] = simulator
    rows: dict[str, list[np.ndarray]] = {name: [] for name in models}
    print("| garment | motion | model | start | after each pass | at the end |\n|---|---|---|---|---|---|")

    def line(what: str, name: str, means: np.ndarray) -> None:
        passes = ", ".join(f"{value:.2f}" for value in means[1:-1])
        print(f"| {what} | {name} | {means[0]:.2f} | {passes} | {means[-1]:.2f} |", flush=True)

    for garment in options.garments.split(","):
        for motion in options.motions.split(","):
            for name, found in heights(models, f"{garment}:{motion}", options).items():
                rows[name].append(found)
                line(f"{garment} | {motion}", name, np.median(found, axis=0))
    for name, found in rows.items():
        line("all | geometric mean", name, np.exp(np.log(np.maximum(np.concatenate(found), _SMALLEST)).mean(0)))
    if options.json:
        options.json.write_text(json.dumps({name: np.concatenate(found).tolist() for name, found in rows.items()}))


if __name__ == "__main__":
    main()
