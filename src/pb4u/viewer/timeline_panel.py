"""Frame, time, play and pause, speed, loop and single steps."""

from __future__ import annotations

import time
from html import escape
from typing import TYPE_CHECKING

from pb4u.viewer.notice import Tone, notice
from pb4u.viewer.page_event import guarded
from pb4u.viewer.playback_clock import SPEEDS

if TYPE_CHECKING:
    from viser import GuiApi

    from pb4u.viewer.session import Session


class TimelinePanel:
    """Frame, time, play and pause, speed, loop and single steps."""

    _EVERY = 0.08

    def __init__(self, gui: GuiApi, session: Session) -> None:
        self._session, self._last, self._count = session, 0.0, -1
        self._caption = gui.add_html(_caption("No trajectory yet: choose one under Simulate.", "", []))
        self._slider = gui.add_slider("Frame", 0, 1, 1, 0, disabled=True)
        self._play = gui.add_button("Play", disabled=True)
        self._step = gui.add_button_group("Step", ("first", "- 1", "+ 1", "last"))
        self._speed = gui.add_dropdown("Speed", [f"{speed:g} x" for speed in SPEEDS], initial_value="1 x")
        self._loop = gui.add_checkbox("Loop", True)
        for handle, action in (
            (self._slider, self._seek), (self._speed, self._set_speed), (self._loop, self._set_loop),
        ):  # fmt: skip
            handle.on_update(guarded(session, action))
        self._play.on_click(guarded(session, self._toggle))
        self._step.on_click(guarded(session, self._go))

    def _seek(self) -> None:
        frame = int(self._slider.value)
        self._session.change(lambda state: state.clock.pause_at(frame))

    def _toggle(self) -> None:
        self._session.change(lambda state: state.clock.pause() if state.clock.playing else state.clock.play())

    def _go(self) -> None:
        steps = {"- 1": -1, "+ 1": 1}
        asked = self._step.value
        if asked in steps:
            self._session.change(lambda state: state.clock.step(steps[asked]))
        else:
            target = 0 if asked == "first" else 10**9
            self._session.change(lambda state: state.clock.pause_at(target))

    def _set_speed(self) -> None:
        speed = float(self._speed.value.split()[0])
        self._session.change(lambda state: setattr(state.clock, "speed", speed))

    def _set_loop(self) -> None:
        loop = bool(self._loop.value)
        self._session.change(lambda state: setattr(state.clock, "loop", loop))

    def refresh(self, playing: bool) -> None:
        """Caption, slider and button; not at every frame while playing, which nobody could read."""
        now = time.monotonic()
        if playing and now - self._last < self._EVERY:
            return
        self._last = now
        state = self._session.state
        clips, frame, count = state.clips, state.clock.frame, state.clock.frame_count
        if not clips or not count:
            return
        if count != self._count:
            self._count = count
            self._slider.value = min(int(self._slider.value), max(count - 1, 0))  # type: ignore[misc]
            self._slider.max = max(count - 1, 1)
            self._slider.disabled = self._play.disabled = count < 2
        self._slider.value = frame  # type: ignore[misc]
        label = "Pause" if playing else "Play"
        if self._play.label != label:
            self._play.label = label
        what = " | ".join(f"{clip.label} ({len(clip.header.faces):,} triangles)" for clip in clips)
        when = f"frame {frame} of {count - 1}, {state.clock.seconds:.2f} s"
        self._caption.content = _caption(what, when, state.held(frame))


def _caption(what: str, when: str, held: list[str]) -> str:
    marks = "".join(notice(sentence, Tone.bad) for sentence in held)
    return (
        f"<div data-caption style='padding:6px 12px 2px;line-height:1.35'><div style='font-weight:600;font-size:0.9em'>"
        f"{escape(what)}</div><div style='font-size:0.85em;color:#667085;font-variant-numeric:tabular-nums'>"
        f"{escape(when)}</div></div>{marks}"
    )
