"""Simulators that go step by step: the solver, its first iterations, and networks with or without these."""

from __future__ import annotations

import copy
import time
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import torch
from torch import Tensor

from pb4u.collision.capacities import Capacities
from pb4u.errors import InputError, InputWarning
from pb4u.network.acceleration_model import require_propagation_steps
from pb4u.network.graph.features import ADVANCE
from pb4u.network.update_scaling import scaling_name
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.integrator import IMPLICIT_EULER, Integrator
from pb4u.physics.solver.implicit_steps import free_flight
from pb4u.physics.solver.newton_solver import Solution
from pb4u.physics.terms.air import Air
from pb4u.physics.time_step import DivergedError, TimeStep, require_finite
from pb4u.scene.colliders import ColliderPose
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import Checkpoint
from pb4u.simulation.device_steps import bytes_a_vertex, require_memory, states_after
from pb4u.simulation.first_frame import AsPlaced, FirstFrame, OneLongStep, Settled
from pb4u.simulation.network_pass import NetworkPass, StepFeatures
from pb4u.simulation.pass_search import search_of
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.refinement import ImplicitSteps, SafeguardedRefinement
from pb4u.simulation.simulator import RunRecord, Simulator
from pb4u.simulation.step import StepMethod, Taken, take
from pb4u.simulation.step_start import BodyMotionWarmStart, start_of
from pb4u.simulation.timeline import Timeline
from pb4u.simulation.touch import Touch
from pb4u.threads import prefetch


@dataclass(eq=False, kw_only=True)
class StepwiseSimulator(Simulator):
    """Simulates a scene step by step.

    Args:
        refine: solver iterations after each step at most, which is retried where edges go through a limb after them, or
            the cloth is stretched beyond measure and still falling; 0 for none.
        contact: pushes out vertices left inside the body; none by default.
        first_frame: makes frame 0; by default one long step of the method's own.
        potential: the energies, and whether cloth feels cloth. First frame, start of a step, gradient feature and
            search of a network, and the solver all descend it. The six terms by default.
        integrator: of the steps.
    """

    refine: int = 0
    contact: ContactResponse | None = None
    first_frame: FirstFrame = field(default_factory=OneLongStep)
    potential: IncrementalPotential = field(default_factory=IncrementalPotential)
    integrator: Integrator = IMPLICIT_EULER

    def settings(self) -> dict[str, Any]:
        return {
            "contact": self.contact is not None,
            "self_contact": self.potential.self_contact is not None,
            "time_integration": self.integrator.name,
            "friction_law": self.potential.friction_law,
            "air": Air.name in self.potential.names,
        }

    @abstractmethod
    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        """Method that takes the steps of a run.

        Args:
            timeline: garments and bodies.
            record: receives the cost of the run.
        """

    def refinement(self, record: RunRecord) -> SafeguardedRefinement | None:
        """Refinement of predictions by the solver; None for none.

        Args:
            record: counts the steps that are retried.
        """
        return SafeguardedRefinement(self.potential, self.refine, record.count_retried) if self.refine else None

    def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
        timeline = self.timeline(scene)
        method = self.method(timeline, record)

        def written(result: tuple[State, ColliderPose]) -> State:
            state, pose = result
            if state.frame < scene.lead_in or method.contact is None:
                return state
            # As it is written: moved off the skin, as far as cloth can go there.
            return method.contact.present(timeline.garments, state, pose, method.self_contact)

        # A frame is made ready for writing while the step from it is taken.
        yield from prefetch(written, self._states(scene, timeline, method, record))

    def _states(
        self, scene: Scene, timeline: Timeline, method: StepMethod, record: RunRecord
    ) -> Iterator[tuple[State, ColliderPose]]:
        """The states of a run with the bodies of each frame; where a state is not finite, it adds a note and ends."""
        count = 0
        try:
            states = self._moved(timeline, method, scene)
            for state in islice(states, scene.total_frames):
                yield require_finite(state), timeline.pose(state.frame).apart()
                count += 1
        except DivergedError:
            record.failed_at = count - scene.lead_in

    def _moved(self, timeline: Timeline, method: StepMethod, scene: Scene) -> Iterator[State]:
        for taken in self.first_frame.states(timeline, method):
            yield taken.state
        while taken.state.frame + 1 < scene.total_frames:
            taken = self.after(taken, timeline, method, scene)
            yield taken.state

    def timeline(self, *scenes: Scene) -> Timeline:
        """Frames of scenes, each in a world of its own, on the device that takes their steps.

        Folds of the bodies are open where something answers contact with them.

        Args:
            scenes: what is simulated.

        Raises:
            InputError: the device has no room for them.
        """
        cloth = self.potential.self_contact
        touched = self.contact is not None or (cloth is not None and cloth.feels_bodies)
        return Timeline.of_worlds(scenes, opens_folds=touched, integrator=self.integrator)

    @property
    def on_card(self) -> bool:
        """Whether all of a step is computed on an accelerator."""
        return False

    def after(
        self, taken: Taken, timeline: Timeline, method: StepMethod, scene: Scene, touch: Touch | None = None
    ) -> Taken:
        """The state after that of `taken`.

        Args:
            taken: the frame before.
            timeline: garments and bodies.
            method: takes the step.
            scene: says which frames lead into the motion.
            touch: what is done to the cloth from outside, or None.
        """
        if method.refinement is not None and taken.state.frame + 1 < scene.led_frames:
            # The solver alone leads to the same drape in half of the time; the network takes over with the first frame.
            method = replace(method, network=None)
        step = timeline.step_from(taken.state)
        return take(step if touch is None else touch.on(step), method, taken.last_move)


