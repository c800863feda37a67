"""The solver inside a step: the whole method of `--model solver`, and what `--refine N` adds to a network."""

from __future__ import annotations

from collections.abc import Callable

from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver import Solution, Solver
from pb4u.scene.state import State
from pb4u.simulation.step import Refinement, Situation, displaced


class SolverRefinement(Refinement):
    """Minimises the incremental potential from the prediction.

    Args:
        iterations: at most this many a step; None goes to the solver's tolerance.
        solver: computes in float64 on the CPU.
        potential: the energies.
        watch: called with every solution.
    """

    def __init__(
        self,
        iterations: int | None = None,
        solver: Solver | None = None,
        potential: IncrementalPotential | None = None,
        watch: Callable[[Solution], None] | None = None,
    ) -> None:
        self.iterations = iterations
        self.solver = solver or Solver()
        self.potential = potential or IncrementalPotential()
        self.watch = watch

    def refine(self, predicted: State, situation: Situation) -> State:
        step_potential = self.potential.prepare(
            situation.garments,
            situation.state,
            situation.collider,
            situation.dt,
            situation.gravity,
            situation.potential.step.contact_now,
        )
        solution = self.solver.minimise(step_potential, predicted.positions, self.iterations)
        if self.watch:
            self.watch(solution)
        return displaced(situation.state, solution.positions, situation.dt)
