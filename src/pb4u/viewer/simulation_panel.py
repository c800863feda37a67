"""What to simulate, and how far it is."""

from __future__ import annotations

from pb4u.body.library import body_names
from pb4u.garment.library import LEVELS, garment_names
from pb4u.garment.material import material_names
from pb4u.motion.library import motion_names
from pb4u.scene.assembly import DEFAULT_FRAMES, DEFAULT_MATERIAL, DEFAULT_MOTION
from pb4u.scene.specification import GarmentSpecification, SceneSpecification
from pb4u.simulation.models import default_model, model_descriptions
from pb4u.simulation.run_specification import RunSpecification
from pb4u.viewer.live_simulation import LEAST_TRIANGLES, MOST_FRAMES, MOST_REFINING, MOST_TRIANGLES, Ending
from pb4u.viewer.panel import Panel, Tone, notice
from pb4u.viewer.worker import plain_sentence


class SimulationPanel(Panel):
    """Controls of a simulation: garment, body, motion, material, triangle count and model, and how far it is."""

    def _add_controls(self) -> None:
        gui = self._gui
        usual, models = RunSpecification(), model_descriptions()
        scene, worn = usual.scene, usual.scene.garments[0]
        self._garment = gui.add_dropdown("Garment", garment_names(), initial_value=str(worn.garment))
        self._body = gui.add_dropdown("Body", body_names(), initial_value=str(scene.body))
        self._motion = gui.add_dropdown("Motion", motion_names(), initial_value=DEFAULT_MOTION)
        self._material = gui.add_dropdown("Material", material_names(), initial_value=DEFAULT_MATERIAL)
        self._triangles = gui.add_number("Triangles", LEVELS["base"], min=LEAST_TRIANGLES, max=MOST_TRIANGLES, step=100)
        self._frames = gui.add_number("Frames", DEFAULT_FRAMES, min=1, max=MOST_FRAMES, step=1)
        self._lead_in = gui.add_number(
            "Lead-in", scene.lead_in, min=0, max=MOST_FRAMES, step=1,
            hint="Frames from the rest pose into the motion, simulated but not shown.",
        )  # fmt: skip
        self._model = gui.add_dropdown(
            "Model", list(models), initial_value=default_model(),
            hint="; ".join(f"{name}: {line}" for name, line in models.items()),
        )  # fmt: skip
        self._refine = gui.add_number(
            "Refine", usual.refine, min=0, max=MOST_REFINING, step=1,
            hint="Solver iterations after each step of a network.",
        )  # fmt: skip
        self._start = gui.add_button("Simulate")
        self._stop = gui.add_button("Cancel", disabled=True)
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._status = gui.add_html("")
        self._start.on_click(self._answer(self._simulate))
        self._stop.on_click(self._answer(self._requests.cancel))

    def run(self) -> RunSpecification:
        """The run that is filled in.

        Raises:
            InputError: that cannot be a run.
        """
        worn = GarmentSpecification(self._garment.value, self._material.value, triangles=int(self._triangles.value))
        return RunSpecification(
            SceneSpecification(
                (worn,), self._body.value, motion=self._motion.value, frames=int(self._frames.value),
                lead_in=int(self._lead_in.value),
            ),
            model=self._model.value,
            refine=int(self._refine.value),
        )  # fmt: skip

    def _simulate(self) -> None:
        try:
            self._requests.simulate(self.run())
        except Exception as error:
            self._status.content = notice(plain_sentence(error), Tone.warning)
            raise

    def began(self) -> None:
        """Show that a simulation has been accepted."""
        self._start.disabled, self._stop.disabled = True, False
        self._bar.value, self._bar.visible = 0.0, True  # type: ignore[misc]
        self._status.content = notice("Loading and dressing.")

    def progress(self, done: int, total: int) -> None:
        """Show how far the simulation is.

        Args:
            done: steps done, lead-in included.
            total: steps in all, lead-in included.
        """
        self._bar.value = 100.0 * done / total  # type: ignore[misc]
        self._status.content = notice(f"Step {done} of {total}, lead-in included.")

    def stopping(self) -> None:
        """Show that the simulation has been told to end."""
        self._stop.disabled = True
        self._status.content = notice("Stopping after this step.")

    def ended(self, sentence: str, ending: Ending) -> None:
        """Show that the simulation is over.

        Args:
            sentence: how it ended, in words.
            ending: how, for the colour of the box.
        """
        self._start.disabled, self._stop.disabled = False, True
        self._bar.visible = False
        self._status.content = notice(sentence, Tone.good if ending is Ending.finished else Tone.warning)
