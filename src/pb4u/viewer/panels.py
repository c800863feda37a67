"""The controls of one window: timeline, look, simulation, plots and export."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pb4u.viewer.export_panel import ExportPanel
from pb4u.viewer.look_panel import LookPanel
from pb4u.viewer.notice import Tone, notice
from pb4u.viewer.plot_panel import PlotPanel
from pb4u.viewer.simulation_panel import SimulationPanel
from pb4u.viewer.timeline_panel import TimelinePanel

if TYPE_CHECKING:
    from viser import GuiApi

    from pb4u.viewer.session import Session


class Panels:
    """All panels of one window."""

    def __init__(self, gui: GuiApi, session: Session, showing: bool) -> None:
        self._gui, self._session = gui, session
        gui.main_panel.dock_right()
        gui.main_panel.set_width(360)
        self._notice = gui.add_html("", visible=False)
        self.timeline = TimelinePanel(gui, session)
        tabs = gui.add_tab_group()
        # Whoever has nothing to look at yet begins with simulating.
        look, simulate = ("Look", "Simulate") if showing else ("Simulate", "Look")
        first, second = tabs.add_tab(look), tabs.add_tab(simulate)
        with first if showing else second:
            self.look = LookPanel(gui, session)
        with second if showing else first:
            self.simulation = SimulationPanel(gui, session)
        with tabs.add_tab("Plots"):
            self.plot = PlotPanel(gui, session)
        with tabs.add_tab("Export"):
            self.export = ExportPanel(gui, session)

    def say(self, sentence: str) -> None:
        """Keep what went wrong in sight."""
        self._notice.content = notice(sentence, Tone.bad)
        self._notice.visible = True

    def refresh(self, playing: bool) -> None:
        """Bring numbers and plots up to the frame that is shown."""
        self.timeline.refresh(playing)
        self.plot.refresh(playing)
