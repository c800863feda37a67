"""Panel of the options, start, progress and end of a simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pb4u.body.library import body_names
from pb4u.errors import InputError
from pb4u.garment.library import LEVELS, garment_names
from pb4u.garment.material import material_names
from pb4u.garment.pins import NAMES as PIN_NAMES
from pb4u.motion.library import motion_names
from pb4u.options import Entry, described
from pb4u.run import BODY, MOST_GARMENTS, REST, Run, WornGarment
from pb4u.scene.moving_body import DEFAULT_FRAMES, DEFAULT_MOTION
from pb4u.simulation.models import default_model, model_descriptions
from pb4u.viewer.live_simulation import MOST_REFINING, MOST_TRIANGLES, Ending
from pb4u.viewer.panel import Panel, Tone, notice
from pb4u.viewer.touches import MOST_FRAMES
from pb4u.viewer.uploads import KINDS, MOST_BYTES
from pb4u.viewer.worker import plain_sentence

if TYPE_CHECKING:
    from viser import GuiApi, GuiUploadButtonHandle

_OWN = "its own"


def _controls(gui: Any, entries: Iterable[Entry], offered: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Controls of the fields that have a label in the form, by field.

    Each has the default, the help, the range and the choices of its field; what is `offered` of a field wins.
    """
    controls = {}
    for entry in entries:
        label, options = entry.flag.form, {"initial_value": entry.default, "hint": entry.help}
        if label is None:
            continue
        if entry.kind == "switch":
            add = gui.add_checkbox
        elif entry.choices or "options" in offered.get(entry.name, ()):
            add, options["options"] = gui.add_dropdown, entry.choices
        else:
            add, step = gui.add_number, 1 if entry.kind == "whole" else None
            options |= {"min": entry.flag.least, "max": entry.flag.most, "step": step}
        controls[entry.name] = add(label, **{**options, **offered.get(entry.name, {})})
    return controls


def _values(record: type, controls: Mapping[str, Any], find: Callable[[str, Any], Path | None]) -> dict[str, Any]:
    """What is filled into the controls of a record, by field; `find` gives the file of a field and name."""
    kinds = {name: entry.kind for name, entry in described(record).items()}
    values = {name: int(item.value) if kinds[name] == "whole" else item.value for name, item in controls.items()}
    return {name: find(name, value) or value for name, value in values.items()}


def _of_parts(text: str) -> dict[str, str]:
    """Materials by part, as they are written into a field."""
    pairs = [part.partition("=") for part in text.split(",") if part.strip()]
    if any(not part.strip() or not material.strip() for part, _, material in pairs):
        raise InputError(
            f"Fabrics of parts must be PART=MATERIAL, separated by commas, such as hem=denim, not {text!r}."
        )
    return {part.strip(): material.strip() for part, _, material in pairs}


class GarmentControls:
    """Controls of one garment.

    Args:
        gui: controls of one page.
        garments: names that can be chosen.
        number: of the garment, from 1 for the innermost.
        first: name that is filled in first.
    """

    def __init__(self, gui: GuiApi, garments: tuple[str, ...], number: int, first: str) -> None:
        self.folder = gui.add_folder(f"Garment {number}" + (", the innermost" if number == 1 else ""))
        offered: dict[str, dict[str, Any]] = {
            "garment": {"options": garments, "initial_value": first},
            "material": {"options": (_OWN, *material_names()), "initial_value": _OWN},
            "pins": {"options": (_OWN, *PIN_NAMES), "initial_value": _OWN},
            "triangles": {
                "initial_value": LEVELS["base"], "min": 0, "max": MOST_TRIANGLES, "step": 100,
                "hint": "0 for a file of your own: simulate its own mesh.",
            },
        }  # fmt: skip
        with self.folder:
            self.controls = _controls(gui, described(WornGarment).values(), offered)
            self.parts = gui.add_text(
                "Fabrics of parts", initial_value="",
                hint="PART=MATERIAL, separated by commas, such as hem=denim, collar=rib: a band along a border (hem, "
                "waist, cuff, collar, border), a panel of a pattern, or what a file calls a material.",
            )  # fmt: skip

    def specification(self, find: Callable[[str, str], Path | None]) -> WornGarment:
        """The garment from the form; `find` gives the file of a kind and name, if there is one.

        Args:
            find: gives the path of a file of a kind and name, or None.

        Raises:
            InputError: the fabrics of its parts have another format.
        """
        values = _values(WornGarment, self.controls, find)
        unset: dict[str, Any] = {name: None for name in ("material", "pins") if values[name] == _OWN}
        if parts := _of_parts(self.parts.value):
            unset["material"] = ({} if "material" in unset else {REST: values["material"]}) | parts
        return WornGarment(**{**values, **unset, "triangles": values["triangles"] or None})


