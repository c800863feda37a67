"""Any export format, for download and, where the studio was given a folder, kept there too."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pb4u.export.registry import WRITERS
from pb4u.viewer.delivery import deliver
from pb4u.viewer.notice import Tone, notice
from pb4u.viewer.page_event import guarded

if TYPE_CHECKING:
    from viser import GuiApi

    from pb4u.viewer.session import Session


class ExportPanel:
    """Any export format, for download and, where the studio was given a folder, kept there too."""

    def __init__(self, gui: GuiApi, session: Session) -> None:
        self._session = session
        self._format = gui.add_dropdown("Format", list(WRITERS), initial_value=".npz")
        self._which = gui.add_dropdown("Trajectory", ("left", "right"), visible=False)
        self._go = gui.add_button("Export")
        self._status = gui.add_html("")
        self._go.on_click(guarded(session, self._export))

    def _export(self) -> None:
        clips = self._session.state.clips
        if not clips:
            self._session.say("There is nothing to export yet; simulate something first.")
            return
        clip = clips[-1] if self._which.value == "right" and len(clips) > 1 else clips[0]
        self._go.disabled = True
        self._status.content = notice(f"Writing {self._format.value}.")
        try:
            name, content, kept = deliver(clip, self._format.value, self._session.out)
            self._session.download(name, content)
            where = f" It is also kept as {kept}." if kept else ""
            text = f"{name}, {len(content) / 1e6:.1f} MB, was handed to the browser.{where}"
            self._status.content = notice(text, Tone.good)
        except Exception:
            self._status.content = ""
            raise
        finally:
            self._go.disabled = False

    def offer(self, clips: int) -> None:
        """Ask which one where there are two."""
        self._which.visible = clips > 1
