"""One time step, told whole: start, predict, integrate, refine, answer contact. Training takes the same step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from torch import Tensor

from pb4u.physics.contact.response import Contact, NoContact
from pb4u.physics.time_step import TimeStep, integrate, require_finite
from pb4u.scene.state import State
from pb4u.simulation.network_pass import Network, NoNetwork
from pb4u.simulation.refinement import NoRefinement, Refinement
from pb4u.simulation.step_start import FreeFlight, StepStart


@dataclass(frozen=True, eq=False)
class StepMethod:
    """What takes a step; each part has a null object.

    Args:
        start: where the step starts from.
        network: predicts accelerations.
        refinement: lowers the incremental potential from there.
        contact: answers what is left inside the body.
    """

    start: StepStart = field(default_factory=FreeFlight)
    network: Network = field(default_factory=NoNetwork)
    refinement: Refinement = field(default_factory=NoRefinement)
    contact: Contact = field(default_factory=NoContact)


def take(step: TimeStep, method: StepMethod) -> State:
    """The state at the end of `step`; nothing given is changed. Raises DivergedError where it is not finite."""
    # Where the garments would be: at the start of the step, corrected by every pass of the network.
    *_, accelerations = predictions(step, method)
    # Velocities and positions from accelerations; pinned vertices take their places on the body.
    predicted = require_finite(integrate(step, accelerations))
    # A few iterations of the solver, or all of them, lower the same energies that the network was trained on.
    refined = method.refinement.refine(step, predicted)
    # What is still inside the body is pushed out, without gaining speed.
    return method.contact.respond(step, refined)


def predictions(step: TimeStep, method: StepMethod) -> Iterator[Tensor]:
    """Accelerations (vertices, 3) [m per step^2] at the start of `step`, and after each pass of the network.

    Only the latest pass is differentiable: training learns from each before the next. Ends early where a pass gave
    what is not finite, since no body can be looked up there.
    """
    accelerations = method.start.accelerations(step)
    yield accelerations
    for _ in range(method.network.passes):
        reached = accelerations.detach()
        if not bool(torch.isfinite(reached).all()):
            return
        accelerations = reached + method.network.correction(step, reached)
        yield accelerations
