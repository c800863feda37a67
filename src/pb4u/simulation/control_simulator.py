"""Controls: what a network does around its predictions, without the network; and the solver's first iterations."""

from __future__ import annotations

from typing import Any

from pb4u.errors import InputError
from pb4u.network.acceleration_model import GraphNetwork
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.simulation.first_frame import FirstFrame, OneLongStep
from pb4u.simulation.network_pass import GradientPass
from pb4u.simulation.pass_search import search_of
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod
from pb4u.simulation.step_start import BodyMotionWarmStart, start_of
from pb4u.simulation.stepwise_simulator import StepwiseSimulator
from pb4u.simulation.timeline import Timeline

GRADIENT_DESCENT, WARM_START, QUICK_SOLVER = "gradient-descent", "warm-start", "quick-solver"


class ControlSimulator(StepwiseSimulator):
    """The start, search and passes of a network, with gradient descent in its place, or with nothing.

    `--model gradient-descent` takes the network's own input feature, Jacobi descent of the potential, for its
    prediction; `--model warm-start` leaves the step where it starts. What a network is better by is its own.
    `--model quick-solver` has no network beside it: a few solver iterations from where the body carries the garment.

    Args:
        name: one of the three.
        like: network whose start, search and number of passes are taken; None for the quick solver.
        refine: solver iterations after each step, which is retried where they fail; 0 for none.
        contact: pushes out vertices left inside the body; none by default.
        passes: gradients in a step; None is the number of the network.
        first_frame: makes frame 0; by default one long step of the method's own.
        potential: energies that the solver lowers, and whether cloth feels cloth; the six terms by default.

    Raises:
        InputError: the quick solver without an iteration.
    """

    def __init__(
        self,
        name: str,
        like: GraphNetwork | None = None,
        refine: int = 0,
        contact: ContactResponse | None = None,
        passes: int | None = None,
        first_frame: FirstFrame | None = None,
        potential: IncrementalPotential | None = None,
    ) -> None:
        if like is None and refine < 1:
            raise InputError(f"The quick solver is nothing but iterations: it takes 1 or more a step, not {refine}.")
        self.name, self.like, self.refine = name, like, refine
        self.contact, self.first_frame = contact, first_frame or OneLongStep()
        self.potential, self.passes = potential or IncrementalPotential(), passes

    def settings(self) -> dict[str, Any]:
        made = {**super().settings(), "refine": self.refine, "device": "cpu"}
        return made if self.like is None else {**made, "passes": self._passes(self.like)[0]}

    def _passes(self, like: GraphNetwork) -> tuple[int, int]:
        if self.name != GRADIENT_DESCENT:
            return 0, 0
        return (like.passes, like.further_passes) if self.passes is None else (self.passes, 0)

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        parts: dict[str, Any] = {"contact": self.contact, "self_contact": self.potential.self_contact}
        parts["refinement"] = self.refinement(record)
        if self.like is None:
            return StepMethod(BodyMotionWarmStart(), **parts)
        passes, further = self._passes(self.like)
        network = GradientPass(timeline.garments, passes, further) if passes else None
        return StepMethod(start_of(self.like), network, search=search_of(self.like), **parts)
