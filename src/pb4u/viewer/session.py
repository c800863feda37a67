"""One browser window: its state, its panels and the threads that work for it, all of which end with it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from pb4u.errors import InputError
from pb4u.viewer.clip import Clip, GrowingClip
from pb4u.viewer.echo import Echo
from pb4u.viewer.live_simulation import LiveSimulation, SimulationRequest
from pb4u.viewer.measurement import Measurement
from pb4u.viewer.overlay import OVERLAYS, Overlay
from pb4u.viewer.panels import Panels
from pb4u.viewer.plain_sentence import plain_sentence
from pb4u.viewer.stage import Stage
from pb4u.viewer.view_state import SHADED, ViewState

if TYPE_CHECKING:
    from viser import ClientHandle

_REVEAL_AFTER = 0.1
"""Seconds that a browser is given to read a painted frame when no other follows."""

_ASK_AGAIN = 0.004
"""Seconds between looks at whether the browser has kept up."""


class Session:
    """Everything of one window.

    Args:
        client: the window.
        clips: what it shows first.
        out: folder that exports are kept in as well, or None.
    """

    def __init__(self, client: ClientHandle, clips: tuple[Clip, ...], out: Path | None = None) -> None:
        self._client, self.out = client, out
        self.state = ViewState()
        self.simulation: LiveSimulation | None = None
        self.measurements: tuple[Measurement, ...] = ()
        self.frames_sent = 0
        self._lock = threading.RLock()
        self._wake, self._closed = threading.Event(), threading.Event()
        self._watching_live = False
        self._camera_due = False
        self._shown: object = None
        self._painted: str | None = None
        self._stage = Stage(client)
        self._echo = Echo(client)
        self.panels = Panels(client.gui, self, bool(clips))
        if clips:
            self.load(clips)
        self._thread = threading.Thread(target=self._run, name="pb4u page", daemon=True)
        self._thread.start()

    # What a window may ask for; each is called from the threads of its panels.

    def load(self, clips: tuple[Clip, ...]) -> None:
        """Show other clips, and measure those that are complete."""
        with self._lock:
            self.state.load(clips)
            self._camera_due = True
            self._shown = self._painted = None
            for measurement in self.measurements:
                measurement.cancel()
            complete = () if any(isinstance(clip, GrowingClip) for clip in clips) else clips
            self.measurements = tuple(Measurement(clip, self.panels.plot.stale) for clip in complete)
            self.panels.export.offer(len(clips))
        self._wake.set()

    def change(self, action: Callable[[ViewState], None]) -> None:
        """Do something to the state, and show it."""
        with self._lock:
            self._watching_live = False
            action(self.state)
            self._shown = None
        self._wake.set()

    def reset_camera(self) -> None:
        """Look at everything again."""
        with self._lock:
            self._camera_due = True
        self._wake.set()

    def simulate(self, request: SimulationRequest) -> None:
        """Begin a simulation. Raises InputError while another runs, or when the request cannot be met."""
        request.check()
        with self._lock:
            if self.simulation is not None and self.simulation.running:
                raise InputError("A simulation is running in this window; cancel it first.")
            self.simulation = LiveSimulation(request, self)
            self.simulation.start()

    def cancel(self) -> None:
        """End the simulation before its next step."""
        with self._lock:
            if self.simulation is not None:
                self.simulation.cancel()

    def say(self, sentence: str) -> None:
        """Tell the window what went wrong."""
        if not self._closed.is_set():
            self._client.add_notification(
                "pb4u", sentence, color="red", auto_close_seconds=12.0, with_close_button=True
            )
            self.panels.say(sentence)

    def download(self, name: str, content: bytes) -> None:
        """Hand the window a file."""
        self._client.send_file_download(name, content, save_immediately=True)

    # What the simulation tells, from its own thread.

    def simulation_started(self, clip: GrowingClip) -> None:
        """Make room for the clip; it is shown with its first frame."""

    def simulation_advanced(self, clip: GrowingClip | None, done: int, total: int) -> None:
        """Show the newest frame while nobody has looked elsewhere."""
        if self._closed.is_set():
            return
        if clip is not None and clip.frame_count:
            with self._lock:
                if self.state.clips != (clip,):
                    self.load((clip,))
                    self._watching_live = True
                self.state.grow()
                if self._watching_live:
                    self.state.clock.seek(clip.frame_count - 1)
            self._wake.set()
        self.panels.simulation.progress(done, total)

    def simulation_ended(self, clip: GrowingClip | None, sentence: str, well: bool) -> None:
        """Play what there is from the start, and measure it."""
        if self._closed.is_set():
            return
        if clip is not None and clip.frame_count:
            with self._lock:
                if self.state.clips == (clip,):
                    self.state.grow()
                    if self._watching_live:
                        self._watching_live = False
                        self.state.clock.seek(0)
                        self.state.clock.play()
                    self.measurements = (Measurement(clip, self.panels.plot.stale),)
            self._wake.set()
        self.panels.simulation.ended(sentence, well)
        if not well and not sentence.startswith("Cancelled"):
            self.say(sentence)

    # The page itself: one thread alone touches the scene.

    def close(self, timeout: float = 0.0) -> bool:
        """End all work for this window; true when every thread has ended within `timeout` seconds."""
        self._closed.set()
        self._wake.set()
        self._echo.close()
        with self._lock:
            simulation, measurements = self.simulation, self.measurements
        threads: list[Callable[[float], bool]] = []
        for worker in (simulation, *measurements):
            if worker is not None:
                worker.cancel()
                threads.append(worker.join)
        until = time.monotonic() + timeout
        self._thread.join(max(until - time.monotonic(), 0.0))
        ended = [join(max(until - time.monotonic(), 0.0)) for join in threads]
        return all(ended) and not self._thread.is_alive()

    @property
    def frames_shown(self) -> int:
        """Frames that the browser has taken in."""
        return self._echo.answers

    @property
    def closed(self) -> bool:
        """Whether the window is gone."""
        return self._closed.is_set()

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                wait = self._tick()
            except Exception as error:
                if self._closed.is_set():
                    return
                self.say(plain_sentence(error))
                wait = 0.5
            self._wake.wait(wait)
            self._wake.clear()

    def _tick(self) -> float:
        """Bring the page up to date; returns seconds until it has to be looked after again."""
        if not self._echo.ready:
            return _ASK_AGAIN
        with self._lock:
            clips, frame, overlay = self.state.clips, self.state.clock.frame, self.state.overlay
            body, follow, shadows = self.state.body, self.state.follow, self.state.shadows
            camera = self._camera_due
            frames = [self.state.frame_of(clip, frame) for clip in clips]
            wanted, wait, playing = (
                (clips, frame, overlay, body, follow),
                self.state.clock.wait,
                self.state.clock.playing,
            )
            fresh = wanted != self._shown
            self._shown, self._camera_due = wanted, False
        if fresh and clips and all(clip.frame_count for clip in clips):
            if tuple(figure.clip for figure in self._stage.figures) != clips:
                self._stage.set_up(clips)
                self._painted = SHADED
            looks = self._paint(clips, overlay)
            with self._client.atomic():
                self._stage.show(frames, body, follow)
            self.frames_sent += 1
            self._echo.ask()
            if looks is not None:
                self.panels.look.explain(looks)
        elif self._stage.waits:
            with self._client.atomic():
                self._stage.reveal()
        self._stage.cast_shadows(shadows)
        if camera and clips:
            self._stage.frame_camera(follow)
        self.panels.refresh(playing)
        return min(wait, _REVEAL_AFTER) if self._stage.waits else wait

    def _paint(self, clips: tuple[Clip, ...], name: str) -> tuple[Overlay, ...] | None:
        """Change the overlay where another is wanted; what cannot be painted is said, and shown shaded."""
        if name == self._painted:
            return None
        self._painted = name
        try:
            looks = tuple(OVERLAYS[name](clip) for clip in clips)
            for look in looks:
                if look.painted:
                    look.colours(0)
        except Exception as error:
            self.say(plain_sentence(error))
            looks = tuple(OVERLAYS[SHADED](clip) for clip in clips)
        for figure, look in zip(self._stage.figures, looks, strict=True):
            figure.look(look)
        return looks
