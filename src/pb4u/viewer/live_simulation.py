"""A simulation that a page started: frames as they are computed, and an end at any time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection
from dataclasses import replace
from enum import Enum
from pathlib import Path

from pb4u.body.library import body_names
from pb4u.errors import InputError, unknown_name
from pb4u.garment.library import garment_names
from pb4u.garment.material import material_names
from pb4u.motion.library import motion_names
from pb4u.physics.time_step import DivergedError
from pb4u.run import Run
from pb4u.scene.assembly import build_scene
from pb4u.simulation.live_run import LiveRun
from pb4u.simulation.models import model_descriptions, simulator_of
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.stepwise_simulator import StepwiseSimulator
from pb4u.viewer.clip import Clip, GrowingClip
from pb4u.viewer.touches import MOST_FRAMES, Touches
from pb4u.viewer.worker import Worker, heard_warnings, plain_sentence

LEAST_TRIANGLES, MOST_TRIANGLES = 400, 40_000
"""Twice the fewest that a built-in garment can be cut into, and just above the finest level of detail."""

MOST_REFINING = 100
"""Iterations a step: twenty times what a network is given unless told otherwise."""


def require_offered(run: Run, files: Collection[Path] = ()) -> None:
    """Refuse inputs that the page does not offer: since a page is not trusted, it may name only built-in assets and its
    own uploads.

    Args:
        run: the run requested by a page.
        files: files that it handed over.

    Raises:
        InputError: a name that is not built in, or a number out of range.
    """
    choices: list[tuple[str, object, tuple[str, ...]]] = [
        ("body", run.body, body_names()),
        ("motion", run.motion, motion_names()),
        ("model", run.model, ("auto", *model_descriptions())),
    ]
    counts: list[tuple[str, int | None, int, int]] = [
        ("frames", run.frames, 1, MOST_FRAMES),
        ("lead-in frames", run.led_frames, 0, MOST_FRAMES),
        ("refining iterations", run.refine, 0, MOST_REFINING),
    ]
    for spec in run.garments:
        choices.append(("garment", spec.garment, garment_names()))
        choices += [("material", material, material_names()) for material in spec.materials.values()]
        # A file may keep its own mesh; how large that is shows when it is read.
        count = spec.triangles if spec.garment in files else spec.triangles or 0
        counts.append(("triangles", count, LEAST_TRIANGLES, MOST_TRIANGLES))
    for what, name, offered in choices:
        if name is not None and name not in offered and not (isinstance(name, Path) and name in files):
            raise unknown_name(what, str(name), offered)
    for what, number, least, most in counts:
        if number is not None and not least <= number <= most:
            raise InputError(f"The number of {what} must lie between {least:,} and {most:,}, not {number:,}.")


class Ending(Enum):
    """The ways in which a simulation ends."""

    finished = "finished"
    cancelled = "cancelled"
    failed = "failed"


class _Cancelled(Exception):
    pass


class LiveSimulation(Worker):
    """One run, which can be cancelled between two steps and touched from the page.

    Args:
        run: the run to simulate.
        advanced: called with the clip so far, the finished and the total steps, both with the lead-in, after every
            step and every frame, in the thread that computes.
        ended: called at the end with the clip (None if it could not begin), a sentence on how it ended, and its
            `Ending`.
        files: files that the page handed over.
        speed: called after every frame; returns the largest number of simulated seconds per second.
        touches: what the page does to the cloth.
    """

    def __init__(
        self,
        run: Run,
        advanced: Callable[[GrowingClip, int, int], None],
        ended: Callable[[GrowingClip | None, str, Ending], None],
        files: Collection[Path] = (),
        speed: Callable[[], float] = lambda: math.inf,
        touches: Touches | None = None,
    ) -> None:
        super().__init__("live simulation")
        self._specification, self._advanced, self._ended = run, advanced, ended
        self._files, self._speed = frozenset(files), speed
        self.touches = touches or Touches()
        self._clip: GrowingClip | None = None
        self._live: LiveRun | None = None
        self._frames = run.frames or 0

    @property
    def live(self) -> LiveRun | None:
        """The run that can be touched; None before it begins, and if its steps cannot be touched."""
        return self._live

    @property
    def can_be_touched(self) -> bool:
        """Whether it computes, and its cloth feels a hand."""
        return self.running and self._live is not None and self._live.feels

    def is_of(self, clips: tuple[Clip, ...]) -> bool:
        """Whether it computes the shown clip.

        Args:
            clips: that are shown.
        """
        return clips == (self._clip,)

    def resumed(self, frame: int) -> LiveSimulation:
        """A simulation that continues from a frame of this one, which has ended, and includes its frames.

        Args:
            frame: number of the frame.

        Raises:
            InputError: it cannot be gone back to.
        """
        if self._live is None or not self._live.written_count:
            raise InputError("There is no simulation to continue; simulate something first.")
        if frame >= self._live.scene.frames - 1 and not self.touches.endless:
            raise InputError("This is the last frame; choose an earlier one, or continue after the last frame.")
        other = LiveSimulation(self._specification, self._advanced, self._ended, self._files, self._speed, self.touches)
        other._clip, other._live, other._frames = self._clip, self._live, self._frames
        self.touches.go_back(frame)
        return other

    def _work(self) -> None:
        warnings: list[str] = []
        try:
            with heard_warnings(warnings):
                sentence, ending = self._simulate() if self._live is None else self._touched(self._live)
        except _Cancelled:
            there = 0 if self._clip is None else self._clip.frame_count
            sentence, ending = f"Cancelled; {there} of {self._frames} frames are there.", Ending.cancelled
        except Exception as error:
            sentence, ending = plain_sentence(error), Ending.failed
        self.touches.let_go()
        self._ended(self._clip, " ".join([sentence, *dict.fromkeys(warnings)]), ending)

    def _simulate(self) -> tuple[str, Ending]:
        run = self._specification
        require_offered(run, self._files)
        simulator = simulator_of(run)
        self._end_if_cancelled()
        scene = build_scene(replace(run, fps=simulator.fps or run.fps))
        for entry in scene.garments:
            if (count := entry.garment.triangle_count) > MOST_TRIANGLES:
                raise InputError(
                    f"{entry.garment.name} has {count:,} triangles; the studio simulates at most {MOST_TRIANGLES:,}: "
                    "ask for fewer."
                )
        self._end_if_cancelled()
        label = f"{scene.labels['garment']}, {scene.labels['motion']}, {simulator.name}"
        self._frames = scene.frames
        self._clip = clip = GrowingClip(simulator.header(scene), MOST_FRAMES, label)
        if isinstance(simulator, StepwiseSimulator) and not simulator.on_card:
            self._live = LiveRun(simulator, scene, RunRecord())
            return self._touched(self._live)

        def stepped(done: int, total: int) -> None:
            # Called between two steps, lead-in included: the place to stop without leaving a half-made frame.
            self._end_if_cancelled()
            self._advanced(clip, done, total)

        record = RunRecord()
        for frame in simulator.written_frames(scene, record, stepped):
            clip.append(frame)
            self._advanced(clip, scene.lead_in + clip.frame_count, scene.total_frames)
        return self._told(clip, record)

    def _touched(self, live: LiveRun) -> tuple[str, Ending]:
        """Take the steps of a run that the page may touch between any two."""
        assert self._clip is not None, "a run that can be touched has a clip"
        touches, total, live.record.failed_at = self.touches, live.scene.total_frames, None
        while True:
            self._end_if_cancelled()
            self._clip = touches.before_a_step(live, self._clip)
            if live.written_count == MOST_FRAMES or (live.frame + 1 >= total and not touches.endless):
                return self._told(self._clip, live.record)
            began = time.perf_counter()
            try:
                frame = live.advance(touches.of_step(live, self._clip))
            except DivergedError:
                live.record.failed_at = live.frame + 1 - live.scene.lead_in
                return self._told(self._clip, live.record)
            if frame is not None:
                self._clip.append(frame)
            self._advanced(self._clip, live.frame + 1, max(total, live.frame + 1))
            if frame is not None:
                # No faster than it is watched.
                self._cancelled.wait(max(began + live.scene.dt / self._speed() - time.perf_counter(), 0.0))

    @staticmethod
    def _told(clip: GrowingClip, record: RunRecord) -> tuple[str, Ending]:
        """How a simulation ended that was not cancelled, in words."""
        if record.failed_at is not None and not clip.frame_count:
            return str(record.lost_early()), Ending.failed
        if record.failed_at is not None:
            return (
                f"The state stopped being finite at frame {record.failed_at}; {clip.frame_count} frames are there. "
                "Try the solver, or more refining iterations.",
                Ending.failed,
            )
        return f"{clip.frame_count} frames of {clip.label}; {record.ms_per_step:,.0f} ms a step.", Ending.finished

    def _end_if_cancelled(self) -> None:
        if self._cancelled.is_set():
            raise _Cancelled
