"""First frame of a simulation: garments settled on the standing bodies, from where skinning puts them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.garment.tangles import untangled_start
from pb4u.physics.contact.contact_set import MOTION_REACH, nearest_planes
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.terms.collision import Collision
from pb4u.physics.terms.stretch import Stretch
from pb4u.registry import Registry
from pb4u.scene.state import State
from pb4u.simulation.refinement import SolverRefinement, collision_free_move
from pb4u.simulation.step import StepMethod, Taken, take
from pb4u.simulation.timeline import Timeline

_CLOSES = 0.02
"""Distance [m] from the body up to which elastic lies on it from the start."""


class FirstFrame(ABC):
    """Rule that makes frame 0, and those after it that are made in a way of their own."""

    @abstractmethod
    def states(self, timeline: Timeline, method: StepMethod) -> Iterator[Taken]:
        """States of these frames; the garments set off from the last with the velocity that it has.

        Args:
            timeline: garments and bodies.
            method: takes the steps that follow.
        """

    def start(self, timeline: Timeline, method: StepMethod) -> Taken:
        """The last of `states`; arguments as there.

        Args:
            timeline: garments and bodies.
            method: takes the steps that follow.
        """
        *_, last = self.states(timeline, method)
        return last


def untangled(timeline: Timeline, method: StepMethod, state: State) -> State:
    """`state` with its garments untangled, where the method keeps cloth from passing through cloth.

    Args:
        timeline: garments and bodies.
        method: takes the steps that follow.
        state: of any frame.

    Raises:
        InputError: what crosses cannot be untangled.
    """
    if method.self_contact is None:
        return state
    garments, positions, free = timeline.garments, as_float64(state.positions), []
    for world, rows in enumerate(garments.world_vertices):
        members = [g for g, number in zip(garments.garments, garments.worlds, strict=True) if number == world]
        free.append(untangled_start(members, positions[rows]))
    return replace(state, positions=torch.from_numpy(np.concatenate(free)).to(state.positions))


def _falls(timeline: Timeline) -> Tensor:
    """Vertices (vertices,) bool of the worlds in which there is neither a body nor a pin."""
    garments = timeline.garments
    is_held = torch.zeros(garments.world_count, dtype=torch.bool, device=garments.vertex_world.device)
    is_held[timeline.colliders.vertex_world] = True
    is_held[garments.vertex_world[garments.pinned]] = True
    return ~is_held[garments.vertex_world]


class AsPlaced(FirstFrame):
    """The garments where their placement puts them, such as cloth about to fall; untangled where cloth feels cloth."""

    def states(self, timeline: Timeline, method: StepMethod) -> Iterator[Taken]:
        yield Taken(untangled(timeline, method, timeline.skinned_state(0)))


class OneLongStep(FirstFrame):
    """The paper's rule: the method's own step, once, with the body held and a long time step.

    Before it the contact response is applied once, as the released code pushes garments out of the body.
    """

    def states(self, timeline: Timeline, method: StepMethod) -> Iterator[Taken]:
        begun = AsPlaced().start(timeline, method).state
        step = timeline.settling_from(begun)
        if method.contact is not None:
            pushed = collision_free_move(
                method.self_contact, step, step.state, method.contact.respond(step, step.state)
            )
            step = timeline.settling_from(pushed)
        settled, last_move = take(step, method)
        positions = torch.where(_falls(timeline)[:, None], begun.positions, settled.positions)
        yield Taken(replace(begun, positions=positions), last_move)


def _closed(timeline: Timeline, method: StepMethod, state: State) -> State:
    """`state` with elastic laid on the bodies, which it presses: else it would slide while it closes on them."""
    step, garments = timeline.settling_from(state), timeline.garments
    if step.bodies is None:
        return state
    planes = nearest_planes(step.bodies.following, garments, state.positions, within=MOTION_REACH)
    gathered = np.zeros(garments.vertex_count, dtype=bool)
    for garment, first in zip(garments.garments, garments.vertex_offsets, strict=False):
        if garment.trims is not None:
            gathered[garment.faces[garment.trims.elastic < 1.0] + int(first)] = True
    near = torch.from_numpy(gathered) & planes.touchable & ~garments.pinned & (planes.distance < _CLOSES)
    way = torch.where(near, Collision().clearance - planes.distance, 0.0)
    laid = replace(state, positions=state.positions + way[:, None] * planes.normals)
    x = collision_free_move(method.self_contact, step, state, laid).positions
    _, pull = method.potential.term(Stretch.name).energies_and_gradient(step, step.contacts, x)
    load = torch.where(near, (pull * planes.normals).sum(1), 0.0).clamp_min(0.0)
    return replace(state, positions=x, load=load)


@dataclass(frozen=True)
class Settled(FirstFrame):
    """Settling by the solver: long steps from rest, until one moves no garment by more than `still`.

    A world without a body and without pins has nothing to settle on, and begins as placed.

    Args:
        still: rms displacement of one settling step [m] at which a garment counts as settled, and all have to be.
        most_steps: settling steps after which they start anyway; garments fitted to the body take two to four.
        iterations: solver iterations of each settling step.
        solver: makes them; one of its own by default.
    """

    still: float = 2e-3
    most_steps: int = 12
    iterations: int = 12
    solver: Solver | None = None

    def states(self, timeline: Timeline, method: StepMethod) -> Iterator[Taken]:
        refinement = SolverRefinement(method.potential, self.iterations, self.solver)
        settling = StepMethod(refinement=refinement, contact=method.contact, potential=method.potential)
        begun = state = AsPlaced().start(timeline, method).state
        owner, falls = timeline.garments.vertex_garment, _falls(timeline)
        if any(garment.has_elastic for garment in timeline.garments.garments):
            state = _closed(timeline, method, state)
        for _ in range(self.most_steps):
            settled = take(timeline.settling_from(state), settling).state
            positions = torch.where(falls[:, None], begun.positions, settled.positions)
            moves = (positions - state.positions).square().sum(1)
            farthest = max(
                float(moves[owner == number].mean().sqrt()) for number in range(timeline.garments.garment_count)
            )
            state = replace(begun, positions=positions, load=settled.load)
            if farthest <= self.still:
                break
        yield Taken(state)


FIRST_FRAMES: Registry[FirstFrame] = Registry(
    "first frame", {"settled": Settled(), "long_step": OneLongStep(), "placed": AsPlaced()}
)
"""Ways to make frame 0, by the name that `first_frame` takes."""
