"""What to simulate, and how far it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pb4u.body.library import body_names
from pb4u.garment.library import garment_names
from pb4u.garment.material import material_names
from pb4u.motion.library import motion_names
from pb4u.simulation.models import default_model, model_descriptions
from pb4u.viewer.live_simulation import LEAST_TRIANGLES, MOST_FRAMES, MOST_TRIANGLES, SimulationRequest
from pb4u.viewer.notice import Tone, notice
from pb4u.viewer.page_event import guarded
from pb4u.viewer.plain_sentence import plain_sentence

if TYPE_CHECKING:
    from viser import GuiApi

    from pb4u.viewer.session import Session


class SimulationPanel:
    """Body, motion, garment, material, triangle count and model; frames arrive as they are computed."""

    def __init__(self, gui: GuiApi, session: Session) -> None:

        self._session = session
        usual = SimulationRequest()
        self._garment = gui.add_dropdown("Garment", garment_names(), initial_value=usual.garment)
        self._body = gui.add_dropdown("Body", body_names(), initial_value=usual.body)
        self._motion = gui.add_dropdown("Motion", motion_names(), initial_value=usual.motion)
        self._material = gui.add_dropdown("Material", material_names(), initial_value=usual.material)
        self._triangles = gui.add_number(
            "Triangles", usual.triangles, min=LEAST_TRIANGLES, max=MOST_TRIANGLES, step=100
        )
        self._frames = gui.add_number("Frames", usual.frames, min=1, max=MOST_FRAMES, step=1)
        self._lead_in = gui.add_number(
            "Lead-in", usual.lead_in, min=0, max=MOST_FRAMES, step=1,
            hint="Frames from the rest pose into the motion, simulated but not shown.",
        )  # fmt: skip
        models = model_descriptions()
        self._model = gui.add_dropdown(
            "Model", list(models), initial_value=default_model(),
            hint="; ".join(f"{name}: {line}" for name, line in models.items()),
        )  # fmt: skip
        self._refine = gui.add_number(
            "Refine", usual.refine, min=0, max=100, step=1, hint="Solver iterations after each step of a network."
        )
        self._start = gui.add_button("Simulate")
        self._stop = gui.add_button("Cancel", disabled=True)
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._status = gui.add_html("")
        self._start.on_click(guarded(session, self._simulate))
        self._stop.on_click(guarded(session, self._cancel))

    def request(self) -> SimulationRequest:
        """What is filled in."""
        return SimulationRequest(
            self._garment.value, self._body.value, self._motion.value, self._material.value, self._model.value,
            int(self._triangles.value), int(self._frames.value), int(self._lead_in.value), int(self._refine.value),
        )  # fmt: skip

    def _simulate(self) -> None:
        request = self.request()
        self._start.disabled, self._stop.disabled = True, False
        self._bar.value, self._bar.visible = 0.0, True  # type: ignore[misc]
        self._status.content = notice("Loading and dressing.")
        try:
            self._session.simulate(request)
        except Exception as error:
            self.ended(plain_sentence(error), well=False)
            raise

    def _cancel(self) -> None:
        self._stop.disabled = True
        self._session.cancel()
        self._status.content = notice("Stopping after this step.")

    def progress(self, done: int, total: int) -> None:
        """How far it is."""
        self._bar.value = 100.0 * done / total  # type: ignore[misc]
        self._status.content = notice(f"Step {done} of {total}, lead-in included.")

    def ended(self, sentence: str, well: bool) -> None:
        """How it ended."""
        self._start.disabled, self._stop.disabled = False, True
        self._bar.visible = False
        self._status.content = notice(sentence, Tone.good if well else Tone.warning)
