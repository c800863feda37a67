"""Refinement of a step by the solver: `--refine N` for a network, and the whole method of `--model solver`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.near_elements import beside
from pb4u.geometry.principal_stretch import face_strains
from pb4u.physics.contact.obstacle import Obstacle
from pb4u.physics.contact.self_contact import CollisionFree
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.implicit_steps import free_flight, implicit_steps, in_parts, substep_count
from pb4u.physics.solver.newton_solver import Solution, Solver
from pb4u.physics.terms.collision import STIFF_CONTACT_WEIGHT, Collision
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.pierced_edges import newly_pierced
from pb4u.simulation.step_start import BodyMotionWarmStart

_BALANCED = 20.0
"""Residual [standard gravity] above which a refined step may be retried.

Iterations leave 0.5 to 13 of garments that walk, jump, squat or run; of steps in which a running body caught a dress
or a cardigan, 65 to 300.
"""

_NEAR_BALANCE = 1.0
"""Residual [standard gravity] at which a refined step is left after its first iteration: walks and dances get there in
two or three iterations, and five leave no more than half a percent less energy."""

_SETTLED = 5e-4
"""Energy decrease of an iteration, as the height [m] to which it would lift the garment, below which it is the last.

The iterations after it would lower the energy by a third of that: half a percent of a walking T-shirt's elastic one.
"""

_STILL_FALLING = 1e-3
"""Energy decrease of the last iteration, as the height [m] to which it would lift the garment, from which on such a
step may be retried (docs/design/quick_solver.md).