@dataclass(eq=False)
class SolverSimulator(StepwiseSimulator):
    """Solver of every frame (`--model solver`): minimises the incremental potential, then answers contact.

    The reference, and the floor that energies are measured from.

    Args:
        iterations: a fixed number of solver iterations an implicit step; None goes to the tolerance.
        first_frame: makes frame 0; settled by default.
        start: gives the positions (vertices, 3) [m] that a step starts from.
    """

    name = "solver"
    iterations: int | None = None
    first_frame: FirstFrame = field(default_factory=Settled, kw_only=True)
    start: Callable[[TimeStep], Tensor] = free_flight

    def settings(self) -> dict[str, Any]:
        return {**super().settings(), "solver_iterations": self.iterations, "device": "cpu"}

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        def note(solution: Solution) -> None:
            record.solver_iterations.append(solution.iterations)
            record.unsolved += not solution.converged

        refinement = ImplicitSteps(
            self.potential, self.iterations, watch=note, start=self.start, retried=record.count_retried
        )
        return StepMethod(refinement=refinement, contact=self.contact, potential=self.potential)


@dataclass(eq=False)
class QuickSolver(StepwiseSimulator):
    """A few solver iterations from where the body carries the garment (`--model quick-solver`): `refine` of them.

    Raises:
        InputError: no iteration.
    """

    name = "quick-solver"

    def __post_init__(self) -> None:
        if self.refine < 1:
            raise InputError(f"The quick solver needs 1 iteration a step or more, not {self.refine}.")

    def settings(self) -> dict[str, Any]:
        return {**super().settings(), "refine": self.refine, "device": "cpu"}

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        start = BodyMotionWarmStart(self.potential)
        return StepMethod(start, None, self.refinement(record), self.contact, self.potential)


