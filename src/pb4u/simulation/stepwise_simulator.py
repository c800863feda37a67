"""Simulators that go step by step: the solver, and networks with or without it in the loop."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator

from pb4u.physics.divergence import DivergedError, require_finite
from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.simulation.first_frame import FirstFrame
from pb4u.simulation.simulator import RunRecord, Simulator
from pb4u.simulation.stage import Stage
from pb4u.simulation.step import Situation, StepParts, step


class StepwiseSimulator(Simulator):
    """Rolls a scene out by repeated steps."""

    @abstractmethod
    def parts(self, stage: Stage, record: RunRecord) -> StepParts:
        """What the steps of this scene are made of."""

    @abstractmethod
    def first_frame(self, parts: StepParts) -> FirstFrame:
        """How frame 0 is made."""

    def rollout(self, scene: Scene, record: RunRecord) -> Iterator[State]:
        stage = Stage(scene)
        parts = self.parts(stage, record)
        made = 0
        try:
            state = require_finite(self.first_frame(parts).start(stage))
            yield presented(stage, state, parts)
            for frame in range(scene.total_frames - 1):
                made = frame + 1
                state = require_finite(step(situation_at(stage, state, frame), parts))
                yield presented(stage, state, parts)
        except DivergedError:
            record.failed_at = made - scene.lead_in


def presented(stage: Stage, state: State, parts: StepParts) -> State:
    """The state as it is written; frames of the lead-in are not, and are left as they are."""
    if state.frame < stage.scene.lead_in:
        return state
    return parts.contact.present(state, stage.garments, stage.held_collider(state.frame))


def situation_at(stage: Stage, state: State, frame: int) -> Situation:
    """What is known before the step from `frame` to the next."""
    after = stage.skinned(frame + 1)
    carried = after - stage.skinned(frame)
    return Situation(stage.garments, state, stage.collider(frame), after, carried, stage.dt, stage.gravity)