class SimulationPanel(Panel):
    """Controls of a simulation: garments, body, motion, model, files of the user's own, and how far it is."""

    def _add_controls(self) -> None:
        gui = self._gui
        entries, models = described(Run).values(), model_descriptions()
        self._offered = {"garment": garment_names(), "body": body_names(), "motion": motion_names()}
        self._place = gui.add_folder(None)
        self._worn: list[GarmentControls] = []
        self._more = gui.add_button("Add a garment", hint="Worn over those that are there.")
        self._fewer = gui.add_button("Take off the last", visible=False)
        offered: dict[str, dict[str, Any]] = {
            "body": {"options": body_names()},
            "motion": {"options": motion_names(), "initial_value": DEFAULT_MOTION},
            "lead_in": {"initial_value": Run().led_frames, "max": MOST_FRAMES},
            "frames": {"initial_value": DEFAULT_FRAMES, "max": MOST_FRAMES},
            "model": {
                "options": tuple(models), "initial_value": default_model(),
                "hint": "; ".join(f"{name}: {line}" for name, line in models.items()),
            },
            "refine": {"max": MOST_REFINING},
        }  # fmt: skip
        self._controls = _controls(gui, [entry for entry in entries if entry.flag.panel == BODY], offered)
        with gui.add_folder("Files of your own", expand_by_default=False):
            for kind, accepted in KINDS.items():
                suffixes = accepted.suffixes + accepted.companions
                button = gui.add_upload_button(
                    f"Open a {kind}", mime_type=",".join(suffixes),
                    hint=f"{', '.join(suffixes)}, to {MOST_BYTES // 2**20} MB; it stays on the machine of the studio "
                    "and goes when this page is closed.",
                )  # fmt: skip
                button.on_upload(self._answer(partial(self._take, kind, button)))
        self._controls |= _controls(gui, [entry for entry in entries if entry.flag.panel != BODY], offered)
        self._start = gui.add_button("Simulate")
        self._stop = gui.add_button("Cancel", disabled=True)
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._status = gui.add_html("")
        self._save = gui.add_button("Save scene.toml", hint="For `pb4u simulate scene.toml`; with the files it names.")
        self._add_garment()
        self._more.on_click(self._answer(self._add_garment))
        self._fewer.on_click(self._answer(self._take_off))
        self._start.on_click(self._answer(self._simulate))
        self._stop.on_click(self._answer(self._window.cancel))
        self._save.on_click(self._answer(self._save_scene))

    def _add_garment(self) -> None:
        taken = [garment.controls["garment"].value for garment in self._worn]
        usual = str(WornGarment().garment)
        free = next((name for name in (usual, *self._offered["garment"]) if name not in taken), usual)
        with self._place:
            self._worn.append(GarmentControls(self._gui, self._offered["garment"], len(self._worn) + 1, free))
        self._show_counts()

    def _take_off(self) -> None:
        self._worn.pop().folder.remove()
        self._show_counts()

    def _show_counts(self) -> None:
        self._fewer.visible = len(self._worn) > 1
        self._more.visible = len(self._worn) < MOST_GARMENTS

    def _take(self, kind: str, button: GuiUploadButtonHandle) -> None:
        """Keep the file of a button, offer it and choose it: for the last garment, the body or the motion."""
        name = self._window.uploads.keep(kind, button.value.name, button.value.content)
        if self._window.uploads.find(kind, name) is None or Path(name).suffix.lower() in KINDS[kind].companions:
            self._status.content = notice(f"{name} is here; it is read with the file that it belongs to.")
            return
        self._offered[kind] = tuple(dict.fromkeys((*self._offered[kind], name)))
        holders = [garment.controls for garment in self._worn] if kind == "garment" else [self._controls]
        controls = [holder[kind] for holder in holders]
        for control in controls:
            chosen = control.value
            control.options = self._offered[kind]
            control.value = chosen
        controls[-1].value = name
        if kind == "garment":
            self._worn[-1].controls["triangles"].value = 0
        self._status.content = notice(f"{name} is here and chosen.", Tone.good)

    def run(self) -> Run:
        """The run that is filled in.

        Raises:
            InputError: that cannot be a run.
        """
        find = self._window.uploads.find
        garments = tuple(garment.specification(find) for garment in self._worn)
        return Run(garments, **_values(Run, self._controls, find))

    def _save_scene(self) -> None:
        self._status.content = notice(self._window.save_scene(self.run()), Tone.good)

    def _simulate(self) -> None:
        try:
            self._window.simulate(self.run())
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
        """Show that the simulation is being stopped."""
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
