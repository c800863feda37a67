"""One whole time step: start, predict, integrate, refine, answer contact.

Simulation takes all of it; training learns from its predictions and refines nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from pb4u.collision.capacities import Capacities
from pb4u.physics.contact.self_contact import CollisionFree
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep, integrate, require_finite
from pb4u.scene.state import State
from pb4u.simulation.pass_search import PassSearch
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.refinement import SolverRefinement, collision_free_move, past_bodies
from pb4u.simulation.step_start import BodyMotionWarmStart, start_accelerations
from pb4u.threads import without_library_threads

LARGE_DECREASE = 1.5e-3
"""Energy decrease of a pass, as the height [m] to which it would lift the garments, from which on another pass is made.

Less than the 2 mm above the skin at which contact begins.
"""


class Pass(Protocol):
    """Corrects the accelerations of a step: a network, or a control in its place.

    Attributes:
        passes: how often it does in a step.
        further: how often again at most, while a pass lowers the energy much.
    """

    passes: int
    further: int

    def correction(self, step: TimeStep, accelerations: Tensor) -> Tensor:
        """Accelerations (vertices, 3) [m per step^2] to add to those reached so far, from free flight.

        Args:
            step: the time step.
            accelerations: (vertices, 3) [m per step^2] from free flight.
        """


@dataclass(frozen=True, eq=False)
class StepMethod:
    """How a step is taken.

    Args:
        start: where the step starts from; None for free flight.
        network: predicts accelerations; None leaves the step where it starts.
        refinement: lowers the incremental potential from there; None leaves predictions as far as cloth can go.
        contact: answers what is left inside the body; None leaves it there.
        potential: the energies of the simulation, by which its first frame settles too, and what keeps each of these
            from moving cloth through cloth.
        search: how far a step goes along a pass of the network; None takes it whole.
    """

    start: BodyMotionWarmStart | None = None
    network: Pass | None = None
    refinement: SolverRefinement | None = None
    contact: ContactResponse | None = None
    potential: IncrementalPotential = field(default_factory=IncrementalPotential)
    search: PassSearch | None = None

    @property
    def self_contact(self) -> CollisionFree | None:
        """Keeps moves from carrying cloth through cloth; None where they may."""
        return self.potential.self_contact


class Taken(NamedTuple):
    """Where a step led, and what its method remembers of it.

    Args:
        state: at the end of the step.
        last_move: (vertices, 3) how far the last pass of the network went [m per step^2], which serves the search of
            the next step; None where no pass was joined with the one before it.
    """

    state: State
    last_move: Tensor | None = None


def take(step: TimeStep, method: StepMethod, last_move: Tensor | None = None) -> Taken:
    """State at the end of a time step, and the last move of the network in it; nothing given is changed.

    Args:
        step: that is taken.
        method: how it is taken.
        last_move: what `take` gave with the state that the step starts from.

    Raises:
        DivergedError: it is not finite.
    """
    refinement, contact, cloth = method.refinement, method.contact, method.self_contact
    with without_library_threads():
        if contact is not None:
            step = contact.with_pins_clear(step)
        # Where the garments would be: led there by the start of the step, corrected by every pass of the network.
        *_, prediction = predictions(step, method, last_move)
        predicted = require_finite(prediction.state)
        if refinement is None:
            state, load = collision_free_move(cloth, step, step.state, predicted), None
        else:
            # A few iterations of the solver, or all of them, lower the energies that the network was trained on.
            state = refinement.refine(step, predicted)
            # Friction of the next step is of the force that holds cloth here, wherever it is pushed to.
            load = refinement.potential.load(step, state.positions)
        if contact is not None:
            # Vertices still inside the body are pushed out, without gaining speed, and no further than to other cloth.
            state = collision_free_move(cloth, step, state, contact.respond(step, state))
            if refinement is not None:
                # What cloth around it kept inside the body is pushed out together with that cloth.
                state = refinement.respond_with_cloth(step, state, contact)
        # Between vertices too no face or edge of a body comes through.
        outside = (
            past_bodies(cloth, step, state, apart=True)
            if refinement is None
            else refinement.pressed_past_bodies(step, state)
        )
        # Where one is through cloth already, no energy leads it back.
        after = outside if contact is None else contact.cleared(step, outside, cloth)
        return Taken(replace(after, load=load), prediction.last_move)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Where the start of a step leads, or a pass of the network after it.

    Args:
        state: at the end of the step; differentiable in the network's weights.
        last_move: as in `Taken`.
        decrease: (worlds,) by how much the pass lowered the energy [J]; None where that is not measured.
        worth: (worlds,) bool where the pass was worth its time; None where one that is not is never made.
    """

    state: State
    last_move: Tensor | None = None
    decrease: Tensor | None = None
    worth: Tensor | None = None


def predictions(
    step: TimeStep, method: StepMethod, last_move: Tensor | None = None, capacities: Capacities | None = None
) -> Iterator[Prediction]:
    """Where the start of `step` leads, and each pass of the network after it.

    Only the latest pass is differentiable: training learns from each before the next. Ends early where a pass gave
    what is not finite, since no body can be queried there, and where no world gains enough by another.

    Args:
        step: that is taken.
        method: gives the start and the network.
        last_move: what `take` gave with the state that the step starts from.
        capacities: of a step that waits for no decision: passes that are not worth taking are computed, and left out.
    """
    # From free flight, or part of the way that the body moves: (vertices, 3) [m per step^2].
    accelerations = start_accelerations(method.start, step)
    # Velocities and positions from accelerations; pinned vertices take their places on the body.
    yield Prediction(integrate(step, accelerations), last_move)
    network, search, decrease = method.network, method.search, None
    if network is None:
        return
    most = network.passes + network.further
    count = most if capacities is None else capacities.repeats("passes", most)
    worth: list[Tensor] = []
    for number in range(min(count + 1, most)):
        if number >= network.passes:
            worth.append(_is_worth_another(step, decrease, worth))
            if capacities is None and not bool(worth[-1].any()):
                return
        if number == count:
            break
        reached = accelerations.detach()
        if capacities is None and not bool(torch.isfinite(reached).all()):
            return
        move = network.correction(step, reached)
        if search is not None:
            move, decrease = search(step, reached, move, last_move)
            before, last_move = last_move, move.detach()
            if worth and before is not None:
                # Worlds in which it is not worth its time stay where they are, and keep their last move.
                goes_on = worth[-1][step.garments.vertex_world, None]
                move, last_move = torch.where(goes_on, move, 0.0), torch.where(goes_on, last_move, before)
        accelerations = reached + move
        is_worth = worth[-1] if worth and capacities is not None else None
        yield Prediction(integrate(step, accelerations), last_move, decrease, is_worth)
    if capacities is not None and network.further:
        capacities.note("passes", network.passes + torch.stack(worth).any(1).sum())


def _is_worth_another(step: TimeStep, decrease: Tensor | None, worth: list[Tensor]) -> Tensor:
    """Where (worlds,) bool another pass is worth its time, as the pass before it was, which lowered the energy."""
    if decrease is None:
        return torch.zeros(step.garments.world_count, dtype=torch.bool, device=step.garments.device)
    height = decrease / step.garments.world_weights
    large = ~(height < LARGE_DECREASE)
    return large & worth[-1] if worth else large
