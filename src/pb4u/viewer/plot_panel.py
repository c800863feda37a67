"""Energies and strains over the frames, measured in the background."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from pb4u.viewer.chart import Chart
from pb4u.viewer.measurement import QUANTITIES
from pb4u.viewer.notice import notice
from pb4u.viewer.page_event import guarded

if TYPE_CHECKING:
    from viser import GuiApi

    from pb4u.viewer.session import Session


class PlotPanel:
    """Energies and strains over the frames, measured in the background."""

    _EVERY = 0.2

    def __init__(self, gui: GuiApi, session: Session) -> None:
        self._session, self._last, self._stale, self._drawn = session, 0.0, False, -1
        self._names = {line: name for name, line in QUANTITIES.items()}
        self._quantity = gui.add_dropdown("Quantity", list(self._names), initial_value=QUANTITIES["stretch"])
        self._chart = Chart(gui, gui.add_folder(None))
        self._status = gui.add_html("")
        self._quantity.on_update(guarded(session, self.stale))

    def stale(self) -> None:
        """Something new was measured, or another quantity is asked for."""
        self._stale = True

    def refresh(self, playing: bool) -> None:
        """Redraw where values or the frame have changed."""
        state, now = self._session.state, time.monotonic()
        measured, frame = self._session.measurements, state.clock.frame
        if not measured or now - self._last < self._EVERY or not (self._stale or frame != self._drawn):
            return
        self._last, self._stale, self._drawn = now, False, frame
        quantity = self._names.get(self._quantity.value, "stretch")
        length = max(len(m.series(quantity)) for m in measured)
        curves = [np.pad(m.series(quantity), (0, length - len(m.series(quantity))), constant_values=np.nan)
                  for m in measured]  # fmt: skip
        self._chart.draw(QUANTITIES[quantity], tuple(m.clip.label for m in measured), curves, float(frame))
        failures = [m.failure for m in measured if m.failure]
        done, total = sum(m.done for m in measured), sum(m.clip.frame_count for m in measured)
        text = failures[0] if failures else "" if done >= total else f"Measured {done} of {total} frames."
        self._status.content = notice(text) if text else ""
