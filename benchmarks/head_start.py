"""Does the network earn its place? The solver from free flight, from where the network starts, and from its prediction.

    python benchmarks/head_start.py [--models pb4u-small,FILE] [--garments tshirt,dress] [--triangles 2500,11000]
        [--motion walk] [--frames 10] [--targets 5,30] [--json FILE]

Along a rollout of the solver each step is raced: the target is the energy after so many iterations from free flight;
counted are iterations and processor time until a start has reached it, the network's own time included. Where a start
ends in another minimum, above the target by more than `--slack` of the energy that moved, it is not reached.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.newton_solver import Iteration, Solver
from pb4u.physics.time_step import TimeStep
from pb4u.scene.assembly import make_scene
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import from_pretrained
from pb4u.simulation.penetration_response import Contact
from pb4u.simulation.refinement import Refinement
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod, predictions
from pb4u.simulation.step_start import start_of
from pb4u.simulation.stepwise_simulator import NetworkSimulator, SolverSimulator
from pb4u.simulation.timeline import Timeline

FREE_FLIGHT = "free flight"
MOST_ITERATIONS = 60


@dataclass
class Run:
    """One start's way down: total energy [J] and processor time [s] before each iteration."""

    began: float
    energies: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def note(self, iteration: Iteration) -> None:
        self.energies.append(iteration.total)
        self.seconds.append(time.process_time() - self.began)

    def reached(self, energy: float) -> tuple[int, float] | None:
        """Iterations and milliseconds until the energy was at most that."""
        for iteration, (total, seconds) in enumerate(zip(self.energies, self.seconds, strict=True)):
            if total <= energy:
                return iteration, 1e3 * seconds
        return None


class Race(Refinement):
    """Goes on as the solver does, and races the starts at every step after the first `skipped`."""

    def __init__(self, usual: Refinement, starts: dict[str, StepMethod], skipped: int) -> None:
        self.usual, self.starts, self.skipped = usual, starts, skipped
        self.solver = Solver(tolerance=0.0, max_iterations=MOST_ITERATIONS)
        self.runs: list[dict[str, Run]] = []

    def refine(self, step: TimeStep, predicted: State) -> State:
        if self.skipped > 0:
            self.skipped -= 1
        else:
            self.runs.append({name: self._run(start, step) for name, start in self.starts.items()})
        return self.usual.refine(step, predicted)

    def respond_with_cloth(self, step: TimeStep, state: State, contact: Contact) -> State:
        return self.usual.respond_with_cloth(step, state, contact)

    def _run(self, start: StepMethod, step: TimeStep) -> Run:
        run = Run(time.process_time())
        *_, predicted = predictions(step, start)
        self.solver.minimise(IncrementalPotential().of(step), predicted.positions, watch=run.note)
        return run


class RacingSimulator(SolverSimulator):
    """The solver, with networks racing beside it."""

    def __init__(self, models: list[str], lead_in: int) -> None:
        super().__init__()
        self.models, self.lead_in = models, lead_in
        self.race: Race

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        usual = super().method(timeline, record)
        starts = {FREE_FLIGHT: StepMethod()}
        for name in self.models:
            checkpoint = from_pretrained(name)
            if checkpoint.model.network.warm_start_shares:
                # What the network has to beat.
                starts[f"{Path(name).stem}, its start alone"] = StepMethod(start_of(checkpoint.model.network))
            for passes in sorted({1, checkpoint.model.network.passes}):
                label = f"{Path(name).stem}, {passes} pass{'es' * (passes > 1)}"
                starts[label] = NetworkSimulator(checkpoint, passes=passes).method(timeline, record)
        self.race = Race(usual.refinement, starts, self.lead_in)
        return replace(usual, refinement=self.race)


def summary(runs: list[dict[str, Run]], iterations: int, slack: float) -> dict[str, dict[str, Any]]:
    """Median iterations and milliseconds of each start to the energy after `iterations` from free flight."""
    rows: dict[str, dict[str, Any]] = {}
    for name in runs[0]:
        reached = []
        for run in runs:
            free = run[FREE_FLIGHT].energies
            target = free[min(iterations, len(free) - 1)]
            reached.append(run[name].reached(target + slack * (free[0] - target)))
        counted = [entry for entry in reached if entry is not None]
        rows[name] = {
            "reached": len(counted),
            "of": len(runs),
            "iterations": statistics.median(i for i, _ in counted) if counted else None,
            "ms": statistics.median(ms for _, ms in counted) if counted else None,
            "start_energy": statistics.median(run[name].energies[0] for run in runs),
        }
    return rows


def main() -> None:
    """Race, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default="pb4u-small")
    parser.add_argument("--garments", default="tshirt,dress")
    parser.add_argument("--triangles", default="2500,11000")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--lead-in", type=int, default=15)
    parser.add_argument("--targets", default="5,30")
    parser.add_argument("--slack", type=float, default=1e-5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    results = []
    print("| garment | triangles | target | start | reached | iterations | ms |\n|---|---|---|---|---|---|---|")
    for garment in options.garments.split(","):
        for triangles in map(int, options.triangles.split(",")):
            scene = make_scene(
                garment, "woman", options.motion, triangles=triangles, frames=options.frames, lead_in=options.lead_in
            )
            simulator = RacingSimulator(options.models.split(","), options.lead_in)
            for _ in simulator.written_frames(scene, RunRecord()):
                pass
            for target in map(int, options.targets.split(",")):
                for name, row in summary(simulator.race.runs, target, options.slack).items():
                    results.append({"garment": garment, "triangles": triangles, "target": target, "start": name, **row})
                    figures = "- | -" if row["iterations"] is None else f"{row['iterations']:g} | {row['ms']:.0f}"
                    print(
                        f"| {garment} | {triangles} | {target} iterations | {name} | {row['reached']} of {row['of']} | "
                        f"{figures} |",
                        flush=True,
                    )
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
