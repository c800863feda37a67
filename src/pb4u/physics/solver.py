"""The implicit solver: minimises the incremental potential of a step by truncated Newton iterations.

Each iteration solves with the second derivative of the potential by preconditioned conjugate gradients and searches
along the direction. Where cloth is about to buckle the second derivative is not positive: the iteration then uses its
positive part, and follows the buckling direction for as long as the energy falls. The number of iterations does not
depend on the resolution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.physics.conjugate_gradient import LinearSolution, conjugate_gradient
from pb4u.physics.contact_planes import ContactPlanes
from pb4u.physics.divergence import DivergedError
from pb4u.physics.incremental_potential import Energies, StepPotential
from pb4u.physics.overrun import lifted_off_the_body
from pb4u.physics.preconditioner import PatchBasis, TwoLevelPreconditioner
from pb4u.physics.stiffness_matrix import StiffnessPattern
from pb4u.physics.tracked_contact import TrackedContact
from pb4u.scene.packed import PackedGarments

_STANDARD_GRAVITY = 9.81
_SUFFICIENT_DECREASE = 1e-4
_LARGEST_MOVE = 0.2
_BUCKLING_MOVE = 1e-4
# Share of the compressive curvature and extra mass, from safest to exact: an iteration starts one level above the last
# and falls back while the curvature is negative. The extra mass holds back what is about to buckle.
_LEVELS = ((0.0, 0.0), (0.8, 1.0), (1.0, 1.0), (1.0, 0.3), (1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver stopped.

    Args:
        positions: (vertices, 3) [m].
        energies: at `positions`.
        residual: rms over free vertices of the unbalanced acceleration, in units of standard gravity.
        iterations: Newton iterations made.
        inner_iterations: conjugate gradient iterations made, summed.
        converged: whether the residual is below the tolerance.
        contact: the planes of the bodies at t+1 that the result was found with, or None.
    """

    positions: Tensor
    energies: Energies
    residual: float
    iterations: int
    inner_iterations: int
    converged: bool
    contact: ContactPlanes | None


@dataclass(frozen=True)
class Progress:
    """One iteration, for whoever watches: total energy [J] and residual before it."""

    iteration: int
    total: float
    residual: float


