"""Contact response as the last part of a step."""

from __future__ import annotations

from collections.abc import Callable

from pb4u.physics.contact_response import ContactReport, ContactResponse
from pb4u.scene.state import State
from pb4u.simulation.step import Contact, Situation


class SurfaceContact(Contact):
    """Pushes vertices out of the true body surface; see `ContactResponse`.

    Args:
        response: the rules.
        watch: called with every report.
    """

    def __init__(
        self, response: ContactResponse | None = None, watch: Callable[[ContactReport], None] | None = None
    ) -> None:
        self.response = response or ContactResponse()
        self.watch = watch

    def respond(self, state: State, situation: Situation) -> State:
        answered, report = self.response.respond(
            situation.garments, state, situation.collider, situation.dt, situation.state
        )
        if self.watch:
            self.watch(report)
        return answered
