"""Plans the clips of a dataset from its runs, and estimates the space on the disk that they take."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import cache, lru_cache
from pathlib import Path

from pb4u.body.body_model import ShapedBody
from pb4u.body.character import Character
from pb4u.compat.garment_dictionary import read_dictionary_garment
from pb4u.compat.recording_as_released import RecordingAsItIs
from pb4u.errors import InputError
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.garment_file import read_source
from pb4u.garment.library import LEVELS, SEWN
from pb4u.garment.material import MATERIALS
from pb4u.jobs.job import JobPack
from pb4u.measures.job_planner import JobPlanner
from pb4u.measures.run_job import MOST_TOGETHER, RunJob
from pb4u.motion.library import load_motion, motion_names
from pb4u.pattern.dressing import DEFAULT_TRIANGLES
from pb4u.pattern.files import read_dressed
from pb4u.run import Run, WornGarment
from pb4u.scene.moving_body import DEFAULT_FRAMES, load_body_of
from pb4u.simulation.models import simulator_of
from pb4u.simulation.stepwise_simulator import NetworkSimulator

_RECORD_BYTES = (6_000, 700)
"""Bytes of a clip's record, and more for each frame: some fifteen series of numbers as text."""


def plan_clips(runs: Sequence[Run], half: bool, say: Callable[[str], None]) -> tuple[RunJob, ...]:
    """The clips of the runs, each once.

    Args:
        runs: runs that a jobs file describes.
        half: whether trajectories are kept in half precision.
        say: called with a sentence if some runs are equal.

    Raises:
        InputError: a name or a file that a run needs does not exist, or its model does not support the options.
    """
    planner, jobs = JobPlanner(), []
    for number, run in enumerate(runs, start=1):
        try:
            jobs.append(planner.job(run, keep="half" if half else "full"))
        except InputError as error:
            raise InputError(f"clip {number} ({_named(run)}): {error}") from None
    unique = {job.key: job for job in jobs}
    if len(unique) < len(jobs):
        say(f"{len(jobs) - len(unique)} of {len(jobs)} clips are described twice; each is made once.")
    return tuple(unique.values())


def together(jobs: Sequence[RunJob]) -> list[RunJob | JobPack]:
    """The clips in packs, where a GPU computes whole steps: a pack needs no more kernel launches than one clip.

    Args:
        jobs: the clips.
    """

    @cache
    def on_card(options: Run) -> bool:
        simulator = simulator_of(options)
        return isinstance(simulator, NetworkSimulator) and simulator.on_card

    alike: dict[object, list[RunJob]] = {}
    for job in jobs:
        packs = job.device == "cuda" and on_card(job.run.options)
        alike.setdefault((job.run.options, job.weights) if packs else job, []).append(job)
    batches: list[RunJob | JobPack] = []
    for group in alike.values():
        chunks = (tuple(group[first : first + MOST_TOGETHER]) for first in range(0, len(group), MOST_TOGETHER))
        batches += [chunk[0] if len(chunk) == 1 else JobPack(chunk) for chunk in chunks]
    return batches


def _named(run: Run) -> str:
    """Entries that describe a clip, defaults left out: for the message where it cannot be planned."""
    garments = (" in ".join((garment.name, *map(str, garment.materials.values()))) for garment in run.garments)
    others = {name: getattr(run, name) for name in ("body", "motion", "crop", "clip", "model", "seed")}
    changes = (f"{name} = {value}" for name, value in others.items() if value != getattr(Run(), name))
    return ", ".join(["+".join(garments), *changes])


def footprints(jobs: Iterable[RunJob]) -> list[int]:
    """Bytes that each of the clips takes on the disk, from its counts of frames, triangles and vertices.

    Args:
        jobs: the clips.
    """
    body = lru_cache(maxsize=64)(_body_counts)
    triangles = lru_cache(maxsize=None)(_garment_triangles)
    recorded = lru_cache(maxsize=None)(_recorded_frames)
    sizes = []
    for job in jobs:
        scene = job.run
        points, corners, own_frames = body(
            scene.body and str(scene.body),
            scene.clip,
            scene.body_parts,
            scene.body_units,
            scene.motion is None,
            scene.fps,
            scene.recorded_fps,
        )
        frames = scene.frames
        if frames is None:
            moves = None if scene.motion is None else str(scene.motion)
            how = (scene.fps, scene.recorded_fps, scene.as_recorded)
            frames = own_frames or recorded(moves, scene.crop, *how) or DEFAULT_FRAMES
        frames += scene.led_frames if scene.keep_lead_in else 0
        faces = [garment.triangles or triangles(garment) for garment in scene.garments]
        # A sheet has half as many vertices as triangles, and half as many more as its borders have edges.
        vertices = sum(count / 2 + 1.2 * count**0.5 for count in faces)
        number = 2 if job.keep == "half" else 4
        moving = frames * 3 * number * (2 * vertices + points)
        # Corners of panels that lie flat, their UVs and their layers of cloth come on top.
        still = (130 if scene.rest_shape == "flat" else 24) * sum(faces) + 17 * vertices + 24 * corners + points + 14000
        sizes.append(round(moving + still + _RECORD_BYTES[0] + _RECORD_BYTES[1] * frames))
    return sizes


def _body_counts(
    name: str | None,
    clip: str | None,
    parts: str | None,
    units: str | None,
    alone: bool,
    fps: float,
    recorded_fps: float | None,
) -> tuple[int, int, int | None]:
    """Vertices and faces of a body, and its frames where it moves by itself: a character does without a motion."""
    if name is None:
        return 0, 0, None
    body, frames = load_body_of(name, clip, parts, units), None
    if isinstance(body, Character):
        frames = body.available_frames(fps) if alone and body.clip is not None else None
    elif not isinstance(body, ShapedBody) and body.frame_count > 1:
        frames = (body if recorded_fps is None else body.recorded_at(recorded_fps)).resampled(fps).frame_count
    return len(body.contact), len(body.faces), frames


def _garment_triangles(garment: WornGarment) -> int:
    name = garment.garment
    assert isinstance(name, str | Path)
    entry = DictionaryEntry.parse(name)
    if entry is not None:
        return read_dictionary_garment(entry, MATERIALS["default"]).triangle_count
    file = Path(name)
    if not file.suffix:
        return LEVELS["base"]
    if file.suffix.lower() in SEWN:
        return len(read_dressed(file)[0].faces) if file.suffix.lower() == ".npz" else DEFAULT_TRIANGLES
    return sum(len(polygon) - 2 for polygon in read_source(file).polygons)


def _recorded_frames(
    motion: str | None, crop: tuple[int, int] | None, fps: float, recorded_fps: float | None, as_recorded: bool
) -> int | None:
    """Frames of a recording at a rate; None of a clip without an end."""
    if motion is None or motion in motion_names():
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warned of again where the clip is made
        if as_recorded:
            return RecordingAsItIs(Path(motion), crop).available_frames(fps)
        return load_motion(motion, crop, recorded_fps=recorded_fps).available_frames(fps)
