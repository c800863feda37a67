"""The implicit solver: minimises the incremental potential of a step by truncated Newton iterations.

Each iteration solves with the second derivative of the potential by preconditioned conjugate gradients and searches
along the direction. Contact and friction change their force more on the way than that derivative predicts: their
tangents are relinearised at the trial point, and the direction is solved for again; else a step that brings cloth onto
the body would be cut to an eighth. Where cloth is about to buckle the second derivative is not positive: the iteration
then uses its positive part, and follows the buckling direction for as long as the energy falls. The number of
iterations does not depend on the resolution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.environment import STANDARD_GRAVITY
from pb4u.physics.contact.self_contact import ClothPairs
from pb4u.physics.solver.contact_tracking import TrackedContact, moved_off_the_body
from pb4u.physics.solver.linear_solver import LinearSolution, conjugate_gradient
from pb4u.physics.solver.preconditioner import PRECISION, AgeingPreconditioner, PatchBasis
from pb4u.physics.solver.world_sums import each_vertex, factors, norm, squared_ratios, sums
from pb4u.physics.step_potential import Energies, StepPotential
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.terms.stiffness_matrix import Stiffness, StiffnessPattern
from pb4u.physics.time_step import DivergedError
from pb4u.scene.packed import PackedGarments
from pb4u.threads import without_library_threads

_SUFFICIENT_DECREASE = 1e-4
"""Share of the decrease that the slope promises with which a line search is content (Nocedal and Wright, 3.1)."""

_HALVINGS = 20
"""Most halvings of the step length in a line search: where not even a millionth of a Newton step lowers the energy, the
difference is rounding."""

_LARGEST_MOVE = 0.2
"""How far [m] one Newton step may move a vertex: further, the tangent planes of the body mean nothing."""

_BUCKLING_MOVE = 1e-4
"""Length [m] of the first move along a direction of negative curvature; doubled while the energy falls."""

_BUCKLING_DOUBLINGS = 9
"""Most doublings of that move: 2.6 cm, the depth of a fold."""

_BUCKLING_SEARCHED = 4
"""Doublings for which near cloth is searched at first: most vertices buckle by less than these 1.6 mm, which known
pairs serve."""

_LOOKS_AHEAD = 2
"""Most times that the tangents of a Newton step are relinearised; four times gain no iteration over two."""

_MISSED = 0.1
"""Share of the unbalanced force by which the tangents may be wrong there; with 0.3 a step takes more iterations."""

_ROUGHLY = 0.1
"""Relative tolerance of the linear solves that predict where a step leads; with 0.2 a step can take an iteration
more."""

_FINELY = 0.05
"""The same of the linear solve that makes the step."""

# Share of the compressive curvature and extra mass, from most damped to exact: an iteration starts one damping level
# above the last and falls back while the curvature is negative. The extra mass holds back vertices about to buckle.
_DAMPING_LEVELS = ((0.0, 0.0), (0.8, 1.0), (1.0, 1.0), (1.0, 0.3), (1.0, 0.0))

_STILL = 1e-6
"""Residual [standard gravity] of cloth that is in balance but for rounding, where an iteration finds nothing."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a minimisation.

    Args:
        positions: (vertices, 3) [m] at which the solver stopped.
        energies: at `positions` [J].
        struck: (vertices,) bool where contact pushes there.
        residual: rms over the free vertices of a world of the unbalanced acceleration of implicit Euler's inertia, in
            units of standard gravity; of the world where it is largest.
        iterations: number of Newton iterations.
        converged: whether the residual is below the tolerance.
        decrease: energy decrease of the last iteration, the larger of predicted and actual, as the height [m] to which
            it would lift the garments, in the world where it is largest; infinite without an iteration.
    """

    positions: Tensor
    energies: Energies
    struck: Tensor
    residual: float
    iterations: int
    converged: bool
    decrease: float


@dataclass(frozen=True)
class Iteration:
    """Progress of a minimisation before one of its iterations.

    Args:
        number: counted from 0.
        total: energy before the iteration [J].
        residual: before the iteration, as in `Solution`.
    """

    number: int
    total: float
    residual: float


class Solver:
    """Minimises step potentials; keeps data that depend on the garments alone, and the preconditioner, between steps.

    Computes on the CPU, in float64 but for the linear solves, which are in float32.

    Args:
        tolerance: rms(M^-1 gradient) in units of standard gravity at which a step counts as solved.
        max_iterations: Newton iterations after which it stops in any case.
        settled: stop after an iteration whose energy decrease is below this height [m]; 0 for no such limit.
        least: smallest number of iterations unless forces are exactly balanced.
    """

    def __init__(
        self, tolerance: float = 1e-3, max_iterations: int = 100, settled: float = 0.0, least: int = 0
    ) -> None:
        self.tolerance, self.max_iterations, self.settled, self.least = tolerance, max_iterations, settled, least
        self._garments: PackedGarments | None = None
        self._pattern: StiffnessPattern
        self._preconditioner: AgeingPreconditioner
        self._free: Tensor
        self._free_rows: np.ndarray
        self._inertia: np.ndarray
        self._free_counts: list[int]

    def minimise(
        self,
        potential: StepPotential,
        start: Tensor,
        iterations: int | None = None,
        watch: Callable[[Iteration], None] | None = None,
        until: Callable[[Tensor], bool] | None = None,
        begun: Tensor | None = None,
    ) -> Solution:
        """Minimise `potential` from `start`; pinned vertices do not move.

        Args:
            potential: potential of the step.
            start: (vertices, 3) float64 [m] any prediction, pinned vertices where they will be.
            iterations: Newton iterations after which it stops; `max_iterations` by default.
            watch: called before every iteration, and at the end.
            until: called after every iteration with the positions (vertices, 3) [m]; the solver stops when it returns
                true.
            begun: (vertices, 3) [m] that cross nowhere, from which cloth goes to the `start`; by default those where
                the step begins.

        Raises:
            DivergedError: `start` or its energy is not finite.
        """
        self._prepare(potential)
        garments, frame = potential.step.garments, potential.step.state.frame + 1
        limit = self.max_iterations if iterations is None else iterations
        if not bool(torch.isfinite(start).all()):
            raise DivergedError(frame, "the solver was started where a position is not finite")
        with without_library_threads():
            # What was asked for may cross, where contact between cloths has no finite energy to compare.
            lifted = moved_off_the_body(potential.without_cloth(), start)
            potential, start = _reached(potential, lifted, potential.step.state.positions if begun is None else begun)
            cloth = potential.contacts.cloth
            contact = TrackedContact(potential, start)
            x, iteration, damping_level, decrease, ended = start, 0, -1, float("inf"), False
            while True:
                stiffness = potential.begin_stiffness(x, self._pattern) if iteration < limit else None
                frozen = contact.potential_at(x).with_cloth(cloth)
                energies, gradient = frozen.energies_and_gradient(x)
                gradient = torch.where(self._free[:, None], gradient, 0.0)
                residual, total = self._residual(gradient), float(energies.total)
                if not np.isfinite(residual) or not np.isfinite(total):
                    raise DivergedError(frame, "the solver met positions without finite energy")
                if watch is not None:
                    watch(Iteration(iteration, total, residual))
                solved = residual <= self.tolerance and (iteration >= self.least or residual <= _STILL)
                if solved or iteration >= limit or decrease < self.settled or ended:
                    return Solution(x, energies, frozen.struck(x), residual, iteration, solved, decrease)
                highest = min(damping_level + 1, len(_DAMPING_LEVELS) - 1)
                newton, damping_level = self._direction(frozen, x, gradient, stiffness, highest)
                moved = self._line_search(frozen, x, gradient, energies.per_world(garments), newton)
                if moved is None:
                    return Solution(x, energies, frozen.struck(x), residual, iteration, False, decrease)
                x, cloth, energy = moved
                decrease = float((energy / garments.world_weights).max())
                iteration += 1
                ended = until is not None and until(x)

    def _prepare(self, potential: StepPotential) -> None:
        garments, elements = potential.step.garments, potential.elements()
        new = self._garments is not garments
        if new and (garments.dtype != torch.float64 or garments.device.type != "cpu"):
            raise ValueError(f"the solver needs garments packed in float64 on the CPU, not {garments.dtype}")
        if new or not self._pattern.couples(elements):
            self._pattern = StiffnessPattern(garments, elements)
        if new:
            basis = PatchBasis(garments, self._pattern.free)
            self._preconditioner = AgeingPreconditioner(basis, self._pattern.free)
            self._free = torch.from_numpy(self._pattern.free)
            self._free_rows = np.flatnonzero(self._pattern.free)
            worlds = garments.vertex_world[self._free]
            self._free_counts = torch.bincount(worlds, minlength=garments.world_count).tolist()
            self._garments = garments
        step = potential.step
        # A rule of another order than implicit Euler's divides by less than dt^2: the same distance counts alike.
        self._inertia = (garments.vertex_masses * (step.dt / step.inertial_dt) ** 2).numpy()

    def _residual(self, gradient: Tensor) -> float:
        """Residual as in `Solution`, of the world where it is largest."""
        if not len(self._free_rows):
            return 0.0
        squared = squared_ratios(gradient.numpy(), self._inertia, self._free_rows)
        worlds = torch.split(torch.from_numpy(squared), self._free_counts)
        return max(float(world.mean().sqrt()) for world in worlds if len(world)) / STANDARD_GRAVITY

    def _direction(
        self,
        frozen: StepPotential,
        x: Tensor,
        gradient: Tensor,
        begun_stiffness: Callable[[], Stiffness] | None,
        damping_level: int,
    ) -> tuple[LinearSolution, int]:
        """Newton direction, a direction of negative curvature where there is one, and the damping level taken."""
        garments, preconditioner = frozen.step.garments, self._preconditioner
        stiffness = frozen.stiffness(x, self._pattern, begun_stiffness)
        pairs = PairStiffness.summed(frozen.pair_stiffness(x), self._pattern.free)
        preconditioner.update(stiffness.matrix(), pairs)
        mass = (garments.vertex_masses / frozen.step.inertial_dt**2).numpy()
        slope, spent, negative, matrix = gradient.numpy().copy(), 0, None, None

        def solve(forcing: float, start: np.ndarray | None = None) -> np.ndarray:
            nonlocal damping_level, negative, spent, matrix
            while True:
                compression, extra_mass = _DAMPING_LEVELS[damping_level]
                # Tangents change diagonal blocks alone.
                matrix = stiffness.matrix(compression, extra_mass * mass, PRECISION, matrix)
                solved = conjugate_gradient(matrix, pairs, -slope, preconditioner.current, forcing, 300, start)
                spent += solved.iterations
                if solved.negative is None or damping_level == 0:
                    return solved.solution
                negative = solved.negative
                damping_level, matrix = damping_level - 1, None

        tangents = frozen.tangents(x, self._pattern)
        first = solution = solve(_ROUGHLY)
        for _ in range(_LOOKS_AHEAD):
            missed = np.zeros_like(slope)
            for tangent in tangents:
                tangent(solution, stiffness, slope, missed)
            if norm(missed, mass) <= _MISSED * norm(gradient.numpy(), mass):
                break
            solution = solve(_ROUGHLY, solution)
        solution = solve(_FINELY, solution)
        preconditioner.served(spent)
        # The model looks where the step leads; the line search needs what falls from where it begins.
        falls = (sums(gradient * torch.from_numpy(solution), garments) < 0)[garments.vertex_world]
        solution = np.where(falls.numpy()[:, None], solution, first)
        return LinearSolution(solution, spent, negative), damping_level

    def _line_search(
        self, frozen: StepPotential, x: Tensor, gradient: Tensor, energies: Tensor, solved: LinearSolution
    ) -> tuple[Tensor, ClothPairs | None, Tensor] | None:
        """Positions at which the energy is low enough along the direction, then along the buckling one; or None.

        With the pairs of cloth elements that feel each other there, and the energy (worlds,) [J] that was promised or
        found, whichever is more. Each world decides by its own energy: the `energies` (worlds,) [J] are those at `x`
        (vertices, 3) [m]. None where no world accepts a step.
        """
        garments, direction = frozen.step.garments, torch.from_numpy(solved.solution)
        direction = direction * each_vertex(factors(direction, _LARGEST_MOVE, garments).clamp_max(1.0), garments)
        # A Newton step halves the slope by the time that it ends.
        promised = -0.5 * sums(gradient * direction, garments)
        place = _along_newton(_Place(frozen, x, energies), direction, gradient)
        if place is None:
            return None
        if solved.negative is not None:
            place = _along_buckling(place, torch.from_numpy(solved.negative), gradient)
        return place.positions, place.frozen.contacts.cloth, torch.maximum(energies - place.energies, promised)


@dataclass(frozen=True, eq=False)
class _Place:
    """Positions (vertices, 3) [m], their energies (worlds,) [J], and the potential with what was met on the way."""

    frozen: StepPotential
    positions: Tensor
    energies: Tensor


def _along_newton(place: _Place, direction: Tensor, gradient: Tensor) -> _Place | None:
    """Where the energy is low enough on the way along `direction` (vertices, 3) [m]; None where no world moves.

    Takes the `gradient` (vertices, 3) [N] at the place.
    """
    frozen, x, energies = place.frozen, place.positions, place.energies
    garments = frozen.step.garments
    wanted = x + direction
    frozen, free = frozen.reached(x, wanted)
    slope, length = sums(gradient * direction, garments), torch.ones(garments.world_count, dtype=x.dtype)
    if free is not wanted:
        aside = sums(gradient * (free - x), garments)
        falls = aside < 0
        direction = torch.where(each_vertex(falls, garments), free - x, direction)
        slope = torch.where(falls, aside, slope)
        if not bool(falls.all()):
            # Turned aside it no longer lowers the energy of a world: all of that goes as far as it can.
            frozen, length = frozen.as_far_as_free(x, direction)
    for _ in range(_HALVINGS):
        candidate = x + each_vertex(length, garments) * direction
        reached = frozen.energies(candidate).per_world(garments)
        accepted = reached <= energies + _SUFFICIENT_DECREASE * length * slope
        if bool(accepted.all()):
            return _Place(frozen, candidate, reached)
        length = torch.where(accepted, length, 0.5 * length)
    if not bool(accepted.any()):
        return None
    candidate = torch.where(each_vertex(accepted, garments), candidate, x)
    return _Place(frozen, candidate, frozen.energies(candidate).per_world(garments))


def _along_buckling(place: _Place, buckling: Tensor, gradient: Tensor) -> _Place:
    """The farthest of doubled moves along `buckling` (vertices, 3), of any length, to which the energy falls.

    There is no slope to compare with; the `gradient` (vertices, 3) [N] tells which way to begin.
    """
    garments, start = place.frozen.step.garments, place.positions
    buckling = buckling * each_vertex(factors(buckling, _BUCKLING_MOVE, garments), garments)
    rises = sums(gradient * buckling, garments) > 0
    buckling = buckling * each_vertex(torch.where(rises, -1.0, 1.0), garments)
    result, reached, size, falling = start, place.energies, 1.0, torch.ones_like(rises)
    longest = 2.0**_BUCKLING_SEARCHED
    frozen, share = place.frozen.as_far_as_free(start, longest * buckling)
    for _ in range(_BUCKLING_DOUBLINGS):
        if size > longest:
            longest = 2.0 ** (_BUCKLING_DOUBLINGS - 1)
            frozen, share = place.frozen.as_far_as_free(start, longest * buckling)
        falling = falling & (size <= longest * share)
        further = torch.where(each_vertex(falling, garments), start + size * buckling, result)
        lower = frozen.energies(further).per_world(garments)
        falling = falling & (lower < reached)
        if not bool(falling.any()):
            break
        result = torch.where(each_vertex(falling, garments), further, result)
        reached, size = torch.where(falling, lower, reached), 2.0 * size
    return _Place(frozen, result, reached)


def _reached(potential: StepPotential, wanted: Tensor, before: Tensor) -> tuple[StepPotential, Tensor]:
    """The potential for the move from `before` to a start, and the positions (vertices, 3) [m] reached of `wanted`.

    Layers that fall on one another in one step are stopped each at another place, crumpled beyond what a fold would
    ever be. A world starts from where it stands, its pins in place, where that has less energy.
    """
    garments, pinned = potential.step.garments, potential.step.garments.pinned
    moved, start = potential.reached(before, wanted)
    if start is wanted:
        return moved, start
    # Cloth that is near where the step begins was met on the way from there, and need not be searched for.
    standing, held = moved, before
    if bool(pinned.any()):
        standing, held = potential.reached(before, torch.where(pinned[:, None], wanted, before))
    better = standing.energies(held).per_world(garments) < moved.energies(start).per_world(garments)
    if not bool(better.any()):
        return moved, start
    return potential.reached(before, torch.where(each_vertex(better, garments), held, start))
