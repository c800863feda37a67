"""Controls: what a network does around its predictions, without the network."""

from __future__ import annotations

from typing import Any

from pb4u.network.acceleration_model import GraphNetwork
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.simulation.first_frame import FirstFrame, OneLongStep
from pb4u.simulation.network_pass import GradientPass, Network, NoNetwork
from pb4u.simulation.pass_search import search_of
from pb4u.simulation.penetration_response import Contact, NoContact
from pb4u.simulation.refinement import NoRefinement, Refinement, SafeguardedRefinement
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod
from pb4u.simulation.step_start import start_of
from pb4u.simulation.stepwise_simulator import StepwiseSimulator
from pb4u.simulation.timeline import Timeline

GRADIENT_DESCENT, WARM_START = "gradient-descent", "warm-start"


class ControlSimulator(StepwiseSimulator):
    """The start, search and passes of a network, with gradient descent in its place, or with nothing.

    `--model gradient-descent` takes the network's own input feature, Jacobi descent of the potential, for its
    prediction; `--model warm-start` leaves the step where it starts. What a network is better by is its own.

    Args:
        name: one of the two.
        like: network whose start, search and number of passes are taken.
        refine: solver iterations after each step, which is retried where they fail; 0 for none.
        contact: pushes out vertices left inside the body; none by default.
        passes: gradients in a step; None is the number of the network.
        first_frame: makes frame 0; by default one long step of the method's own.
        potential: energies that the solver lowers, and whether cloth feels cloth; the six terms by default.
    """

    def __init__(
        self,
        name: str,
        like: GraphNetwork,
        refine: int = 0,
        contact: Contact | None = None,
        passes: int | None = None,
        first_frame: FirstFrame | None = None,
        potential: IncrementalPotential | None = None,
    ) -> None:
        self.name, self.like, self.refine = name, like, refine
        self.contact, self.first_frame = contact or NoContact(), first_frame or OneLongStep()
        self.potential = potential or IncrementalPotential()
        self.passes = like.passes if passes is None else passes
        self.further = like.further_passes if passes is None else 0

    def settings(self) -> dict[str, Any]:
        passes = self.passes if self.name == GRADIENT_DESCENT else 0
        return {**super().settings(), "refine": self.refine, "passes": passes, "device": "cpu"}

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        network: Network = NoNetwork()
        if self.name == GRADIENT_DESCENT:
            network = GradientPass(timeline.garments, self.passes, self.further)
        refinement: Refinement = NoRefinement(self.potential.self_contact)
        if self.refine:
            refinement = SafeguardedRefinement(self.refine, self.potential, record.count_retried)
        return StepMethod(
            start_of(self.like), network, refinement, self.contact, self.potential.self_contact, search_of(self.like)
        )
