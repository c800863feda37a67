"""`--model solver`: the incremental potential minimised each frame. The reference, and the floor of the metric."""

from __future__ import annotations

from typing import Any

from pb4u.physics.solver import Solution, Solver
from pb4u.simulation.first_frame import FirstFrame, Relaxed
from pb4u.simulation.refinement import SolverRefinement
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.stage import Stage
from pb4u.simulation.step import BallisticPredictor, Contact, NoContact, StepParts
from pb4u.simulation.stepwise_simulator import StepwiseSimulator


class SolverSimulator(StepwiseSimulator):
    """Free flight, then the solver, then contact response.

    Args:
        iterations: a fixed number of solver iterations a step; None goes to the tolerance.
        contact: what answers vertices left inside the body.
    """

    name = "solver"

    def __init__(self, iterations: int | None = None, contact: Contact | None = None) -> None:
        self.iterations = iterations
        self.contact = contact or NoContact()

    def settings(self) -> dict[str, Any]:
        return {"solver_iterations": self.iterations, "device": "cpu"}

    def parts(self, stage: Stage, record: RunRecord) -> StepParts:
        def note(solution: Solution) -> None:
            record.solver_iterations.append(solution.iterations)
            record.unsolved += not solution.converged

        refinement = SolverRefinement(self.iterations, Solver(), watch=note)
        return StepParts(BallisticPredictor(), refinement, self.contact)

    def first_frame(self, parts: StepParts) -> FirstFrame:
        return Relaxed(contact=self.contact)
