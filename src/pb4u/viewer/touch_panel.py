"""Panel of what is done to the cloth while it is simulated: wind, fabric, and from where it goes on."""

from __future__ import annotations

from functools import partial
from typing import Any

from pb4u.garment.material import material_names
from pb4u.simulation.live_run import LiveRun
from pb4u.viewer.panel import Panel, Tone, notice
from pb4u.viewer.touches import MOST_FRAMES, STRONGEST_WIND

_AS_IT_IS = "as it is"

_UNFELT = (
    "This model feels neither hand nor wind: choose solver or quick-solver, or a network with refining iterations."
)


class TouchPanel(Panel):
    """Wind, fabrics, and the first and last frame of the continued simulation."""

    def _add_controls(self) -> None:
        gui = self._gui
        gui.add_html(
            notice(
                "While cloth is simulated, drag it with the left mouse button to pull at it; let go of the button to "
                "let it go. Drag beside the cloth to turn the view. Painted cloth cannot be dragged. Speed, above, "
                "slows it down."
            )
        )
        self._offered: LiveRun | None = None
        self._unfelt = gui.add_html(notice(_UNFELT, Tone.warning), visible=False)
        self._speed = gui.add_slider("Wind [m/s]", 0.0, STRONGEST_WIND, 0.5, 0.0)
        self._degrees = gui.add_slider(
            "Wind from [deg]", 0.0, 345.0, 15.0, 0.0,
            hint="0 from where the body faces at first, 90 from its left, 180 from behind.",
        )  # fmt: skip
        self._gusts = gui.add_checkbox("Gusts", False)
        self._place = gui.add_folder("Fabric")
        self._fabrics: list[Any] = []
        self._endless = gui.add_checkbox(
            "Go on after the last frame", False, hint=f"The body stands then; to {MOST_FRAMES} frames in all."
        )
        go_on = gui.add_button(
            "Go on from this frame", hint="What comes after the frame that is shown is simulated again."
        )
        self._status = gui.add_html("")
        for control in (self._speed, self._degrees, self._gusts):
            control.on_update(self._answer(self._blow))
        self._endless.on_update(self._answer(self._set_end))
        go_on.on_click(self._answer(self._window.go_on))

    def offer(self, live: LiveRun | None) -> None:
        """Offer the fabrics of the garments of a run, and say what its cloth does not feel.

        Args:
            live: the simulation that began; None if it cannot be touched.
        """
        if live is self._offered and live is not None:
            return
        self._offered = live
        self._unfelt.visible = live is None or not live.feels
        garment_names = [] if live is None else [dressed.garment.name for dressed in live.scene.garments]
        names = [f"{number}: {name}" for number, name in enumerate(garment_names, 1)]
        for control in self._fabrics:
            control.remove()
        with self._place:
            self._fabrics = [self._gui.add_dropdown(name, (_AS_IT_IS, *material_names())) for name in names]
        for number, control in enumerate(self._fabrics):
            control.on_update(self._answer(partial(self._dress, number, control)))

    def _blow(self) -> None:
        self._window.touches.blow(self._speed.value, self._degrees.value, self._gusts.value)

    def _set_end(self) -> None:
        self._window.touches.endless = bool(self._endless.value)

    def _dress(self, number: int, control: Any) -> None:
        name = control.value
        if name != _AS_IT_IS:
            self._window.touches.dress(number, name)
            self._status.content = notice(f"Made of {name} from the next step on.", Tone.good)
