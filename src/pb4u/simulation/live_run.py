"""A run that is taken step by step: touched, dressed in another fabric and taken back between two steps."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pb4u.garment.material import Material
from pb4u.physics.time_step import require_finite
from pb4u.scene.packed import PackedGarments
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Frame, TrajectoryHeader
from pb4u.simulation.simulator import RunRecord, written_frame
from pb4u.simulation.step import Taken
from pb4u.simulation.stepwise_simulator import StepwiseSimulator
from pb4u.simulation.touch import Touch


class LiveRun:
    """A run of a scene whose next frame is computed when it is asked for. One thread alone works with it.

    Untouched, its frames are those of `Simulator.rollout`, to the bit. After it was taken back they are within the
    solver's tolerance, since the solver keeps its preconditioner from step to step.

    Args:
        simulator: takes the steps, on a processor.
        scene: garments and bodies.
        record: receives the cost of the steps.
    """

    def __init__(self, simulator: StepwiseSimulator, scene: Scene, record: RunRecord) -> None:
        self._simulator, self.record, self.scene = simulator, record, scene
        self._timeline = simulator.timeline(scene)
        self._method = simulator.method(self._timeline, record)
        self._begun: Iterator[Taken] = simulator.first_frame.states(self._timeline, self._method)
        # The last frame, and all written ones: what a step is taken from, history of the integrator included.
        self._last: Taken | None = None
        self._kept: list[Taken] = []

    @property
    def packed(self) -> PackedGarments:
        """The garments as steps read them."""
        return self._timeline.garments

    @property
    def feels(self) -> bool:
        """Whether cloth feels a hand and wind: where the solver takes part."""
        return self._method.refinement is not None

    def body(self, frame: int) -> np.ndarray:
        """Body vertices (vertices, 3) [m] at a frame.

        Args:
            frame: number of the frame, lead-in included.
        """
        return self._timeline.body(frame).numpy()

    @property
    def header(self) -> TrajectoryHeader:
        """Header of the frames, with the fabrics as they are now."""
        return self._simulator.header(self.scene)

    @property
    def frame(self) -> int:
        """Number of the last frame, lead-in included; -1 before the first."""
        return -1 if self._last is None else self._last.state.frame

    @property
    def written_count(self) -> int:
        """Number of frames after the lead-in."""
        return len(self._kept)

    def advance(self, touch: Touch | None = None) -> Frame | None:
        """The next frame; None for one of the lead-in. The body stays as it is after the last frame of the scene.

        Args:
            touch: what is done over the step.

        Raises:
            DivergedError: the state is not finite; the frame before is still the last.
        """
        began = time.perf_counter()
        taken = next(self._begun, None)
        if taken is None:
            assert self._last is not None, "a rule of first frames makes one at least"
            taken = self._simulator.after(self._last, self._timeline, self._method, self.scene, touch)
        require_finite(taken.state)
        self._last = taken
        state, cloth = taken.state, self._method.contact
        if state.frame >= self.scene.lead_in:
            self._kept.append(taken)
            if cloth is not None:
                # As it is shown: moved off the skin, as far as cloth can go there.
                pose = self._timeline.pose(state.frame).apart()
                state = cloth.present(self._timeline.garments, state, pose, self._method.self_contact)
        self.record.step_seconds.append(time.perf_counter() - began)
        return written_frame(self.scene, state) if state.frame >= self.scene.lead_in else None

    def go_back(self, number: int) -> None:
        """Go on from an earlier frame: its positions, its velocities and what the integrator knows of the steps before.

        Args:
            number: of the frame, counted from the first after the lead-in.
        """
        del self._kept[number + 1 :]
        self._last = self._kept[number]
        self._begun = iter(())

    def dress(self, number: int, material: Material) -> None:
        """Make a garment of another fabric from the next step on; it stays where it is and as fast as it is.

        Args:
            number: of the garment, from 0 for the innermost.
            material: of all its faces.
        """
        garments = list(self.scene.garments)
        garments[number] = replace(garments[number], garment=garments[number].garment.with_material(material))
        self.scene = replace(self.scene, garments=tuple(garments))
        self._timeline = self._timeline.with_garments([dressed.garment for dressed in garments])
        self._method = self._simulator.method(self._timeline, self.record)
