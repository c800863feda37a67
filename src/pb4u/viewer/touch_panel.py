"""Panel of what is done to the cloth while it is simulated: wind, fabric, going on; how it is pulled stands there too."""

from __future__ import annotations

from typing import Any

from pb4u.garment.material import material_names
from pb4u.scene.scene import Scene
from pb4u.viewer.panel import Panel, Tone, notice
from pb4u.viewer.touches import MOST_FRAMES, STRONGEST_WIND

_AS_IT_IS = "as it is"


class TouchPanel(Panel):
    """Wind, fabrics, and from which frame to how far the simulation goes."""

    def _add_controls(self) -> None:
        gui = self._gui
        gui.add_html(
            notice(
                "While cloth is simulated, drag it with the left mouse button to pull at it; let go of the button to "
                "let it go. Drag beside the cloth to turn the view. Speed, above, slows it down."
            )
        )
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
        go_on = gui.add_button("Go on from this frame", hint="What comes after the frame that is shown is made anew.")
        self._status = gui.add_html("")
        for control in (self._speed, self._degrees, self._gusts):
            control.on_update(self._answer(self._blow))
        self._endless.on_update(self._answer(self._set_end))
        go_on.on_click(self._answer(self._window.go_on))

    def offer(self, scene: Scene) -> None:
        """Offer the fabrics of the garments of a scene, where they are not offered yet.

        Args:
            scene: garments and bodies.
        """
        names = [f"{n + 1}: {worn.garment.name}" for n, worn in enumerate(scene.garments)]
        if [control.label for control in self._fabrics] == names:
            return
        for control in self._fabrics:
            control.remove()
        with self._place:
            self._fabrics = [self._gui.add_dropdown(name, (_AS_IT_IS, *material_names())) for name in names]
        for number, control in enumerate(self._fabrics):
            control.on_update(self._answer(lambda number=number, control=control: self._dress(number, control.value)))

    def _blow(self) -> None:
        self._window.touches.blow(self._speed.value, self._degrees.value, self._gusts.value)

    def _set_end(self) -> None:
        self._window.touches.endless = bool(self._endless.value)

    def _dress(self, number: int, name: str) -> None:
        if name != _AS_IT_IS:
            self._window.touches.dress(number, name)
            self._status.content = notice(f"Made of {name} from the next step on.", Tone.good)
