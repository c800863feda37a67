"""Fine cloth from coarse: bulk motion by the quick solver on few triangles, wrinkles by a network or a few gradients.

    python benchmarks/coarse_to_fine.py --garment tshirt --motion walk --triangles 38000
    python benchmarks/coarse_to_fine.py --garment dress --motion dance --passes 1,2 --gradients 1,3,6,12

A fine step starts where the coarse garment carries the fine one, with a share of how the fine one lay beside it before.
Then the short waves are left to passes of `pb4u-light`, to gradient descent, or to iterations of the solver. All keep
cloth from passing through cloth, and the time of the coarse steps counts. Energy and wrinkles are those of the last ten
frames, over the quick solver's on the fine mesh.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import igl
import numpy as np
import torch
from torch import Tensor

import pb4u
from pb4u.collision.crossings import self_crossings
from pb4u.garment.garment import Garment
from pb4u.geometry.triangle_mesh import area_weighted_normals
from pb4u.measures.metrics import measure
from pb4u.physics.time_step import TimeStep, integrate
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod
from pb4u.simulation.stepwise_simulator import StepwiseSimulator
from pb4u.simulation.timeline import Timeline

LAST = 10
"""Frames that are measured."""


class Carrier:
    """Carries a fine garment along with a coarse one of the same cut.

    Args:
        fine: the garment.
        coarse: of fewer triangles, at rest in the same place.
    """

    def __init__(self, fine: Garment, coarse: Garment) -> None:
        vertices, faces = np.asarray(coarse.vertices, dtype=float), np.asarray(coarse.faces)
        places = np.asarray(fine.vertices, dtype=float)
        _, face, nearest = igl.point_mesh_squared_distance(places, vertices, faces)
        self._faces, self._corners = faces, faces[face]
        corners = [vertices[self._corners[:, k]] for k in range(3)]
        self._shares = igl.barycentric_coordinates(nearest, *corners)
        normals = self._interpolated(area_weighted_normals(vertices, faces))
        self._heights = ((places - nearest) * normals).sum(axis=1, keepdims=True)

    def at(self, coarse: Tensor) -> Tensor:
        """Vertices (fine vertices, 3) [m] beside a coarse garment at (coarse vertices, 3) [m]."""
        x = coarse.double().numpy()
        normals = self._interpolated(area_weighted_normals(x, self._faces))
        return torch.from_numpy(self._interpolated(x) + self._heights * normals)

    def _interpolated(self, values: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("vk,vkc->vc", self._shares, values[self._corners]))


@dataclass
class CarriedStart:
    """Starts a step where the coarse garment carries the fine one.

    Args:
        carrier: from one to the other.
        frames: (coarse vertices, 3) [m] of each frame, lead-in included.
        kept: share of how the fine garment lay beside the coarse one that stays from step to step.
    """

    carrier: Carrier
    frames: list[Tensor]
    kept: float

    def accelerations(self, step: TimeStep) -> Tensor:
        """Accelerations (vertices, 3) [m per step^2] from free flight to the start, as `BodyMotionWarmStart` gives."""
        free, frame = integrate(step, torch.zeros_like(step.state.positions)).positions, step.state.frame
        before, after = (self.carrier.at(self.frames[k]).to(free) for k in (max(frame, 0), frame + 1))
        start = after + self.kept * (step.state.positions - before)
        return torch.where(step.garments.pinned[:, None], 0.0, start - free)


@dataclass(eq=False, kw_only=True)
class CoarseToFine(StepwiseSimulator):
    """Takes the steps of another simulator, each from another start.

    Args:
        inner: gives what corrects the start.
        start: where a step starts.
    """

    name = "coarse-to-fine"
    inner: StepwiseSimulator
    start: CarriedStart

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        method = replace(self.inner.method(timeline, record), start=self.start)  # type: ignore[arg-type]
        return method


def methods(options: argparse.Namespace) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names of the methods, and what corrects their starts, as `load_simulator` takes it."""
    yield "nothing", {"model": "warm-start"}
    for passes in options.passes:
        yield f"`pb4u-light`, passes: {passes}", {"model": "pb4u-light", "passes": passes}
    for passes in options.gradients:
        yield f"gradients: {passes}", {"model": "gradient-descent", "passes": passes}
    yield "solver, iterations: 1", {"model": "quick-solver", "refine": 1}


