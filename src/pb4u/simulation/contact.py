"""Contact response as the last part of a step."""

from __future__ import annotations

from collections.abc import Callable

from pb4u.physics.contact_response import ContactReport, ContactResponse
from pb4u.physics.face_clearance import FaceClearance
from pb4u.scene.packed import ColliderFrame, PackedGarments
from pb4u.scene.state import State
from pb4u.simulation.step import Contact, Situation


class SurfaceContact(Contact):
    """Pushes vertices out of the true body surface, and writes edges and faces that dip into it between them lifted.

    The lift stays out of the simulation: coarse cloth would ride above the reach of friction and slide off.

    Args:
        response: the rules for vertices.
        faces: the rules for what lies between them.
        watch: called with every report.
    """

    def __init__(
        self,
        response: ContactResponse | None = None,
        faces: FaceClearance | None = None,
        watch: Callable[[ContactReport], None] | None = None,
    ) -> None:
        self.response = response or ContactResponse()
        self.faces = faces or FaceClearance()
        self.watch = watch

    def respond(self, state: State, situation: Situation) -> State:
        answered, report = self.response.respond(
            situation.garments, state, situation.collider, situation.dt, situation.state
        )
        if self.watch:
            self.watch(report)
        return answered

    def present(self, state: State, garments: PackedGarments, collider: ColliderFrame) -> State:
        return self.faces.lift(garments, state, collider)