@contextmanager
def _one_thread() -> Iterator[None]:
    """Tensors of cloth are small: threads gain little, and wait for one another wherever another process is at work."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class Solver:
    """Minimises step potentials; keeps what depends on the garments alone from one step to the next.

    Computes in float64 on the CPU.

    Args:
        tolerance: rms(M^-1 gradient) / 9.81 at which a step counts as solved.
        max_iterations: Newton iterations after which it stops anyway.
        forcing: relative tolerance of the linear solves.
    """

    def __init__(self, tolerance: float = 1e-3, max_iterations: int = 100, forcing: float = 0.05) -> None:
        self.tolerance, self.max_iterations, self.forcing = tolerance, max_iterations, forcing
        self._garments: PackedGarments | None = None
        self._pattern: StiffnessPattern
        self._basis: PatchBasis

    def refine(self, potential: StepPotential, start: Tensor, iterations: int) -> Solution:
        """At most `iterations` iterations from a prediction `start` (vertices, 3) [m], fewer if solved earlier."""
        return self.minimise(potential, start, iterations)

    def minimise(
        self,
        potential: StepPotential,
        start: Tensor,
        iterations: int | None = None,
        watch: Callable[[Progress], None] | None = None,
    ) -> Solution:
        """Minimise `potential` from `start` (vertices, 3) float64 [m], where pinned vertices stay.

        Args:
            potential: of the step.
            start: any prediction, pinned vertices where they will be.
            iterations: Newton iterations after which it stops; `max_iterations` by default.
            watch: called before every iteration, and at the end.

        Raises DivergedError when `start` or its energy is not finite.
        """
        with _one_thread():
            return self._minimise(potential, start, iterations, watch)

    def _minimise(
        self,
        potential: StepPotential,
        start: Tensor,
        iterations: int | None,
        watch: Callable[[Progress], None] | None,
    ) -> Solution:
        garments = potential.step.garments
        self._prepare(garments)
        limit = self.max_iterations if iterations is None else iterations
        if not bool(torch.isfinite(start).all()):
            raise DivergedError(potential.step.state.frame + 1, "the solver was started where a position is not finite")
        start = lifted_off_the_body(potential, start)
        contact = TrackedContact(potential, start)
        preconditioner = _StepPreconditioner(self._basis)
        x, inner, iteration, level = start, 0, 0, -1
        while True:
            frozen = contact.potential_at(x)
            energies, gradient = frozen.energies_and_gradient(x)
            gradient = torch.where(self._pattern.free[:, None], gradient, 0.0)
            residual, total = self._residual(garments, gradient), float(energies.total)
            if not np.isfinite(residual) or not np.isfinite(total):
                raise DivergedError(potential.step.state.frame + 1, "the solver met positions without finite energy")
            if watch is not None:
                watch(Progress(iteration, total, residual))
            if residual <= self.tolerance or iteration >= limit:
                solved = residual <= self.tolerance
                return Solution(x, energies, residual, iteration, inner, solved, frozen.step.contact_next)
            highest = min(level + 1, len(_LEVELS) - 1)
            newton, level = self._direction(frozen, x, gradient, highest, preconditioner)
            inner += newton.iterations
            moved = self._line_search(frozen, x, gradient, total, newton)
            if moved is None:
                return Solution(x, energies, residual, iteration, inner, False, frozen.step.contact_next)
            x = moved
            iteration += 1

    def _prepare(self, garments: PackedGarments) -> None:
        if self._garments is not garments:
            if garments.dtype != torch.float64 or garments.device.type != "cpu":
                raise ValueError(f"the solver needs garments packed in float64 on the CPU, not {garments.dtype}")
            self._pattern = StiffnessPattern(garments)
            self._basis = PatchBasis(garments, self._pattern.free.numpy())
            self._garments = garments

    def _residual(self, garments: PackedGarments, gradient: Tensor) -> float:
        free = self._pattern.free
        if not bool(free.any()):
            return 0.0
        acceleration = gradient[free] / garments.vertex_masses[free, None]
        return float(acceleration.square().sum(1).mean().sqrt()) / _STANDARD_GRAVITY

    def _direction(
        self, frozen: StepPotential, x: Tensor, gradient: Tensor, level: int, preconditioner: _StepPreconditioner
    ) -> tuple[LinearSolution, int]:
        """The Newton direction, a direction of negative curvature where there is one, and the level that worked."""
        right = -gradient.reshape(-1).numpy()
        positive = self._pattern.assemble(frozen.curvature(x))
        preconditioner.update(self._pattern, positive)
        missing = self._pattern.assemble(frozen.buckling(x)) if level else positive
        negative, spent = None, 0
        own = self._pattern.own_entries
        mass = (frozen.step.garments.vertex_masses / frozen.step.dt**2).numpy()[:, None, None] * np.eye(3)
        while True:
            compression, extra_mass = _LEVELS[level]
            entries = positive + compression * missing
            entries[own] += extra_mass * mass
            solved = conjugate_gradient(self._pattern.product(entries), right, preconditioner, self.forcing, 300)
            spent += solved.iterations
            if solved.negative is None or level == 0:
                preconditioner.last_iterations = solved.iterations
                return LinearSolution(solved.solution, spent, negative), level
            negative = solved.negative
            level -= 1

    def _line_search(
        self, frozen: StepPotential, x: Tensor, gradient: Tensor, total: float, solved: LinearSolution
    ) -> Tensor | None:
        """Where the energy has fallen enough along the direction, then along the buckling one; None if nowhere."""
        direction = torch.from_numpy(solved.solution.reshape(-1, 3))
        largest = float(direction.norm(dim=1).max())
        if largest > _LARGEST_MOVE:
            direction = direction * (_LARGEST_MOVE / largest)
        slope = float((gradient * direction).sum())
        length = 1.0
        for _ in range(20):
            candidate = x + length * direction
            energy = float(frozen.energies(candidate).total)
            if energy <= total + _SUFFICIENT_DECREASE * length * slope:
                break
            length *= 0.5
        else:
            return None
        if solved.negative is None:
            return candidate
        buckling = torch.from_numpy(solved.negative.reshape(-1, 3))
        buckling = buckling * (_BUCKLING_MOVE / float(buckling.norm(dim=1).max()))
        if float((gradient * buckling).sum()) > 0:
            buckling = -buckling
        result, size = candidate, 1.0
        for _ in range(9):
            further = candidate + size * buckling
            lower = float(frozen.energies(further).total)
            if not lower < energy:
                break
            result, energy, size = further, lower, 2.0 * size
        return result


class _StepPreconditioner:
    """The preconditioner of one minimisation: its diagonal is always new, its patches when they have aged."""

    def __init__(self, basis: PatchBasis) -> None:
        self._basis = basis
        self._current: TwoLevelPreconditioner | None = None
        self._age = 0
        self.last_iterations = 0

    def update(self, pattern: StiffnessPattern, entries: np.ndarray) -> None:
        """Follow a new stiffness matrix."""
        diagonal = pattern.diagonal(entries)
        self._age += 1
        if self._current is None:
            self._current = TwoLevelPreconditioner(self._basis, pattern.matrix(entries), diagonal)
            return
        self._current.refresh_diagonal(diagonal)
        if self._age >= 4 and self.last_iterations > 50:
            self._current.refresh_patches(pattern.matrix(entries))
            self._age = 0

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        assert self._current is not None
        return self._current(residual)