def rolled(simulator: StepwiseSimulator, scene: Scene) -> tuple[list[Any], float]:
    """All states of a run, and its processor time a step [ms], without that of its first frame."""
    rollout = simulator.rollout(scene, RunRecord())
    first, began = next(rollout), time.process_time()
    states = [first, *rollout]
    return states, 1e3 * (time.process_time() - began) / (len(states) - 1)


def wrinkles(faces: np.ndarray, x: np.ndarray) -> float:
    """Variance [rad^2] of the angles between neighbouring faces of cloth at (vertices, 3) [m]."""
    neighbours = igl.triangle_triangle_adjacency(faces)[0]
    face, side = np.nonzero(neighbours > np.arange(len(faces))[:, None])
    normals = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(min=1e-20)
    cosines = (normals[face] * normals[neighbours[face, side]]).sum(axis=1)
    return float(np.arccos(cosines.clip(-1.0, 1.0)).var())


def judged(simulator: StepwiseSimulator, scene: Scene, states: list[Any]) -> tuple[float, float, float, int]:
    """Means of strain p95, energy [J] and wrinkles [rad^2] over the last frames, and pairs of cloth that cross."""
    frames = simulator.written_frames(scene, RunRecord(), simulated=iter(states))
    trajectory = Trajectory.collect(simulator.header(scene), frames)
    metrics = measure(trajectory, contact=False)["metrics"]
    faces, last = np.asarray(trajectory.faces), np.asarray(trajectory.positions[-LAST:], dtype=float)
    strain, energy = (float(np.mean(metrics[name]["per_frame"][-LAST:])) for name in ("strain_p95", "total"))
    crossing = sum(len(self_crossings(x, faces)) for x in last)
    return strain, energy, float(np.mean([wrinkles(faces, x) for x in last])), crossing


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, default=38_000)
    parser.add_argument("--coarse", type=int, default=2_500, help="triangles of the garment that gives the bulk motion")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--kept", type=float, default=0.9)
    for name, default in (("passes", "1,2"), ("gradients", "1,3,6,12")):
        parser.add_argument(f"--{name}", type=lambda text: [int(n) for n in text.split(",") if n], default=default)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)

    coarse, fine = (
        pb4u.make_scene(options.garment, "woman", options.motion, triangles=n, frames=options.frames, lead_in=10)
        for n in (options.coarse, options.triangles)
    )
    whole: Any = pb4u.load_simulator("quick-solver")
    states, coarse_ms = rolled(whole, coarse)
    carrier = Carrier(fine.garments[0].garment, coarse.garments[0].garment)
    start = CarriedStart(carrier, [state.positions for state in states], options.kept)
    states, ms = rolled(whole, fine)
    strain, reference, folds, crossing = judged(whole, fine, states)
    print(f"{options.garment}, {options.motion}, {options.triangles} from {options.coarse} triangles\n")
    heads = "corrected by", "ms a step, with the coarse one", "over the quick solver's", "strain p95", "energy"
    print(f"| {' | '.join([*heads, 'wrinkles', 'pairs that cross'])} |\n{'|---' * 7}|")
    print(f"| quick solver alone | {ms:.0f} | 1 | {strain:.3f} | 1 | 1 | {crossing} |", flush=True)
    for name, corrector in methods(options):
        inner: Any = pb4u.load_simulator(corrector.pop("model"), **{"refine": 0, "contact": True, **corrector})
        # All lower the same energies by the same rule of integration.
        laws = {"potential": whole.potential, "integrator": whole.integrator, "first_frame": whole.first_frame}
        vars(inner).update(laws)
        simulator = CoarseToFine(contact=inner.contact, inner=inner, start=start, **laws)
        states, own_ms = rolled(simulator, fine)
        strain, energy, own_folds, crossing = judged(simulator, fine, states)
        taken = own_ms + coarse_ms
        cells = f"{taken:.0f} | {taken / ms:.2f} | {strain:.3f} | {energy / reference:.2f} | {own_folds / folds:.2f}"
        print(f"| {name} | {cells} | {crossing} |", flush=True)


if __name__ == "__main__":
    main()