Where a limb has caught a dress or a cardigan it is 1.2 mm to half a metre. Where a tight shirt is strained in every
step, at a residual of 20 to 130, it is 0.2 to 0.9 mm, and the retried step has 0.1 percent less energy.
"""

_FAILED_STRAIN = 0.6
"""Strain of a face from which on a step has failed: contact between layers leaves such residuals too, with nothing
caught."""

_ROUGH_TOLERANCE = 1.0
"""Residual [standard gravity] to which a retry solves the step: no more than steps refined as usual may have."""

_MOST_RETRY_ITERATIONS = 60
"""Iterations at which a retry ends, sooner on fine meshes; a running dress needed 8 to 31."""

_LEFT_INSIDE = 1e-3
"""Depth [m] from which on a vertex that the response leaves inside the body is pushed out by stiff contact."""

_MOST_PRESSING = 5
"""Iterations at which that push ends, and from one count of strained faces to the next in a retry."""

_PRESSING_WORK = 150_000
"""Iterations times triangles of a retry at most, besides its first few: sixty of 2,500 triangles take a second, and
sixty of 38,000 would take forty."""

_EDGES_IN_A_PART = 8.0
"""Edge lengths that the body under the cloth may move in one part of a retry. A jump of 38,000 triangles, where it
moves by twenty to forty-five, was strained by 9.3 in one part, and is by 1.4. At 2,500 triangles a running leg moves by
seven."""

_RINGS = 6
"""Edges around strained or turned-aside cloth up to which a retry moves cloth first: with ten, the patches of a coarse
garment are half of it."""

_SMOOTHED = 0.5
"""Share of the strained faces that some iterations may leave for more to follow: where they leave more, fifty more
leave some too."""

_LEFT = 2e-3
"""Strained faces and vertices newly let through that smoothing may leave, as a share of all faces. A solve of the whole
step, which takes as long as ten steps, leaves fewer of so few in one case of three, and more in another; a running
dress of 38,000 triangles needs it, and trousers of 11,000, where a shin would come through a thousand vertices."""

_TURNED_ASIDE, _OF_AN_EDGE = 1e-2, 0.37
"""How far bodies may turn strained cloth aside before the energies count their faces and edges: a length [m], and on
meshes of more than 2,500 triangles a share of the mean edge length. In a run that is every step, and takes as long."""


class SolverRefinement:
    """Minimises the incremental potential from the prediction.

    Args:
        potential: the energies.
        iterations: at most this many a step; None goes to the solver's tolerance.
        solver: computes in float64 on the CPU.
        retried: called with the solution of every retry of a step.
    """

    def __init__(
        self,
        potential: IncrementalPotential,
        iterations: int | None = None,
        solver: Solver | None = None,
        retried: Callable[[Solution], None] | None = None,
    ) -> None:
        self.potential, self.iterations = potential, iterations
        self.solver = solver or Solver()
        self.retried = retried
        self._pressing = Solver(_NEAR_BALANCE, settled=_SETTLED)
        # Of the weight of a garment, a part has little energy to lose.
        self._local = Solver(_NEAR_BALANCE)
        self._warm_start = BodyMotionWarmStart(potential)

    def refine(self, step: TimeStep, predicted: State) -> State:
        """State of lower incremental potential; its velocity is that of the move there.

        Args:
            step: the time step.
            predicted: state at its end that the method predicts.
        """
        solution = self.solver.minimise(self.potential.of(step), predicted.positions, self.iterations)
        return step.reached(solution.positions, solution.struck)

    def respond_with_cloth(self, step: TimeStep, state: State, contact: ContactResponse) -> State:
        """`state` with what is inside the body pushed out of it, as far as that succeeds; its velocity stays.

        Args:
            step: the time step.
            state: at its end, after the response of `contact`.
            contact: tells how deep a vertex is inside.
        """
        depth = contact.depth(step, state.positions)
        if depth <= _LEFT_INSIDE:
            return state
        firm = self.potential.with_term(Collision(weight=STIFF_CONTACT_WEIGHT))
        pressed = self._pressing.minimise(firm.of(step), state.positions, _MOST_PRESSING).positions
        return replace(state, positions=pressed) if contact.depth(step, pressed) < depth else state

    def pressed_past_bodies(self, step: TimeStep, state: State) -> State:
        """`state` moved past the bodies; what that strains is smoothed with their faces.

        Mostly a few iterations of the cloth around it leave no more faces strained than before: far from it nothing
        has changed. They end where fewer than half of those go. Where many are left, or bodies were let through much
        of the cloth, all of the step is solved from the body-motion warm start, in parts where the body moves by many
        edges. Of what limbs pinch some stay strained in every step, however it is solved. The state with the fewest
        faces strained and vertices let through is kept.

        Args:
            step: the time step.
            state: at its end.
        """
        contact = self.potential.self_contact
        reached = past_bodies(contact, step, state, apart=True)
        felt = contact is not None and contact.feels_bodies
        aside = (reached.positions - state.positions).norm(dim=1)
        least = (_OF_AN_EDGE * step.garments.vertex_edge_lengths).clamp_max(_TURNED_ASIDE)
        if not felt or not bool((aside > least).any()):
            return reached
        garments, are_failed = step.garments, _are_failed(step, reached.positions)
        failed, pinched = int(are_failed.sum()), _failed_faces(step, state.positions)
        before, few = _passed(step), _LEFT * len(garments.faces)
        began = pinched + int(before.sum())

        def added(end: State) -> int:
            return _failed_faces(step, end.positions) + int(_passed(step, end.positions).sum()) - began

        ends = [(added(reached), reached)]
        if failed <= pinched and ends[0][0] <= few:
            return reached
        caught = _passed(step, reached.positions) & ~before
        caught[garments.faces[are_failed].reshape(-1)] = True
        pressed, around = self.potential.pressed_by_bodies(), step.around(_near(garments, caught | (aside > least)))
        smooth, most = _Smoothing(step, allowed=pinched, failed=failed, share=_SMOOTHED), _most_iterations(around)
        smoothed = self._local.minimise(
            pressed.of(around), reached.positions, most, until=smooth.ended, begun=reached.positions
        )
        solution, turned = smoothed, step.turned_aside(reached, smoothed.positions)
        ends.append((added(turned), turned))

        def solve(part: TimeStep) -> Solution:
            start = past_bodies(contact, part, part.reached(self._warm_start.positions(part)), apart=False)
            smooth = _Smoothing(part, allowed=pinched)
            return self._pressing.minimise(
                pressed.of(part), start.positions, _most_iterations(step), until=smooth.ended
            )

        if ends[-1][0] > few:
            concerned = set(garments.vertex_garment[caught].tolist())
            longest = _EDGES_IN_A_PART * min(garments.mean_edge_lengths[number] for number in concerned)
            retried, solution = in_parts(step, substep_count(step, longest), solve)
            ends.append((added(retried), retried))
        if self.retried:
            self.retried(solution)
        return min(ends, key=lambda end: end[0])[1]


class ImplicitSteps(SolverRefinement):
    """Minimises the incremental potential from a start of its own, whatever was predicted.

    Where the body moves far, the step is cut into several; see `implicit_steps`.

    Args:
        potential: the energies.
        iterations: at most this many an implicit step; None goes to the solver's tolerance.
        watch: called with the solution of every step, as `implicit_steps` tells of it.
        start: gives the positions (vertices, 3) [m] that each implicit step starts from.
        retried: called with the solution of every retry of a step.
    """

    def __init__(
        self,
        potential: IncrementalPotential,
        iterations: int | None = None,
        watch: Callable[[Solution], None] | None = None,
        start: Callable[[TimeStep], Tensor] = free_flight,
        retried: Callable[[Solution], None] | None = None,
    ) -> None:
        super().__init__(potential, iterations, retried=retried)
        self.watch, self.start = watch, start

    def refine(self, step: TimeStep, predicted: State) -> State:
        state, solution = implicit_steps(self.potential, self.solver, step, self.iterations, self.start)
        if self.watch:
            self.watch(solution)
        return state


class SafeguardedRefinement(SolverRefinement):
    """Refines a prediction, and retries the step where edges go through a limb or stretched cloth falls.

    Cloth that a prediction left on two sides of a limb stays caught there, however many iterations follow. The step is
    then solved from where the body carries the garment: to a rough tolerance, or, if nothing goes through a limb, until
    no more is strained than where the step began.

    Args:
        potential: the energies.
        iterations: at most this many after a prediction; fewer where the cloth is near balance before.
        retried: called with the solution of every retry of a step.
    """

    def __init__(
        self,
        potential: IncrementalPotential,
        iterations: int,
        retried: Callable[[Solution], None] | None = None,
    ) -> None:
        # One iteration in any case: cloth that falls in air is out of balance by less than its weight.
        super().__init__(potential, iterations, Solver(_NEAR_BALANCE, settled=_SETTLED, least=1), retried)
        self._rough = Solver(_ROUGH_TOLERANCE)

    def refine(self, step: TimeStep, predicted: State) -> State:
        refined = self.solver.minimise(self.potential.of(step), predicted.positions, self.iterations)
        pierced = newly_pierced(step, refined.positions)
        falling = refined.residual > _BALANCED and refined.decrease > _STILL_FALLING
        # What limbs pinch stays strained, and out of balance.
        pinched = _failed_faces(step, step.state.positions) if falling else 0
        if not pierced and not (falling and _failed_faces(step, refined.positions) > pinched):
            return step.reached(refined.positions, refined.struck)

        def solve(part: TimeStep) -> Solution:
            start, smooth = self._warm_start.positions(part), _Smoothing(part, allowed=None if pierced else pinched)
            return self._rough.minimise(self.potential.of(part), start, _most_iterations(step), until=smooth.ended)

        def quality(x: Tensor, residual: float) -> tuple[int, bool, float]:
            return newly_pierced(step, x), _failed_faces(step, x) > pinched, residual

        state, solved = in_parts(step, substep_count(step), solve)
        if self.retried:
            self.retried(solved)
        better = quality(state.positions, solved.residual) < quality(refined.positions, refined.residual)
        return state if better else step.reached(refined.positions, refined.struck)


class _Smoothing:
    """Ends a solve that leaves too many of the faces strained of some iterations before, or few enough.

    Args:
        step: the time step.
        allowed: number of strained faces from which down it ends; None goes on to the tolerance where there is none.
        failed: number of strained faces where it begins.
        share: of the strained faces some iterations before, from which on it ends.
    """

    def __init__(
        self, step: TimeStep, *, allowed: int | None = None, failed: float = math.inf, share: float = 1.0
    ) -> None:
        self.step, self.allowed, self.failed, self.share = step, allowed, failed, share
        self.iterations = 0

    def ended(self, x: Tensor) -> bool:
        """Whether the iteration that led to `x` (vertices, 3) [m] is the last."""
        self.iterations += 1
        if self.iterations % _MOST_PRESSING:
            return False
        before, self.failed = self.failed, _failed_faces(self.step, x)
        if self.failed <= (self.allowed or 0):
            return self.allowed is not None
        return self.failed >= self.share * before


def _most_iterations(step: TimeStep) -> int:
    """Iterations of a retry at most."""
    return _MOST_PRESSING + min(_MOST_RETRY_ITERATIONS, max(1, _PRESSING_WORK // len(step.garments.faces)))


def _near(garments: PackedGarments, vertices: Tensor) -> Tensor:
    """Which vertices (vertices,) bool are up to `_RINGS` edges from some `vertices` (vertices,) bool."""
    near, edges = vertices.numpy(), garments.edges.numpy()
    for _ in range(_RINGS):
        grown = np.zeros_like(near)
        grown[beside(edges, near)] = True
        near = grown
    return torch.from_numpy(near)


def _passed(step: TimeStep, x: Tensor | None = None) -> Tensor:
    """Vertices (vertices,) bool that bodies are through at the end of a step, at `x` (vertices, 3) [m], or before."""
    obstacle, bodies = step.obstacle, step.bodies
    if x is not None and bodies is not None:
        # What is kept of queries bounds later ones, which round differently then.
        obstacle = Obstacle.at(step.garments, bodies.following.apart(), x)
    passed = np.zeros(0, dtype=bool) if obstacle is None else obstacle.passed
    return torch.from_numpy(passed[: len(step.garments.rest_positions)])


def _failed_faces(step: TimeStep, x: Tensor) -> int:
    return int(_are_failed(step, x).sum())


def _are_failed(step: TimeStep, x: Tensor) -> Tensor:
    """Whether each face (faces,) is strained beyond measure at `x` (vertices, 3) [m]."""
    garments = step.garments
    return face_strains(x, garments.faces, garments.inverse_rest_shape) > _FAILED_STRAIN


def collision_free_move(self_contact: CollisionFree | None, step: TimeStep, before: State, target: State) -> State:
    """State as far from `before` towards `target` as cloth can move without passing through cloth; its velocities fit.

    Args:
        self_contact: keeps cloth from passing through cloth; None where it may.
        step: the time step.
        before: state that crosses nowhere.
        target: state at the end of the step.
    """
    if self_contact is None:
        return target
    positions, _ = self_contact.collision_free_move(step.garments, before.positions, target.positions)
    return _moved_to(positions, target, step)


def past_bodies(self_contact: CollisionFree | None, step: TimeStep, target: State, *, apart: bool) -> State:
    """State as far from the step's start towards `target` as cloth can move past the moving bodies; its velocities fit.

    Args:
        self_contact: keeps cloth from passing through bodies; None where it may.
        step: the time step.
        target: state at the end of the step.
        apart: whether no move that led there from the step's start carried cloth through cloth.
    """
    if self_contact is None or not self_contact.feels_bodies or step.bodies is None or step.obstacle is None:
        return target
    positions, obstacle = self_contact.collision_free_move(
        step.garments, step.state.positions, target.positions, obstacle=step.obstacle, apart=apart
    )
    if obstacle is not None:
        # What they were not through, nor left no room, need not be looked for again.
        obstacle.reached(step.garments, step.bodies.following, positions)
    return _moved_to(positions, target, step)


def _moved_to(positions: Tensor, target: State, step: TimeStep) -> State:
    """`target` at other positions, with the velocities that the difference takes away."""
    return target if positions is target.positions else step.turned_aside(target, positions)
