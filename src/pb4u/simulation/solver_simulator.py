"""`--model solver`: the incremental potential minimised each frame. The reference, and the floor of the metric."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver import Solution, Solver
from pb4u.physics.substeps import advance
from pb4u.scene.state import State
from pb4u.simulation.first_frame import FirstFrame, Relaxed
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.stage import Stage
from pb4u.simulation.step import Contact, NoContact, Predictor, Situation, StepParts
from pb4u.simulation.stepwise_simulator import StepwiseSimulator


class SolverPredictor(Predictor):
    """From free flight to the minimum of the potential, in as many implicit steps as the body's motion needs.

    Args:
        iterations: at most this many in each implicit step; None goes to the tolerance.
        watch: called with the solution of each frame.
    """

    def __init__(self, iterations: int | None = None, watch: Callable[[Solution], None] | None = None) -> None:
        self.iterations, self.watch = iterations, watch
        self.solver, self.potential = Solver(), IncrementalPotential()

    def predict(self, situation: Situation) -> State:
        state, solution = advance(
            self.potential,
            self.solver,
            situation.garments,
            situation.state,
            situation.collider,
            situation.dt,
            situation.gravity,
            situation.pin_positions,
            self.iterations,
        )
        if self.watch:
            self.watch(solution)
        return state


class SolverSimulator(StepwiseSimulator):
    """The solver from free flight, then contact response.

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

        return StepParts(SolverPredictor(self.iterations, note), contact=self.contact)

    def first_frame(self, parts: StepParts) -> FirstFrame:
        return Relaxed(contact=self.contact)