class NetworkSimulator(StepwiseSimulator):
    """A trained network, with the solver and contact response in the loop where asked for.

    The solver corrects the faults that a checkpoint warns of at resolutions not trained on; with it there are no
    warnings.

    Args:
        checkpoint: the trained model; it is never changed or moved, but copied to another device.
        propagation_steps: override of K; None follows the paper's rule.
        device: device that the network computes on.
        passes: evaluations of the network in a step; None is its own number.
        precision: data type of the network's products.
        scaling: rule for the factors on its predictions, by name; None is that of its training.
        common: arguments of every `StepwiseSimulator`.

    Raises:
        InputError: less than 1 pass, or more than 1 of a network that does not distinguish passes, a number of
            propagation steps out of range, and a scaling of a network that has none.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        propagation_steps: int | None = None,
        device: torch.device | str = "cpu",
        passes: int | None = None,
        precision: torch.dtype = torch.float32,
        scaling: str | None = None,
        **common: Any,
    ) -> None:
        super().__init__(**common)
        self.name, self.fps, self.override = checkpoint.name, 1.0 / checkpoint.record.dt, propagation_steps
        self.device = torch.device(device)
        network = checkpoint.model.network
        if propagation_steps is not None and network.propagates:
            require_propagation_steps(propagation_steps)
        self.passes = network.configuration.passes if passes is None else passes
        # Who names a number of passes gets that number.
        self.further = network.configuration.further_passes if passes is None else 0
        if self.passes < 1:
            raise InputError(f"A network needs at least 1 pass a step, not {self.passes}.")
        if self.passes > 1 and ADVANCE not in network.configuration.layout.extra:
            raise InputError(
                f"The network {checkpoint.name} was made for one pass a step; leave out --passes, or give 1."
            )
        model = checkpoint.model
        if next(model.parameters()).device != self.device:
            model = copy.deepcopy(model).to(self.device)
        self.precision, self.scaling = precision, checkpoint.scaling_in_use(scaling)
        self.checkpoint = replace(checkpoint, model=model.for_inference(precision))

    def settings(self) -> dict[str, Any]:
        return {
            **super().settings(),
            "refine": self.refine,
            "passes": self.passes,
            "device": str(self.device),
            "precision": str(self.precision).removeprefix("torch."),
            "weights_licence": self.checkpoint.licence,
            **({} if self.scaling is None else {"scaling": scaling_name(self.scaling.used)}),
        }

    def timeline(self, *scenes: Scene) -> Timeline:
        host = super().timeline(*scenes)
        if not self.on_card:
            return host
        require_memory("the scene", *self._vertices_and_bytes(scenes), self.device)
        return host.to(self.device, Capacities())

    def _vertices_and_bytes(self, scenes: Sequence[Scene]) -> tuple[int, int]:
        """Vertices of all garments, those of smaller worlds filled up, and the bytes that a card takes for each."""
        vertices = max(sum(len(dressed.garment.vertices) for dressed in scene.garments) for scene in scenes)
        faces = max(sum(len(body.faces) for body in scene.colliders) for scene in scenes)
        return len(scenes) * vertices, bytes_a_vertex(self.checkpoint.model.network, faces)

    def packs(self, scenes: Sequence[Scene]) -> list[list[int]]:
        """Numbers of the scenes to simulate together: as many as take up to half of the memory that the card has left.

        Args:
            scenes: for a simulator that is `on_card`.
        """

        def shared(scene: Scene) -> tuple[object, ...]:
            return scene.fps, scene.environment, bool(scene.colliders)

        free, _ = torch.cuda.mem_get_info(self.device)
        packs: list[list[int]] = []
        for number, scene in enumerate(scenes):
            grown = [*packs[-1], number] if packs else [number]
            vertices, bytes_each = self._vertices_and_bytes([scenes[k] for k in grown])
            if packs and shared(scene) == shared(scenes[grown[0]]) and 2 * vertices * bytes_each <= free:
                packs[-1] = grown
            else:
                packs.append([number])
        return packs

    def together(self, scenes: Sequence[Scene]) -> list[tuple[list[State], RunRecord]]:
        """States of each scene, on the processor, and what they cost; each ends where it is not finite.

        Args:
            scenes: one of `packs`.

        Raises:
            DivergedError: one of them has no finite first frame.
            InputError: the card has no room for them.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            timeline = self.timeline(*scenes)
            method = self.method(timeline, RunRecord())
        results: list[tuple[list[State], RunRecord]] = [([], RunRecord()) for _ in scenes]
        going = set(range(len(scenes)))
        began = time.perf_counter()
        for state in self._moved(timeline, method, max(scenes, key=lambda scene: scene.total_frames)):
            x, v, seconds = state.positions.cpu(), state.velocities.cpu(), time.perf_counter() - began
            share = seconds / len(going)
            for world in sorted(going):
                (states, record), rows = results[world], timeline.garments.world_vertices[world]
                try:
                    states.append(require_finite(State(x[rows], v[rows], state.frame)))
                    record.step_seconds.append(share)
                except DivergedError:
                    record.failed_at = state.frame - scenes[world].lead_in
                if record.failed_at is not None or len(states) == scenes[world].total_frames:
                    going.remove(world)
            if not going:
                break
            began = time.perf_counter()
        return results

    def warn_of(self, scene: Scene) -> None:
        """Warn of each garment that the network was not trained for.

        Args:
            scene: what is simulated.
        """
        for dressed in scene.garments:
            ruled = self.checkpoint.model.network.propagation_steps(dressed.garment.mean_edge_length)
            self.checkpoint.warn_of(dressed.garment, self.override if ruled and self.override else ruled)

    def _moved(self, timeline: Timeline, method: StepMethod, scene: Scene) -> Iterator[State]:
        if not self.on_card:
            yield from super()._moved(timeline, method, scene)
            return
        capacities = timeline.colliders.capacities
        assert capacities is not None
        first = self.first_frame.start(timeline, method)
        while capacities.grow(*capacities.taken()):
            # Searches were short of room.
            first = self.first_frame.start(timeline, method)
        yield first.state
        yield from states_after(timeline, method, first, scene.total_frames)

    @property
    def on_card(self) -> bool:
        """Whether all of a step is computed on an accelerator: nothing follows the network's passes."""
        return (
            self.device.type != "cpu"
            and not self.refine
            and self.contact is None
            and self.potential.self_contact is None
            and self.integrator is IMPLICIT_EULER
            and isinstance(self.first_frame, (OneLongStep, AsPlaced))
        )

    def propagation_steps(self, scene: Scene) -> int | None:
        """Number K of propagation steps of the finest garment, which takes the most.

        Args:
            scene: the scene.
        """
        network = self.checkpoint.model.network
        if not network.propagates:
            return None
        if self.override is not None:
            return self.override
        return max(network.propagation_steps(dressed.garment.mean_edge_length) for dressed in scene.garments)

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        worlds = timeline.garments.worlds
        garments: PackedGarments = pack(timeline.garments.garments, torch.float32, self.device, worlds)
        model = self.checkpoint.model
        prepared = (model if self.refine else self.checkpoint).prepare(garments, self.override)
        if self.scaling is not None:
            prepared = replace(prepared, scale=self.scaling.of(garments, prepared.builder.static))
        features = StepFeatures(prepared, self.potential)
        return StepMethod(
            # A network alone has learnt starts on the skin.
            start_of(model.network, self.potential if self.refine else self.potential.without_self_contact()),
            NetworkPass(model, prepared, features, self.passes, further=self.further),
            self.refinement(record),
            self.contact,
            self.potential,
            search_of(model.network, self.potential),
        )
