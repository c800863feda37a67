"""The implicit solver on built-in garments: iterations, milliseconds, strain, penetration, and how the energy falls.

    python benchmarks/solver.py --garments tshirt,dress --triangles 2500,11000,25000 --motion walk --frames 10

    python benchmarks/solver.py --landing 15 --garments dress --triangles 2500

Prints a table of rollouts, then the energy above its floor against iterations and milliseconds from a ballistic
start, for the solver and for L-BFGS preconditioned by mass and Laplacian factorised once; saves both as a plot. With
`--landing`, settles the garment and simulates that many frames instead, as `pb4u simulate` does and with ten times the
iterations and a tenth of the tolerance.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu
from torch import Tensor

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.environment import USUAL
from pb4u.garment.dressing import SkinnedPlacement
from pb4u.garment.library import build_garment
from pb4u.garment.material import nearest_isotropic
from pb4u.measures.metrics import ENERGIES, measure, strain_percentile
from pb4u.motion.library import load_motion
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.newton_solver import Iteration, Solver
from pb4u.physics.step_potential import StepPotential
from pb4u.scene.assembly import make_scene
from pb4u.scene.colliders import pack_colliders
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.state import State
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.first_frame import Settled
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.refinement import ImplicitSteps
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod
from pb4u.simulation.stepwise_simulator import SolverSimulator
from pb4u.simulation.timeline import Timeline

DT = 1.0 / 30.0
SETTLING_STEPS = 6


class Case:
    """A garment on a moving body."""

    def __init__(self, garment: str, triangles: int, motion: str, frames: int) -> None:
        body = load_body("woman")
        assert isinstance(body, ShapedBody)
        posed = body.posed(load_motion(motion).poses(body, 30.0, frames + 1))
        made = build_garment(garment, body, triangles)
        self.garments: PackedGarments = pack([made])
        bodies = pack_colliders([torch.as_tensor(posed.faces)], [torch.as_tensor(posed.contact)], [0])
        skinned = SkinnedPlacement(made, posed).positions(0, frames + 1).double()
        self.start, self.velocity = skinned[0], (skinned[1] - skinned[0]) / DT
        body_positions = posed.positions(0, frames + 1).double()
        self.timeline = Timeline(self.garments, bodies, body_positions, skinned, DT, USUAL)

    def step(self, state: State) -> StepPotential:
        return IncrementalPotential().of(self.timeline.step_from(state))

    def settled(self, solver: Solver) -> State:
        state = State(self.start, torch.zeros_like(self.start), 0)
        for _ in range(SETTLING_STEPS):
            step = IncrementalPotential().of(self.timeline.settling_from(state))
            state = State(solver.minimise(step, state.positions, 12).positions, state.velocities, 0)
        return State(state.positions, self.velocity, 0)


def roll_out(case: Case, frames: int) -> tuple[list[dict[str, float]], State]:
    """Measurements of each frame, and the state before the last."""
    solver, response = Solver(), ContactResponse()
    state = before = case.settled(solver)
    rows = []
    for _ in range(frames):
        began, cpu_began = time.perf_counter(), time.process_time()
        step = case.step(state)
        solution = solver.minimise(step, state.positions + DT * state.velocities)
        answered = response.respond(step.step, step.step.reached(solution.positions))
        spent, cpu = time.perf_counter() - began, time.process_time() - cpu_began
        before, state = state, answered
        effort = {
            "iterations": solution.iterations,
            "converged": solution.converged,
            "ms": 1e3 * spent,
            "cpu_ms": 1e3 * cpu,
        }
        rows.append({**effort, **measures(case, step, answered.positions)})
    return rows, before


class Landing(SolverSimulator):
    """The solver with `effort` times the iterations, of settling too, and its tolerance divided by as much."""

    def __init__(self, effort: int) -> None:
        careful = Settled(iterations=12 * effort, solver=self._strengthened(Solver(), effort))
        super().__init__(contact=ContactResponse(), first_frame=careful)
        self.effort = effort

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        method = super().method(timeline, record)
        assert isinstance(method.refinement, ImplicitSteps)
        self._strengthened(method.refinement.solver, self.effort)
        return method

    @staticmethod
    def _strengthened(solver: Solver, effort: int) -> Solver:
        solver.tolerance /= effort
        solver.max_iterations *= effort
        return solver


def landing(garment: str, triangles: int, motion: str, frames: int) -> dict[str, dict[str, float]]:
    """Strain and energies over the first frames, settled frame included, of both efforts."""
    scene = make_scene(garment, "woman", motion, triangles=triangles, frames=frames, lead_in=0)
    results = {}
    for effort in (1, 10):
        simulator, record = Landing(effort), RunRecord()
        metrics = measure(Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record)))[
            "metrics"
        ]
        figures = {name: metrics[name]["mean"] for name in ("strain_p95", *ENERGIES)}
        figures["all but gravity"] = metrics["total"]["mean"] - metrics["gravity"]["mean"]
        figures["strain_p95, most"] = metrics["strain_p95"]["max"]
        figures["strain_p95, settled"] = metrics["strain_p95"]["per_frame"][0]
        figures["iterations a step"] = float(np.mean(record.solver_iterations))
        figures["steps above tolerance"] = float(record.unsolved)
        results[f"{effort}x"] = figures
    return results


def measures(case: Case, step: StepPotential, x: Tensor) -> dict[str, float]:
    planes = step.contact_at(x)
    assert planes is not None
    depth = torch.where(planes.touchable, -planes.distance, 0.0)
    return {
        "strain_p95": float(strain_percentile(case.garments, x)),
        "penetration_percent": 100.0 * float((depth > 1e-3).double().mean()),
        "depth_mm": 1e3 * max(0.0, float(depth.max())),
        **step.energies(x).floats(),
    }


def newton_curve(step: StepPotential, start: Tensor, iterations: int) -> tuple[list[float], list[float]]:
    totals, times = [], []
    began = time.process_time()

    def watch(iteration: Iteration) -> None:
        totals.append(iteration.total)
        times.append(1e3 * (time.process_time() - began))

    Solver(max_iterations=iterations).minimise(step, start, watch=watch)
    return totals, times


def quasi_newton_curve(
    step: StepPotential, start: Tensor, iterations: int, memory: int = 8
) -> tuple[list[float], list[float]]:
    """L-BFGS with (mass / dt^2 + membrane Laplacian) factorised once; contacts are queried every ten iterations."""
    garments = step.step.garments
    factor = splu(csc_matrix(_laplacian(garments, step.step.dt)))
    x, began = start, time.process_time()
    frozen = step.with_contact_at(x)
    energies, gradient = frozen.energies_and_gradient(x)
    totals, times = [float(energies.total)], [0.0]
    pairs: list[tuple[Tensor, Tensor]] = []
    for k in range(iterations):
        if k % 10 == 9:
            frozen, pairs = step.with_contact_at(x), []
            energies, gradient = frozen.energies_and_gradient(x)
        direction, alphas = -gradient, []
        for s, y in reversed(pairs):
            alphas.append(float((s * direction).sum() / (s * y).sum()))
            direction = direction - alphas[-1] * y
        direction = torch.from_numpy(factor.solve(direction.numpy()))
        for (s, y), a in zip(pairs, reversed(alphas), strict=True):
            direction = direction + (a - float((y * direction).sum() / (s * y).sum())) * s
        slope, total, length = float((gradient * direction).sum()), float(energies.total), 1.0
        while length > 1e-6:
            if float(frozen.energies(x + length * direction).total) <= total + 1e-4 * length * slope:
                break
            length *= 0.5
        moved = x + length * direction
        energies, new_gradient = frozen.energies_and_gradient(moved)
        pair = moved - x, new_gradient - gradient
        if float((pair[0] * pair[1]).sum()) > 0:
            pairs = [*pairs, pair][-memory:]
        x, gradient = moved, new_gradient
        totals.append(float(energies.total))
        times.append(1e3 * (time.process_time() - began))
    return totals, times


def _laplacian(garments: PackedGarments, dt: float) -> coo_matrix:
    edges, count = garments.edges.numpy(), garments.vertex_count
    stiffness = 2.0 * float(nearest_isotropic(*garments.membrane.unbind(1))[0].mean())
    a, b = np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]])
    degree = np.bincount(a, minlength=count) * stiffness + garments.vertex_masses.numpy() / dt**2
    rows, columns = np.concatenate([a, np.arange(count)]), np.concatenate([b, np.arange(count)])
    return coo_matrix((np.concatenate([np.full(len(a), -stiffness), degree]), (rows, columns)), shape=(count, count))


def plot(curves: dict[str, tuple[list[float], list[float]]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), sharey=True)
    for name, (totals, times) in curves.items():
        floor = min(min(t) for n, (t, _) in curves.items() if n.split(",")[0] == name.split(",")[0])
        above = np.maximum(np.asarray(totals) - floor, 1e-9)
        axes[0].semilogy(above, label=name)
        axes[1].semilogy(times, above, label=name)
    axes[0].set(xlabel="iterations", ylabel="energy above the floor [J]")
    axes[1].set(xlabel="milliseconds of processor time")
    axes[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garments", default="tshirt,dress")
    parser.add_argument("--triangles", default="2500,11000,25000")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--curve-iterations", type=int, default=100, help="iterations of the curves; 0 leaves them out")
    parser.add_argument(
        "--out", type=Path, default=Path("solver_benchmark"), help="folder for the plot and the numbers"
    )
    parser.add_argument(
        "--landing", type=int, metavar="FRAMES", help="compare the first frames with ten times the effort"
    )
    options = parser.parse_args()
    if options.landing:
        for garment in options.garments.split(","):
            for triangles in map(int, options.triangles.split(",")):
                compared = landing(garment, triangles, options.motion, options.landing)
                print(f"{garment}, {triangles} triangles, {options.motion}, {options.landing} frames\n")
                print("| | usual | ten times | usual / ten times |\n|---|---|---|---|")
                for name, usual in compared["1x"].items():
                    most = compared["10x"][name]
                    print(
                        f"| {name} | {usual:.5g} | {most:.5g} | {usual / most if most else float('nan'):.3f} |",
                        flush=True,
                    )
        return
    options.out.mkdir(parents=True, exist_ok=True)
    names = [
        "iterations",
        "converged",
        "ms",
        "cpu_ms",
        "strain_p95",
        "penetration_percent",
        "depth_mm",
        "stretch",
        "bending",
        "collision",
    ]
    names += ["friction", "inertia"]
    print(f"{'':>18} " + " ".join(f"{n[:11]:>11}" for n in names))
    curves: dict[str, tuple[list[float], list[float]]] = {}
    results = {}
    for garment in options.garments.split(","):
        for triangles in map(int, options.triangles.split(",")):
            case = Case(garment, triangles, options.motion, options.frames)
            rows, before = roll_out(case, options.frames)
            label = f"{garment} {triangles}"
            results[label] = rows
            summary = [f"{np.mean([r[n] for r in rows]):>11.4g}" for n in names]
            print(f"{label:>18} " + " ".join(summary), flush=True)
            if options.curve_iterations:
                step, start = case.step(before), before.positions + DT * before.velocities
                curves[f"{label}, Newton"] = newton_curve(step, start, options.curve_iterations)
                curves[f"{label}, L-BFGS"] = quasi_newton_curve(step, start, options.curve_iterations)
    (options.out / "frames.json").write_text(json.dumps({"frames": results, "curves": curves}))
    if curves:
        plot(curves, options.out / "energy.png")
        for name, (totals, times) in curves.items():
            floor = min(min(t) for n, (t, _) in curves.items() if n.split(",")[0] == name.split(",")[0])
            picks = [k for k in (1, 5, 10, 30, 100) if k < len(totals)] + [len(totals) - 1]
            falls = "  ".join(f"{k}: {totals[k] - floor:.2e} J {times[k]:.0f} ms" for k in picks)
            print(f"{name:>26}  {falls}")


if __name__ == "__main__":
    main()
