"""Energy above the minimum of a time step, as a height; and a reference rollout whose states methods are compared on.

Every step has a least energy, and a method leaves more than that. The total potential counts, gravity with it: cloth
that floats has little stretch, but lies above the minimum by what it did not fall. Divided by the weight the excess is
a height, which cloths and resolutions share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.measures.metrics import Ruler
from pb4u.physics.contact.contact_set import nearest_planes
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.integrator import IMPLICIT_EULER, INTEGRATORS
from pb4u.physics.solver.implicit_steps import free_flight, implicit_steps, substep_count
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.terms.air import Air
from pb4u.physics.time_step import DivergedError, TimeStep
from pb4u.progress import Progress, no_progress
from pb4u.scene.state import State
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.step import StepMethod, predictions, take
from pb4u.simulation.step_start import BodyMotionWarmStart
from pb4u.simulation.timeline import Timeline

BEATEN_BY = 1e-6
"""Height [m] by which a result must lie below the reference to have beaten it: a thousandth of a millimetre."""

SHARED_EVERY = 4
"""Frames from one shared state to the next."""


class Minimum(NamedTuple):
    """Lowest energy found for a step.

    Args:
        energy: total potential [J]; infinite where the solver reached none.
        positions: (vertices, 3) [m] of the minimum; the start of the search if it found none.
    """

    energy: float
    positions: Tensor


class StepMinima:
    """Finds minima of time steps; keeps the data that the solver derives from the garments.

    Args:
        potential: energies that count.
    """

    def __init__(self, potential: IncrementalPotential) -> None:
        self.potential, self.solver = potential, Solver()
        self._warm_start = BodyMotionWarmStart(potential)

    def energy(self, step: TimeStep, x: Tensor) -> float:
        """Total potential [J] at the end of a step.

        Args:
            step: garments in float64 on the CPU.
            x: (vertices, 3) [m] at its end.
        """
        return float(self.potential.of(step).energies(x).total)

    def usual_starts(self, step: TimeStep, pinned: Tensor | None = None) -> list[Tensor]:
        """Starting points of the search for minima: free flight and the body's motion, each (vertices, 3) [m].

        Args:
            step: garments in float64 on the CPU.
            pinned: (vertices, 3) [m] where pinned vertices will be, where the step does not say.
        """
        if step.skinned_motion is None:
            step = replace(step, skinned_motion=_motion_of_the_body(step))
        starts = [free_flight(step), self._warm_start.positions(step)]
        if pinned is None:
            return starts
        return [torch.where(step.garments.pinned[:, None], pinned, start) for start in starts]

    def lowest(self, step: TimeStep, starts: Iterable[Tensor]) -> Minimum:
        """Lowest of the minima that the solver reaches, with one solve for each start.

        Args:
            step: garments in float64 on the CPU.
            starts: (vertices, 3) [m] each, pinned vertices where they will be.
        """
        minimum = Minimum(math.inf, step.state.positions)
        for start in starts:
            try:
                x = self.solver.minimise(self.potential.of(step), start).positions
            except DivergedError:
                continue
            energy = self.energy(step, x)
            if energy < minimum.energy:
                minimum = Minimum(energy, x)
        return minimum

    def excess(self, step: TimeStep, x: Tensor, least: float) -> float:
        """Height [m] to which the energy above a minimum would lift the garments; negative where `x` lies below it.

        Args:
            step: garments in float64 on the CPU.
            x: (vertices, 3) [m] at its end.
            least: energy of the minimum [J].
        """
        return (self.energy(step, x) - least) / float(step.garments.world_weights.sum())


def _motion_of_the_body(step: TimeStep) -> Tensor:
    """How far (vertices, 3) [m] the body nearest to each vertex moves; 0 without a body."""
    still, bodies = torch.zeros_like(step.state.positions), step.bodies
    if bodies is None:
        return still
    planes = nearest_planes(bodies.now, step.garments, step.state.positions, within=math.inf)
    motion = planes.interpolated(bodies.motion, bodies.colliders.contact_faces)
    return torch.where(planes.touchable[:, None], motion, still)


def excess_heights(trajectory: Trajectory, progress: Progress = no_progress) -> list[float]:
    """Excess height [m] of every frame over the minimum of the step that led to it; three solves a frame.

    The minimum is the lowest that the solver reaches from the frame itself, from free flight and from the body's
    motion. It is negative if the solver ended with more energy than the frame. The first frame, which has no step
    before it, and frames that are not finite give NaN. Contact of cloth with cloth, air and the rule of integration are
    those of the run; the first step is one of implicit Euler, since a frame does not store the steps before it.

    Args:
        trajectory: frames as written.
        progress: called with (frames done, frames in all).

    Raises:
        InputError: the metadata lack the materials of the garments.
    """
    ruler, potential, had = Ruler(trajectory), IncrementalPotential(), trajectory.metadata
    if had.get("self_contact"):
        potential = potential.with_self_contact()
    if had.get("air"):
        potential = potential.with_term(Air())
    rule = INTEGRATORS[had.get("time_integration", IMPLICIT_EULER.name)]
    minima, heights, history = StepMinima(potential), [math.nan], tuple[Tensor, ...]()
    for t in range(1, trajectory.frame_count):
        x = torch.from_numpy(np.array(trajectory.positions[t], dtype=np.float64))
        step = ruler.step(t, x)
        step = replace(step, state=replace(step.state, history=history), integrator=rule)
        finite = np.isfinite(trajectory.positions[t - 1 : t + 1]).all()
        heights.append(_excess_height(minima, step, x) if finite else math.nan)
        history = step.reached(x, potential.of(step).struck(x)).history if finite else ()
        progress(t + 1, trajectory.frame_count)
    return heights


def _excess_height(minima: StepMinima, step: TimeStep, x: Tensor) -> float:
    least = minima.lowest(step, [x, *minima.usual_starts(step, pinned=x)]).energy
    return minima.excess(step, x, least) if math.isfinite(least) else math.nan


def distance_to(trajectory: Trajectory, reference: Trajectory) -> list[float]:
    """Mean distance [m] of the vertices from where a reference has them, frame by frame.

    Args:
        trajectory: to be compared.
        reference: the same garments over at least as many frames.

    Raises:
        InputError: the reference is of other meshes, another frame rate or fewer frames.
    """
    require_reference(reference, trajectory.faces, trajectory.fps, trajectory.frame_count)
    pairs = zip(trajectory.positions, reference.positions, strict=False)
    return [float(np.linalg.norm(np.asarray(x, dtype=np.float64) - y, axis=1).mean()) for x, y in pairs]


def require_reference(reference: Trajectory, faces: np.ndarray, fps: float, frames: int | None = None) -> None:
    """Refuse a reference that does not fit.

    Args:
        reference: the trajectory.
        faces: (faces, 3) of the run.
        fps: frames per second of the run.
        frames: number of frames of the run, if known.

    Raises:
        InputError: it is of other meshes, another frame rate or fewer frames.
    """
    if not np.array_equal(reference.faces, faces):
        raise InputError(
            f"The reference has another mesh: {len(reference.faces)} triangles, and the run {len(faces)}; simulate it "
            "with the same garments and the same --triangles."
        )
    if not math.isclose(reference.fps, fps):
        raise InputError(f"The reference has {reference.fps:g} frames per second, and the run {fps:g}.")
    if frames is not None and reference.frame_count < frames:
        raise InputError(f"The reference has {reference.frame_count} frames, fewer than the {frames} of the run.")


def series(values: Sequence[float]) -> dict[str, object]:
    """Per-frame values with their mean and maximum; frames that are not a number are left out of both.

    Args:
        values: one value a frame, in any unit.
    """
    present = [value for value in values if not math.isnan(value)]
    return {
        "per_frame": list(values),
        "mean": float(np.mean(present)) if present else math.nan,
        "max": max(present, default=math.nan),
    }


@dataclass(frozen=True, eq=False)
class SharedState:
    """A state from which every method takes one step.

    Args:
        before: state one frame earlier, from which a method that uses its last move first takes a step.
        state: the state itself.
        least: least energy [J] of the step from it, of several starts.
    """

    before: State
    state: State
    least: float


@dataclass(frozen=True, eq=False)
class Reference:
    """Rollout of the solver in which every step is the best of several starts, and states shared by all methods.

    Args:
        potential: energies that count.
        timeline: garments and bodies, float64 on the CPU.
        states: states of its frames.
        shared: states, every few frames, on which methods are compared.
    """

    potential: IncrementalPotential
    timeline: Timeline
    states: tuple[State, ...]
    shared: tuple[SharedState, ...]

    @staticmethod
    def of(
        potential: IncrementalPotential,
        timeline: Timeline,
        first: State,
        count: int,
        lead_in: int = 0,
        every: int = SHARED_EVERY,
    ) -> Reference:
        """Roll out; two solves a frame, three more at a shared state where the body moves far.

        Args:
            potential: energies that count.
            timeline: garments and bodies, float64 on the CPU.
            first: state of the first frame.
            count: frames to make.
            lead_in: frames before the first shared state.
            every: frames from one shared state to the next.
        """
        minima, warm_start = StepMinima(potential), BodyMotionWarmStart(potential)
        states, shared = [first], []
        for number in range(1, count):
            step = timeline.step_from(states[-1])
            starts = minima.usual_starts(step)
            minimum: Minimum | None = None
            at_shared = number >= 2 and _is_shared(number, lead_in, every)
            if substep_count(step) == 1:
                minimum = minima.lowest(step, starts)
                after = step.reached(minimum.positions)
            else:
                after, _ = implicit_steps(potential, minima.solver, step, start=warm_start.positions)
                if at_shared:
                    minimum = minima.lowest(step, [after.positions, *starts])
            if minimum is not None and at_shared and math.isfinite(minimum.energy):
                shared.append(SharedState(states[-2], states[-1], minimum.energy))
            states.append(after)
        return Reference(potential, timeline, tuple(states), tuple(shared))

    def excess(self, method: StepMethod, settled: bool = True) -> list[float]:
        """Excess heights [m] after one step of a method from each shared state; negative where the step is below the
        minimum found.

        Args:
            method: simulator that takes the steps.
            settled: whether to include refinement and contact, or only the network's predictions.
        """
        minima, heights = StepMinima(self.potential), []
        for shared in self.shared:
            *_, earlier = predictions(self.timeline.step_from(shared.before), method)
            step, last = self.timeline.step_from(shared.state), earlier.last_move
            try:
                predicted = take(step, method, last) if settled else [*predictions(step, method, last)][-1]
            except DivergedError:
                heights.append(math.nan)
                continue
            x = predicted.state.positions.to(torch.float64)
            finite = bool(torch.isfinite(x).all())
            heights.append(minima.excess(step, x, shared.least) if finite else math.nan)
        return heights


def _is_shared(number: int, lead_in: int, every: int) -> bool:
    return number > lead_in and (number - lead_in - 1) % every == 0
