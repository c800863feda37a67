"""One whole time step: start, predict, integrate, refine, answer contact.

Simulation takes all of it; training learns from its predictions and refines nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from pb4u.collision.rooms import Rooms
from pb4u.physics.contact.self_contact import CollisionFree
from pb4u.physics.time_step import TimeStep, integrate, require_finite
from pb4u.scene.state import State
from pb4u.simulation.pass_search import PassSearch
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.refinement import SolverRefinement, collision_free_move, past_bodies
from pb4u.simulation.step_start import BodyMotionWarmStart, begun
from pb4u.threads import one_torch_thread

LARGE_DECREASE = 1.5e-3
"""Energy decrease of a pass, as the height [m] to which it would lift the garments, from which on another pass is made.

Less than the 2 mm above the skin at which contact begins.
"""


class Pass(Protocol):
    """What corrects the accelerations of a step: a network, or what stands in its place.

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
    """What takes a step.

    Args:
        start: where the step starts from; None for free flight.
        network: predicts accelerations; None leaves the step where it starts.
        refinement: lowers the incremental potential from there; None leaves predictions as far as cloth can go.
        contact: answers what is left inside the body; None leaves it there.
        self_contact: keeps each of these from moving cloth through cloth; None where it may.
        search: how far a step goes along a pass of the network.
    """

    start: BodyMotionWarmStart | None = None
    network: Pass | None = None
    refinement: SolverRefinement | None = None
    contact: ContactResponse | None = None
    self_contact: CollisionFree | None = None
    search: PassSearch = field(default_factory=PassSearch)


def take(step: TimeStep, method: StepMethod) -> State:
    """State at the end of a time step; nothing given is changed.

    Args:
        step: that is taken.
        method: what takes it.

    Raises:
        DivergedError: it is not finite.
    """
    refinement, contact, cloth = method.refinement, method.contact, method.self_contact
    with one_torch_thread():
        if contact is not None:
            step = contact.with_pins_clear(step)
        # Where the garments would be: led there by the start of the step, corrected by every pass of the network.
        *_, predicted = predictions(step, method)
        require_finite(predicted)
        if refinement is None:
            state = collision_free_move(cloth, step, step.state, predicted)
        else:
            # A few iterations of the solver, or all of them, lower the energies that the network was trained on.
            state = refinement.refine(step, predicted)
        if contact is not None:
            # Vertices still inside the body are pushed out, without gaining speed, and no further than to other cloth.
            state = collision_free_move(cloth, step, state, contact.respond(step, state))
            if refinement is not None:
                # What cloth around it kept inside the body is pushed out together with that cloth.
                state = refinement.respond_with_cloth(step, state, contact)
        # Between vertices too no face or edge of a body comes through.
        kept = (
            past_bodies(cloth, step, state)
            if refinement is None
            else refinement.pressed_past_bodies(step, state, cloth)
        )
        # Where one is through cloth already, no energy leads it back.
        return kept if contact is None else contact.cleared(step, kept, cloth)


def predictions(step: TimeStep, method: StepMethod, rooms: Rooms | None = None) -> Iterator[State]:
    """States at the end of `step`: the one its start leads to, and that after each pass of the network.

    Only the latest pass is differentiable: training learns from each before the next. Ends early where a pass gave
    what is not finite, since no body can be queried there.

    Args:
        step: that is taken.
        method: gives the start and the network.
        rooms: of a step that waits for no decision: passes that are not worth taking are computed, and left out.
    """
    # From free flight, or part of the way that the body moves: (vertices, 3) [m per step^2].
    accelerations = begun(method.start, step)
    # Velocities and positions from accelerations; pinned vertices take their places on the body.
    yield integrate(step, accelerations)
    if method.network is not None:
        moved = _passes(step, method, method.network, accelerations, rooms)
        yield from (integrate(step, each) for each in moved)


def _passes(
    step: TimeStep, method: StepMethod, network: Pass, accelerations: Tensor, rooms: Rooms | None
) -> Iterator[Tensor]:
    """Accelerations after each pass of the network, up to the first that is not worth its time in any world.

    With `rooms` nothing is decided: as many passes as there is room for, those not worth their time left out.
    """
    search, passes, most = method.search, network.passes, network.passes + network.further
    made = most if rooms is None else rooms.repeats("passes", most)
    worth: list[Tensor] = []
    for number in range(min(made + 1, most)):
        if number >= passes:
            worth.append(_is_worth_another(step, method, worth[-1] if worth else None))
            if rooms is None and not bool(worth[-1].any()):
                return
        if number == made:
            break
        reached, last = accelerations.detach(), search.last
        if rooms is None and not bool(torch.isfinite(reached).all()):
            return
        move = search.move(step, reached, network.correction(step, reached))
        goes_on = worth[-1] if worth else None
        search.worth = None if rooms is None else goes_on
        accelerations = reached + _where_worth(step, search, move, last, goes_on)
        yield accelerations
    if rooms is not None and most > passes:
        rooms.note("passes", passes + torch.stack(worth).any(1).sum())


def _is_worth_another(step: TimeStep, method: StepMethod, before: Tensor | None) -> Tensor:
    """Where (worlds,) bool another pass is worth its time, and the pass `before` was."""
    worth = ~(method.search.decrease_height(step.garments) < LARGE_DECREASE)
    return worth if before is None else worth & before


def _where_worth(step: TimeStep, search: PassSearch, move: Tensor, last: Tensor | None, worth: Tensor | None) -> Tensor:
    """`move` (vertices, 3) in the worlds where it is worth its time; the others stay, and keep their last."""
    if worth is None or last is None or search.last is None:
        return move
    goes_on = worth[step.garments.vertex_world, None]
    search.last = torch.where(goes_on, search.last, last)
    return torch.where(goes_on, move, 0.0)
