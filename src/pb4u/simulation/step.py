"""One time step, told whole: start, predict, integrate, refine, answer contact.

Simulation takes all of it; training learns from its predictions and refines nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from torch import Tensor

from pb4u.collision.rooms import Rooms
from pb4u.physics.contact.self_contact import NoSelfContact, SelfContact
from pb4u.physics.time_step import TimeStep, integrate, require_finite
from pb4u.scene.state import State
from pb4u.simulation.network_pass import Network, NoNetwork
from pb4u.simulation.pass_search import PassSearch, WholePass
from pb4u.simulation.penetration_response import Contact, NoContact
from pb4u.simulation.refinement import NoRefinement, Refinement, carried
from pb4u.simulation.step_start import FreeFlight, StepStart
from pb4u.threads import one_torch_thread

LARGE_DECREASE = 1.5e-3
"""Height [m] to which the energy that a pass freed would lift the garments, from which on another pass is asked for.

Less than the 2 mm above the skin at which contact begins.
"""


@dataclass(frozen=True, eq=False)
class StepMethod:
    """What takes a step; each part has a null object.

    Args:
        start: where the step starts from.
        network: predicts accelerations.
        refinement: lowers the incremental potential from there.
        contact: answers what is left inside the body.
        self_contact: keeps each of these from carrying cloth through cloth.
        search: how far a step goes along a pass of the network.
    """

    start: StepStart = field(default_factory=FreeFlight)
    network: Network = field(default_factory=NoNetwork)
    refinement: Refinement = field(default_factory=NoRefinement)
    contact: Contact = field(default_factory=NoContact)
    self_contact: SelfContact = field(default_factory=NoSelfContact)
    search: PassSearch = field(default_factory=WholePass)


def take(step: TimeStep, method: StepMethod) -> State:
    """State at the end of a time step; nothing given is changed.

    Args:
        step: that is taken.
        method: what takes it.

    Raises:
        DivergedError: it is not finite.
    """
    with one_torch_thread():
        # Where the garments would be: led there by the start of the step, corrected by every pass of the network.
        *_, predicted = predictions(step, method)
        # A few iterations of the solver, or all of them, lower the same energies that the network was trained on.
        refined = method.refinement.refine(step, require_finite(predicted))
        # Vertices still inside the body are pushed out, without gaining speed.
        answered = method.contact.respond(step, refined)
        # A push, like every other move, goes no further than to the next cloth.
        pushed = carried(method.self_contact, step, refined, answered)
        # What cloth around it kept inside the body is pushed out together with that cloth.
        pressed = method.refinement.respond_with_cloth(step, pushed, method.contact)
        # Between vertices too no face or edge of a body comes through.
        kept = method.refinement.past_bodies(step, pressed, method.self_contact)
        # Where one is through cloth already, no energy leads it back.
        return method.contact.cleared(step, kept, method.self_contact)


def predictions(step: TimeStep, method: StepMethod, rooms: Rooms | None = None) -> Iterator[State]:
    """States at the end of `step`: the one its start leads to, and that after each pass of the network.

    Only the latest pass is differentiable: training learns from each before the next. Ends early where a pass gave
    what is not finite, since no body can be queried there.

    Args:
        step: that is taken.
        method: whose start and network are asked.
        rooms: of a step that waits for no decision: passes that are not worth taking are computed, and left out.
    """
    # From free flight, or part of the way that the body moves: (vertices, 3) [m per step^2].
    accelerations = method.start.accelerations(step)
    # Velocities and positions from accelerations; pinned vertices take their places on the body.
    yield integrate(step, accelerations)
    passes, most = method.network.passes, method.network.passes + method.network.further
    made = most if rooms is None else rooms.repeats("passes", most)
    worth: list[Tensor] = []
    for number in range(min(made + 1, most)):
        if number >= passes:
            worth.append(_is_worth_another(step, method, worth))
            if rooms is None and not bool(worth[-1]):
                return
        if number == made:
            break
        reached, last = accelerations.detach(), method.search.last
        if rooms is None and not bool(torch.isfinite(reached).all()):
            return
        move = method.search.move(step, reached, method.network.correction(step, reached))
        method.search.worth = worth[-1] if worth and rooms is not None else None
        if rooms is not None and worth and last is not None and method.search.last is not None:
            move = torch.where(worth[-1], move, 0.0)
            method.search.last = torch.where(worth[-1], method.search.last, last)
        accelerations = reached + move
        yield integrate(step, accelerations)
    if rooms is not None and most > passes:
        rooms.note("passes", passes + torch.stack(worth).sum())


def prediction(step: TimeStep, method: StepMethod, rooms: Rooms | None) -> State:
    """The last of `predictions`, which are made again where a search had too little room."""
    while True:
        last = method.search.last
        *_, after = predictions(step, method, rooms)
        if rooms is None or not rooms.grow(*rooms.taken()):
            return after
        method.search.last = last


def _is_worth_another(step: TimeStep, method: StepMethod, before: list[Tensor]) -> Tensor:
    """Whether () bool another pass is worth its time, and those `before` were."""
    worth = ~(method.search.decrease_height(step.garments) < LARGE_DECREASE)
    return worth & before[-1] if before else worth
