"""One browser window: its state, its panels and the threads that work for it, all of which end with it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from pb4u.errors import InputError
from pb4u.run import Run
from pb4u.viewer.clip import Clip, GrowingClip
from pb4u.viewer.display import Display
from pb4u.viewer.export_panel import ExportPanel, deliver, pack_scene
from pb4u.viewer.film import Film, take_picture
from pb4u.viewer.live_simulation import Ending, LiveSimulation, require_offered
from pb4u.viewer.panel import Tone, notice
from pb4u.viewer.plot_panel import Measurement, PlotPanel
from pb4u.viewer.simulation_panel import SimulationPanel
from pb4u.viewer.touch_panel import TouchPanel
from pb4u.viewer.touches import Touches
from pb4u.viewer.uploads import Uploads, bound_uploads
from pb4u.viewer.view_panels import LookPanel, TimelinePanel
from pb4u.viewer.view_state import ViewState
from pb4u.viewer.worker import heard_warnings, plain_sentence

if TYPE_CHECKING:
    from viser import ClientHandle

_REVEAL_AFTER = 0.1
"""Seconds that a browser is given to read a painted frame when no other follows."""

_ASK_AGAIN = 0.004
"""Seconds between looks at whether the browser has kept up: a tenth of a frame at 25 frames per second."""

_AFTER_FAILURE = 0.5
"""Seconds until a page that could not be drawn is tried again, so that its user can read why."""


class BrowserWindow:
    """One browser window: handles the requests of its panels, receives frames of its simulation, and draws its page.

    Args:
        client: the window.
        clips: clips to show first.
        out: folder in which exports are also saved, or None.
    """

    def __init__(self, client: ClientHandle, clips: tuple[Clip, ...], out: Path | None = None) -> None:
        self._client, self._out = client, out
        self.state = ViewState()
        self.simulation: LiveSimulation | None = None
        self.touches = Touches()
        self.measurements: tuple[Measurement, ...] = ()
        # Guards what several threads change: state, simulation, measurements and, below, the film and a flag.
        self._lock = threading.RLock()
        self._camera_due = False
        self._film: Film | None = None
        #: Files of the user's own.
        self.uploads = Uploads()
        bound_uploads(client.gui, self.say)
        self._wake, self._closed = threading.Event(), threading.Event()
        # Of the thread of the page alone.
        self.display = Display(client, self._drag)
        self._add_panels(bool(clips))
        if clips:
            self._load(clips)
        self._thread = threading.Thread(target=self._run, name="pb4u page", daemon=True)
        self._thread.start()

    def _add_panels(self, showing: bool) -> None:
        gui = self._client.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(360)
        self._notice = gui.add_html("", visible=False)
        self.timeline_panel = TimelinePanel(gui, self)
        tabs = gui.add_tab_group()
        # Whoever has nothing to look at yet begins with simulating.
        first, second = (tabs.add_tab(name) for name in (("Look", "Simulate") if showing else ("Simulate", "Look")))
        with first if showing else second:
            self.look_panel = LookPanel(gui, self)
        with second if showing else first:
            self.simulation_panel = SimulationPanel(gui, self)
        with tabs.add_tab("Touch"):
            self.touch_panel = TouchPanel(gui, self)
        with tabs.add_tab("Plots"):
            self.plot_panel = PlotPanel(gui, self)
        with tabs.add_tab("Export"):
            self.export_panel = ExportPanel(gui, self)

    # What its panels ask for, from threads of the server.

    @property
    def closed(self) -> bool:
        """Whether the window is gone."""
        return self._closed.is_set()

    def say(self, sentence: str) -> None:
        """Show the user an error message.

        Args:
            sentence: the error message.
        """
        if not self.closed:
            self._client.add_notification(
                "pb4u", sentence, color="red", auto_close_seconds=12.0, with_close_button=True
            )
            # The notification goes by itself; what is written above the panels stays in sight.
            self._notice.content, self._notice.visible = notice(sentence, Tone.bad), True

    def change(self, action: Callable[[ViewState], None]) -> None:
        """Do something to the state, and show it.

        Args:
            action: changes the state.
        """
        with self._lock:
            action(self.state)
        self._wake.set()

    def reset_camera(self) -> None:
        """Point the camera at all clips again."""
        with self._lock:
            self._camera_due = True
        self._wake.set()

    def save_scene(self, run: Run) -> str:
        """Hand the user a scene file, packed with the files it names; returns a sentence that says so.

        Args:
            run: the run to describe.
        """
        require_offered(run, self.uploads.files)
        name, content = pack_scene(run, self.uploads.folder)
        self._client.send_file_download(name, content, save_immediately=True)
        return f"{name} was sent to the browser; run it with `pb4u simulate scene.toml`."

    def film(self, suffix: str) -> None:
        """Begin to take pictures of the current view.

        Args:
            suffix: ".png" for the frame that is shown, ".gif" or ".mp4" for all of them.

        Raises:
            InputError: there is nothing to show, or pictures are being taken.
            MissingExtraError: the format needs an extra.
        """
        with self._lock:
            if not self.state.clips:
                raise InputError("There is nothing to show yet; simulate something first.")
            if self._film is not None:
                raise InputError("Pictures are being taken; wait for them, or stop.")
            frames = [self.state.clock.frame] if suffix == ".png" else list(range(self.state.clock.frame_count))
            self._film = Film(suffix, frames, self.state.clips[0])
        self._wake.set()

    def stop_filming(self) -> None:
        """Stop taking pictures, and discard those taken."""
        with self._lock:
            if self._film is not None:
                self._film.stopped = True

    def simulate(self, run: Run) -> None:
        """Begin a simulation.

        Args:
            run: the run to simulate.

        Raises:
            InputError: another simulation is running, or the page does not offer this run.
        """
        require_offered(run, self.uploads.files)
        with self._lock:
            if self.simulation is not None and self.simulation.running:
                raise InputError("A simulation is running in this window; cancel it first.")
            self.touches.begin()
            self._begin(LiveSimulation(run, self._advanced, self._ended, self.uploads.files, self._speed, self.touches))

    def go_on(self) -> None:
        """Simulate on from the frame that is shown.

        Raises:
            InputError: it cannot be gone back to.
        """
        with self._lock:
            simulation, frame = self.simulation, self.state.clock.frame
            if simulation is None or not simulation.is_of(self.state.clips):
                raise InputError("The clip shown was not simulated on this page; simulate something first.")
            # The newest frame is followed again.
            self.state.clock.pause_at(self.state.clock.frame_count)
            if simulation.running:
                self.touches.go_back(frame)
            else:
                self._begin(simulation.resumed(frame))

    def _begin(self, simulation: LiveSimulation) -> None:
        self.simulation = simulation
        self.simulation_panel.began()
        simulation.start()

    def cancel(self) -> None:
        """End the simulation before its next step."""
        with self._lock:
            if self.simulation is not None and self.simulation.running:
                self.simulation_panel.stopping()
                self.simulation.cancel()

    def export(self, suffix: str, which: int) -> str:
        """Hand the user a clip as a file; returns a sentence that says so.

        Args:
            suffix: one of `pb4u.export.registry.WRITERS`.
            which: number of the clip, from 0.

        Raises:
            InputError: the clip cannot be written.
            MissingExtraError: the format needs an extra.
        """
        with self._lock:
            clips = self.state.clips
        if not clips:
            raise InputError("There is nothing to export yet; simulate something first.")
        remarks: list[str] = []
        with heard_warnings(remarks):
            name, content, path = deliver(clips[min(which, len(clips) - 1)], suffix, self._out, remarks.append)
        self._client.send_file_download(name, content, save_immediately=True)
        where = f" It is also kept as {path}." if path else ""
        handed = f"{name}, {len(content) / 1e6:.1f} MB, was handed to the browser.{where}"
        return " ".join([handed, *dict.fromkeys(remarks)])

    def _drag(self, phase: str, start: tuple[float, float, float], end: tuple[float, float, float]) -> None:
        """Pull at the cloth with the mouse, from the thread of the server that takes messages in."""
        with self._lock:
            simulation, state = self.simulation, self.state
            if simulation is None or simulation.live is None or not state.touchable:
                return
            try:
                if phase == "start":
                    self.touches.grab(simulation.live, state.clips[0], state.clock.frame, start, state.follow)
                if phase == "end":
                    self.touches.let_go()
                else:
                    self.touches.draw(end)
            except Exception as error:
                self.say(plain_sentence(error))
            state.hand = self.touches.held_at
        self._wake.set()

    # What the simulation tells, from its own thread.

    def _speed(self) -> float:
        """Seconds of the simulation that may pass in a second: as fast as it is played, while it is followed."""
        with self._lock:
            return self.state.clock.speed if self.state.follows_newest else math.inf

    def _advanced(self, clip: GrowingClip, done: int, total: int) -> None:
        """Show the newest frame while nobody has looked elsewhere."""
        if self.closed:
            return
        if clip.frame_count:
            with self._lock:
                simulation = self.simulation
                newest = self.state.follows_newest
                if self.state.clips != (clip,):
                    goes_on, newest = bool(self.state.clips) and self.state.clips[0].label == clip.label, True
                    self._load((clip,), camera=not goes_on)
                    self.touch_panel.offer(None if simulation is None else simulation.live)
                self.state.touchable = simulation is not None and simulation.can_be_touched
                self.state.grow()
                if newest:
                    self.state.clock.seek(clip.frame_count - 1)
            self._wake.set()
        self.simulation_panel.progress(done, total)

    def _ended(self, clip: GrowingClip | None, sentence: str, ending: Ending) -> None:
        """Play what there is from the start, and measure it."""
        if self.closed:
            return
        with self._lock:
            self.state.touchable, self.state.hand = False, None
        if clip is not None and clip.frame_count:
            with self._lock:
                if self.state.clips == (clip,):
                    newest = self.state.follows_newest
                    self.state.grow()
                    if newest:
                        self.state.clock.seek(0)
                        self.state.clock.play()
                    self._measure((clip,))
            self._wake.set()
        self.simulation_panel.ended(sentence, ending)
        if ending is Ending.failed:
            self.say(sentence)

    def _load(self, clips: tuple[Clip, ...], camera: bool = True) -> None:
        """Show other clips, and measure them where no frame is still to come; with the camera on them or as it is."""
        with self._lock:
            self.state.load(clips)
            self._camera_due |= camera
            self._measure(() if any(isinstance(clip, GrowingClip) for clip in clips) else clips)
            self.export_panel.offer(len(clips))
        self._wake.set()

    def _measure(self, clips: tuple[Clip, ...]) -> None:
        """Measure these clips in place of others."""
        for measurement in self.measurements:
            measurement.cancel()
        self.measurements = tuple(Measurement(clip) for clip in clips)
        for measurement in self.measurements:
            measurement.start()

    # The page itself: one thread alone touches the scene.

    def close(self, timeout: float = 0.0) -> bool:
        """End all work for this window; true when every thread has ended within `timeout` [s].

        Args:
            timeout: seconds to wait.
        """
        self._closed.set()
        self._wake.set()
        self.display.close()
        with self._lock:
            workers = [worker for worker in (self.simulation, *self.measurements) if worker is not None]
        for worker in workers:
            worker.cancel()
        until = time.monotonic() + timeout
        self._thread.join(max(until - time.monotonic(), 0.0))
        ended = [worker.join(max(until - time.monotonic(), 0.0)) for worker in workers]
        self.uploads.close()
        return all(ended) and not self._thread.is_alive()

    def _run(self) -> None:
        while not self.closed:
            try:
                wait = self._update()
            except Exception as error:
                if self.closed:
                    return
                self.say(plain_sentence(error))
                wait = _AFTER_FAILURE
            self._wake.wait(wait)
            self._wake.clear()

    def _update(self) -> float:
        """Bring the page up to date; returns seconds until it has to be looked after again."""
        if not self.display.ready:
            return _ASK_AGAIN
        with self._lock:
            film = self._film
        if film is not None:
            self._shoot(film)
        with self._lock:
            state, measurements = self.state.frozen(), self.measurements
            camera, self._camera_due = self._camera_due, False
        self.display.update(state)
        self.look_panel.explain(self.display.looks)
        if camera and state.clips:
            self.display.frame_camera(state.follow)
        self.timeline_panel.refresh(state)
        self.plot_panel.refresh(measurements, state.clock.frame)
        return min(state.clock.wait, _REVEAL_AFTER) if self.display.waits else state.clock.wait

    def _shoot(self, film: Film) -> None:
        """Take the pictures of a film, frame by frame, and hand it to the browser."""
        sentence = ""
        try:
            for number, frame in enumerate(film.frames):
                if self.closed or film.stopped:
                    return
                self.export_panel.filming(number, len(film.frames))
                with self._lock:
                    state = self.state.frozen()
                if state.clips[:1] != (film.clip,):
                    raise InputError("Another clip is shown now; the pictures were discarded.")
                state.clock.pause_at(frame)
                self.display.settle(state, lambda: self.closed)
                film.pictures.append(take_picture(self._client))
            name, content, remark = film.developed()
            self._client.send_file_download(name, content, save_immediately=True)
            sentence = f"{name}, {len(content) / 1e6:.1f} MB, was handed to the browser." + (
                f" It {remark}" if remark else ""
            )
        finally:
            # Before it is told, so that whoever reads that may begin another.
            with self._lock:
                self._film = None
            if not self.closed:
                self.export_panel.filmed(sentence)
