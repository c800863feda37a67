"""What is painted on the cloth, and what stands in the scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pb4u.viewer.overlay import OVERLAYS, Overlay
from pb4u.viewer.page_event import guarded

if TYPE_CHECKING:
    from viser import GuiApi

    from pb4u.viewer.session import Session


class LookPanel:
    """What is painted on the cloth, and what stands in the scene."""

    def __init__(self, gui: GuiApi, session: Session) -> None:
        self._session = session
        self._overlay = gui.add_dropdown("Overlay", list(OVERLAYS), initial_value=session.state.overlay)
        self._legend = gui.add_html("", visible=False)
        self._body = gui.add_checkbox("Body", session.state.body)
        self._follow = gui.add_checkbox("Follow the body", session.state.follow)
        self._shadows = gui.add_checkbox("Shadows", session.state.shadows, hint="For computers with a graphics card.")
        self._camera = gui.add_button("Reset the view")
        self._overlay.on_update(guarded(session, self._set_overlay))
        self._body.on_update(guarded(session, self._set_body))
        self._follow.on_update(guarded(session, self._set_follow))
        self._shadows.on_update(guarded(session, self._set_shadows))
        self._camera.on_click(guarded(session, session.reset_camera))

    def _set_overlay(self) -> None:
        name = self._overlay.value
        if name in OVERLAYS:
            self._session.change(lambda state: setattr(state, "overlay", name))

    def _set_body(self) -> None:
        shown = bool(self._body.value)
        self._session.change(lambda state: setattr(state, "body", shown))

    def _set_follow(self) -> None:
        follow = bool(self._follow.value)
        self._session.change(lambda state: setattr(state, "follow", follow))
        self._session.reset_camera()

    def _set_shadows(self) -> None:
        shadows = bool(self._shadows.value)
        self._session.change(lambda state: setattr(state, "shadows", shadows))

    def explain(self, looks: tuple[Overlay, ...]) -> None:
        """The legend of what is painted."""
        scale = looks[0].scale if looks else None
        self._legend.visible = scale is not None
        if scale is not None:
            self._legend.content = scale.legend(tuple(look.note for look in looks if look.note))
