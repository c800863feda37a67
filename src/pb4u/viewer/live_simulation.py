"""A simulation that a page started: frames as they are computed, and an end at any time."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from enum import Enum
from pathlib import Path

from pb4u.body.library import body_names
from pb4u.errors import InputError, unknown_name
from pb4u.garment.library import garment_names
from pb4u.garment.material import material_names
from pb4u.motion.library import motion_names
from pb4u.run import Run
from pb4u.scene.assembly import build_scene
from pb4u.simulation.models import model_descriptions, simulator_of
from pb4u.simulation.simulator import RunRecord
from pb4u.viewer.clip import GrowingClip
from pb4u.viewer.worker import Worker, heard_warnings, plain_sentence

LEAST_TRIANGLES, MOST_TRIANGLES = 400, 40_000
"""Twice the fewest that a built-in garment can be cut into, and just above the finest level of detail."""

MOST_FRAMES = 600
"""20 s at 30 frames per second; at the most triangles about half a gigabyte, all of which is held in memory."""

MOST_REFINING = 100
"""Iterations a step: twenty times what a network is given unless told otherwise."""


def require_offered(run: Run, files: Collection[Path] = ()) -> None:
    """Refuse what the page does not offer: it is not trusted, so it names what is built in or what it handed over.

    Args:
        run: what a page asked for.
        files: files that it handed over.

    Raises:
        InputError: a name that is not built in, or a number out of range.
    """
    named: list[tuple[str, object, tuple[str, ...]]] = [
        ("body", run.body, body_names()),
        ("motion", run.motion, motion_names()),
        ("model", run.model, ("auto", *model_descriptions())),
    ]
    counts: list[tuple[str, int | None, int, int]] = [
        ("frames", run.frames, 1, MOST_FRAMES),
        ("lead-in frames", run.led_frames, 0, MOST_FRAMES),
        ("refining iterations", run.refine, 0, MOST_REFINING),
    ]
    for worn in run.garments:
        named.append(("garment", worn.garment, garment_names()))
        named += [("material", material, material_names()) for material in worn.materials.values()]
        # A file may keep its own mesh; how large that is shows when it is read.
        count = worn.triangles if worn.garment in files else worn.triangles or 0
        counts.append(("triangles", count, LEAST_TRIANGLES, MOST_TRIANGLES))
    for what, name, known in named:
        if name is not None and name not in known and not (isinstance(name, Path) and name in files):
            raise unknown_name(what, str(name), known)
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
    """One run, ended between two steps when it is cancelled.

    Args:
        run: what is simulated, and how.
        advanced: called with the clip so far, the steps done and the steps in all, both with the lead-in, after every
            step and every frame, in the thread that computes.
        ended: called at the end with the clip, or None where it could not begin, how it ended in words, and how.
        files: files that the page handed over.
    """

    def __init__(
        self,
        run: Run,
        advanced: Callable[[GrowingClip, int, int], None],
        ended: Callable[[GrowingClip | None, str, Ending], None],
        files: Collection[Path] = (),
    ) -> None:
        super().__init__("live simulation")
        self._specification, self._advanced, self._ended = run, advanced, ended
        self._files = frozenset(files)
        self._clip: GrowingClip | None = None
        self._frames = run.frames or 0

    def _work(self) -> None:
        told: list[str] = []
        try:
            with heard_warnings(told):
                sentence, ending = self._simulate()
        except _Cancelled:
            there = 0 if self._clip is None else self._clip.frame_count
            sentence, ending = f"Cancelled; {there} of {self._frames} frames are there.", Ending.cancelled
        except Exception as error:
            sentence, ending = plain_sentence(error), Ending.failed
        self._ended(self._clip, " ".join([sentence, *dict.fromkeys(told)]), ending)

    def _simulate(self) -> tuple[str, Ending]:
        run = self._specification
        require_offered(run, self._files)
        simulator = simulator_of(run)
        self._end_if_cancelled()
        scene = build_scene(replace(run, fps=simulator.fps or run.fps))
        for worn in scene.garments:
            if (count := worn.garment.triangle_count) > MOST_TRIANGLES:
                raise InputError(
                    f"{worn.garment.name} has {count:,} triangles, and {MOST_TRIANGLES:,} are the most here; ask for "
                    "fewer."
                )
        self._end_if_cancelled()
        label = f"{scene.labels['garment']}, {scene.labels['motion']}, {simulator.name}"
        self._frames = scene.frames
        self._clip = clip = GrowingClip(simulator.header(scene), scene.frames, label)

        def stepped(done: int, total: int) -> None:
            # Called between two steps, lead-in included: the place to stop without leaving a half-made frame.
            self._end_if_cancelled()
            self._advanced(clip, done, total)

        record = RunRecord()
        for frame in simulator.written_frames(scene, record, stepped):
            clip.append(frame)
            self._advanced(clip, scene.lead_in + clip.frame_count, scene.total_frames)
        if record.failed_at is not None and not clip.frame_count:
            return str(record.lost_early()), Ending.failed
        if record.failed_at is not None:
            return (
                f"The state stopped being finite at frame {record.failed_at}; {clip.frame_count} frames are there. "
                "Try the solver, or more refining iterations.",
                Ending.failed,
            )
        return f"{clip.frame_count} frames of {label}; {record.ms_per_step:,.0f} ms a step.", Ending.finished

    def _end_if_cancelled(self) -> None:
        if self._cancelled.is_set():
            raise _Cancelled
