"""A simulation that a page started: frames as they are computed, and an end at any time."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Protocol

from pb4u.body.library import body_names
from pb4u.errors import InputError
from pb4u.garment.library import garment_names
from pb4u.garment.material import material_names
from pb4u.motion.library import motion_names
from pb4u.scene.assembly import make_scene
from pb4u.simulation.models import load_simulator, model_descriptions
from pb4u.simulation.simulator import RunRecord
from pb4u.viewer.clip import GrowingClip
from pb4u.viewer.plain_sentence import plain_sentence

LEAST_TRIANGLES, MOST_TRIANGLES = 400, 40_000
MOST_FRAMES = 600


@dataclass(frozen=True)
class SimulationRequest:
    """What to simulate, in the words of `pb4u simulate`; only names that are built in, since it comes from a page."""

    garment: str = "tshirt"
    body: str = "woman"
    motion: str = "walk"
    material: str = "default"
    model: str = "solver"
    triangles: int = 2500
    frames: int = 60
    lead_in: int = 30
    refine: int = 5

    def check(self) -> None:
        """Raises InputError naming what cannot be simulated."""
        for what, chosen, known in (
            ("garment", self.garment, garment_names()),
            ("body", self.body, body_names()),
            ("motion", self.motion, motion_names()),
            ("material", self.material, material_names()),
            ("model", self.model, tuple(model_descriptions())),
        ):
            if chosen not in known:
                raise InputError(f"There is no {what} {chosen!r}; there are {', '.join(known)}.")
        for what, number, least, most in (
            ("triangles", self.triangles, LEAST_TRIANGLES, MOST_TRIANGLES),
            ("frames", self.frames, 1, MOST_FRAMES),
            ("lead-in frames", self.lead_in, 0, MOST_FRAMES),
            ("refining iterations", self.refine, 0, 100),
        ):
            if not least <= number <= most:
                raise InputError(f"The number of {what} must lie between {least:,} and {most:,}, not {number:,}.")

    @property
    def label(self) -> str:
        """What the page calls the result."""
        return f"{self.garment}, {self.motion}, {self.model}"


class Listener(Protocol):
    """Hears from a simulation, in the thread that computes it."""

    def simulation_started(self, clip: GrowingClip) -> None:
        """Everything is loaded; the clip has no frame yet."""

    def simulation_advanced(self, clip: GrowingClip | None, done: int, total: int) -> None:
        """Another step is done, lead-in included; the clip may hold another frame."""

    def simulation_ended(self, clip: GrowingClip | None, sentence: str, well: bool) -> None:
        """It is over: how, in one sentence, and whether it came to its end."""


class _Cancelled(Exception):
    pass


class LiveSimulation:
    """One run in a thread of its own, ended between two steps when it is cancelled."""

    def __init__(self, request: SimulationRequest, listener: Listener) -> None:
        self._request, self._listener = request, listener
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pb4u live simulation", daemon=True)
        self._clip: GrowingClip | None = None

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def cancel(self) -> None:
        """End before the next step; what was simulated stays."""
        self._cancelled.set()

    @property
    def running(self) -> bool:
        """Whether it still computes."""
        return self._thread.is_alive()

    def join(self, timeout: float) -> bool:
        """Wait; true when it has ended."""
        self._thread.join(timeout)
        return not self.running

    def _run(self) -> None:
        well = False
        try:
            sentence, well = self._simulate()
        except _Cancelled:
            sentence = f"Cancelled; {self._done} of {self._request.frames} frames are there."
        except Exception as error:
            sentence = plain_sentence(error)
        self._listener.simulation_ended(self._clip, sentence, well)

    @property
    def _done(self) -> int:
        return 0 if self._clip is None else self._clip.frame_count

    def _simulate(self) -> tuple[str, bool]:
        request = self._request
        request.check()
        simulator = load_simulator(request.model, refine=request.refine)
        self._end_if_cancelled()
        scene = make_scene(
            request.garment, request.body, request.motion, triangles=request.triangles, material=request.material,
            frames=request.frames, lead_in=request.lead_in, fps=simulator.fps or 30.0,
        )  # fmt: skip
        self._end_if_cancelled()
        clip = GrowingClip(simulator.header(scene), scene.frames, request.label)
        self._clip = clip
        self._listener.simulation_started(clip)

        def stepped(done: int, total: int) -> None:
            # Called between two steps, lead-in included: the place to stop without leaving a half-made frame.
            self._end_if_cancelled()
            self._listener.simulation_advanced(clip, done, total)

        record = RunRecord()
        for frame in simulator.written_frames(scene, record, stepped):
            clip.append(frame)
            self._listener.simulation_advanced(clip, scene.lead_in + clip.frame_count, scene.total_frames)
        if record.failed_at is not None:
            return (
                f"The state stopped being finite at frame {record.failed_at}; {clip.frame_count} frames are there. "
                "Try the solver, or more refining iterations.",
                False,
            )
        return f"{clip.frame_count} frames of {request.label}; {record.ms_per_step:,.0f} ms a step.", True

    def _end_if_cancelled(self) -> None:
        if self._cancelled.is_set():
            raise _Cancelled
