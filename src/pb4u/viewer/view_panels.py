"""The panels that decide what is seen: which frame, and how the cloth and the scene look."""

from __future__ import annotations

import time
from functools import partial
from html import escape
from typing import Any

from pb4u.viewer.overlay import OVERLAYS, Overlay
from pb4u.viewer.panel import Panel, Tone, notice
from pb4u.viewer.view_state import SHADED, SPEEDS, ViewState


class TimelinePanel(Panel):
    """Frame, time, play and pause, speed, loop and single steps."""

    _EVERY = 0.08
    """Seconds between updates while playing: nobody can read a number that changes more often."""

    def _add_controls(self) -> None:
        gui = self._gui
        self._last, self._count = 0.0, -1
        self._caption = gui.add_html(_caption("No trajectory yet: choose one under Simulate.", "", ()))
        self._slider = gui.add_slider("Frame", 0, 1, 1, 0, disabled=True)
        self._play = gui.add_button("Play", disabled=True)
        self._step = gui.add_button_group("Step", ("first", "- 1", "+ 1", "last"))
        speed = gui.add_dropdown("Speed", [f"{speed:g} x" for speed in SPEEDS], initial_value="1 x")
        loop = gui.add_checkbox("Loop", True)
        self._sets(self._slider, lambda state, frame: state.clock.pause_at(int(frame)))
        self._sets(speed, lambda state, text: setattr(state.clock, "speed", float(text.split()[0])))
        self._sets(loop, lambda state, value: setattr(state.clock, "loop", bool(value)))
        self._play.on_click(self._answer(lambda: self._window.change(lambda state: state.clock.toggle())))
        self._step.on_click(self._stepped)

    async def _stepped(self, event: Any) -> None:
        # Awaited where messages come in: by the time a thread reads it, the value may be that of the next click.
        self._answer(partial(self._go, self._step.value))(event)

    def _go(self, key: str) -> None:
        match key:
            case "first":
                self._window.change(lambda state: state.clock.pause_at(0))
            case "last":
                self._window.change(lambda state: state.clock.pause_at(state.clock.frame_count))
            case step:
                self._window.change(lambda state: state.clock.step(1 if step == "+ 1" else -1))

    def refresh(self, state: ViewState) -> None:
        """Bring caption, slider and button up to the frame that is shown.

        Args:
            state: positions and velocities.
        """
        now, clock = time.monotonic(), state.clock
        frame, count, playing = clock.frame, clock.frame_count, clock.playing
        if (playing and now - self._last < self._EVERY) or not count:
            return
        self._last = now
        if count != self._count:
            self._count = count
            self._slider.value = min(int(self._slider.value), max(count - 1, 0))  # type: ignore[misc]
            self._slider.max = max(count - 1, 1)
            self._slider.disabled = self._play.disabled = count < 2
        self._slider.value = frame  # type: ignore[misc]
        label = "Pause" if playing else "Play"
        if self._play.label != label:
            self._play.label = label
        what = " | ".join(f"{clip.label} ({len(clip.header.faces):,} triangles)" for clip in state.clips)
        when = f"frame {frame} of {count - 1}, {clock.seconds:.2f} s"
        self._caption.content = _caption(what, when, state.held(frame))


def _caption(what: str, when: str, remarks: tuple[str, ...]) -> str:
    marks = "".join(notice(sentence, Tone.bad) for sentence in remarks)
    return (
        f"<div data-caption style='padding:6px 12px 2px;line-height:1.35'><div style='font-weight:600;font-size:0.9em'>"
        f"{escape(what)}</div><div style='font-size:0.85em;color:#667085;font-variant-numeric:tabular-nums'>"
        f"{escape(when)}</div></div>{marks}"
    )


class LookPanel(Panel):
    """Controls of the overlays on the cloth, and of the objects in the scene."""

    def _add_controls(self) -> None:
        gui = self._gui
        usual = ViewState()
        self._explained: tuple[Overlay, ...] = ()
        overlay = gui.add_dropdown("Overlay", list(OVERLAYS), initial_value=usual.overlay)
        self._legend = gui.add_html("", visible=False)
        body = gui.add_checkbox("Body", usual.body)
        follow = gui.add_checkbox("Follow the body", usual.follow)
        shadows = gui.add_checkbox("Shadows", usual.shadows, hint="For computers with a graphics card.")
        camera = gui.add_button("Reset the view")
        self._sets(overlay, lambda state, name: setattr(state, "overlay", name if name in OVERLAYS else SHADED))
        self._sets(body, lambda state, shown: setattr(state, "body", bool(shown)))
        # The camera has to be moved as well, since the scene is elsewhere when the view follows.
        self._sets(follow, lambda state, value: setattr(state, "follow", bool(value)), then=self._window.reset_camera)
        self._sets(shadows, lambda state, cast: setattr(state, "shadows", bool(cast)))
        camera.on_click(self._answer(self._window.reset_camera))

    def explain(self, looks: tuple[Overlay, ...]) -> None:
        """Write the legend of the overlay.

        Args:
            looks: the overlay of each clip, all of one kind.
        """
        if looks is self._explained:
            return
        self._explained = looks
        scale = looks[0].scale if looks else None
        self._legend.visible = scale is not None
        if scale is not None:
            self._legend.content = scale.legend(tuple(note for look in looks for note in look.notes))
