"""Refinement of a step by the solver: `--refine N` for a network, and the whole method of `--model solver`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace

from torch import Tensor

from pb4u.physics.contact.self_contact import NoSelfContact, SelfContact
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver import Solution, Solver, implicit_steps
from pb4u.physics.time_step import TimeStep, integrate
from pb4u.scene.state import State
from pb4u.simulation.step_start import FreeFlight, StepStart


class Refinement(ABC):
    """Improves a prediction by physics."""

    @abstractmethod
    def refine(self, step: TimeStep, predicted: State) -> State:
        """State of lower incremental potential; its velocity is the displacement over dt.

        Args:
            step: the time step.
            predicted: state at its end that the method predicts.
        """


class NoRefinement(Refinement):
    """Leaves predictions as they are, as far as cloth can go there.

    Args:
        self_contact: keeps cloth from passing through cloth, or does not.
    """

    def __init__(self, self_contact: SelfContact | None = None) -> None:
        self.self_contact = self_contact or NoSelfContact()

    def refine(self, step: TimeStep, predicted: State) -> State:
        return carried(self.self_contact, step, step.state, predicted)


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

    def refine(self, step: TimeStep, predicted: State) -> State:
        solution = self.solver.minimise(self.potential.of(step), predicted.positions, self.iterations)
        if self.watch:
            self.watch(solution)
        return step.reached(solution.positions)


class ImplicitSteps(SolverRefinement):
    """Minimises the incremental potential from a start of its own, whatever was predicted.

    Where the body moves far, the step is cut into several; see `implicit_steps`.

    Args:
        iterations: at most this many an implicit step; None goes to the solver's tolerance.
        potential: the energies.
        watch: called with the last solution of every step.
        start: where each implicit step starts from; free flight by default.
    """

    def __init__(
        self,
        iterations: int | None = None,
        potential: IncrementalPotential | None = None,
        watch: Callable[[Solution], None] | None = None,
        start: StepStart | None = None,
    ) -> None:
        super().__init__(iterations, potential=potential, watch=watch)
        self.start = start or FreeFlight()

    def refine(self, step: TimeStep, predicted: State) -> State:
        state, solution = implicit_steps(self.potential, self.solver, step, self.iterations, self._started)
        if self.watch:
            self.watch(solution)
        return state

    def _started(self, step: TimeStep) -> Tensor:
        return integrate(step, self.start.accelerations(step)).positions


def carried(self_contact: SelfContact, step: TimeStep, before: State, wanted: State) -> State:
    """`wanted` as far as it is reached from `before` without cloth passing through cloth, at the speed it then has.

    Args:
        self_contact: keeps cloth from passing through cloth, or does not.
        step: the time step.
        before: state that crosses nowhere.
        wanted: state at the end of the step.
    """
    positions = self_contact.carried(step.garments, before.positions, wanted.positions)
    if positions is wanted.positions:
        return wanted
    cut = (positions - wanted.positions) / step.dt
    return replace(wanted, positions=positions, velocities=wanted.velocities + cut)
