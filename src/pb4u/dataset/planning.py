"""From runs to the clips to make, and what they take. What can be refused is refused here, before any work."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.compat.garment_dictionary import read_dictionary_garment
from pb4u.dataset.clip import ClipJob
from pb4u.errors import InputError, unknown_name
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.garment_file import read_source
from pb4u.garment.library import LEVELS, garment_names
from pb4u.garment.material import MATERIALS, load_material
from pb4u.jobs.job import digest
from pb4u.motion.library import load_motion, motion_names
from pb4u.run import Run, WornGarment, with_companions
from pb4u.scene.assembly import DEFAULT_FRAMES, DEFAULT_MOTION
from pb4u.simulation.models import default_model, simulator_of

_SECONDS_A_FRAME = {
    "skinning": (0.05, 0.05), "solver": (0.15, 0.35), "quick-solver": (0.08, 0.15),
}  # fmt: skip
"""Seconds on one core that a frame takes at 0 triangles, and more for each 2,500: a first guess, measured once on a
server's core; clips that are done replace it."""
_NETWORK_SECONDS = (0.15, 0.3)
_SECONDS_A_CLIP = 2.5
"""Seconds in which a scene is made: the garment cut and meshed, the body posed."""
_RECORD_BYTES = (6_000, 700)
"""Bytes of a clip's record, and more for each frame: some fifteen series of numbers as text."""


class Footprint(NamedTuple):
    """What a clip takes.

    Args:
        size: bytes on the disk.
        seconds: time of one worker [s], by the figures of the package.
    """

    size: int
    seconds: float


def plan_clips(runs: Sequence[Run], half: bool, say: Callable[[str], None]) -> tuple[ClipJob, ...]:
    """The clips of the runs, each once.

    Args:
        runs: what a jobs file describes.
        half: whether trajectories are kept in half precision.
        say: takes a sentence where runs are the same.

    Raises:
        InputError: a name or a file that a run needs is not there, or its model cannot be had so.
    """
    contents: dict[str, tuple[tuple[str, str, str], ...]] = {}
    checked: set[tuple[str, str]] = set()
    models: dict[Run, tuple[str, str, str | None]] = {}
    jobs = []
    has_bones = lru_cache(maxsize=None)(_has_bones)
    for number, run in enumerate(runs, start=1):
        try:
            _require_names(run, checked)
            options = run.options
            if options not in models:
                models[options] = _resolved(run)
        except InputError as error:
            raise InputError(f"clip {number} ({ClipJob(run)}): {error}") from None
        model, device, weights = models[options]
        given = {"model": model, "device": device}
        if run.motion is None and has_bones(str(run.body)):
            # Named, so that its label says what the body performs.
            given["motion"] = DEFAULT_MOTION
        resolved = run.with_entries(given)
        named = dict.fromkeys(str(value) for value in resolved.files if isinstance(value, str | Path))
        for value in named:
            if value not in contents:
                contents[value] = _content(value)
        jobs.append(ClipJob(resolved, half, tuple(row for value in named for row in contents[value]), weights))
    unique = {job.key: job for job in jobs}
    if len(unique) < len(jobs):
        say(f"{len(jobs) - len(unique)} of {len(jobs)} clips are described twice; each is made once.")
    return tuple(unique.values())


def _require_names(scene: Run, checked: set[tuple[str, str]]) -> None:
    """Refuse names and files that are not there; `checked` holds those that are."""
    known = {"garment": garment_names(), "motion": motion_names(), "material": tuple(MATERIALS)}
    worn = [(kind, getattr(each, kind)) for each in scene.garments for kind in ("garment", "material")]
    for kind, value in [*worn, ("motion", scene.motion), ("body", scene.body), ("omitted", scene.omitted)]:
        if value is None or (kind, str(value)) in checked or not isinstance(value, str | Path):
            continue
        checked.add((kind, str(value)))
        entry = DictionaryEntry.parse(value) if kind in ("garment", "motion") else None
        file = Path(value) if entry is None else entry.path
        if file.suffix and not file.exists():
            raise InputError(f"There is no {kind} file {file}.")
        if kind == "body":
            load_body(value)
        elif kind == "material":
            load_material(value)
        elif not file.suffix and kind in known and str(value) not in known[kind]:
            raise unknown_name(kind, str(value), known[kind])


def _has_bones(body: str) -> bool:
    return isinstance(load_body(body), ShapedBody)


def _resolved(run: Run) -> tuple[str, str, str | None]:
    """Model by name or file, device, and the digest of a network's weights."""
    from pb4u.simulation.checkpoint import weights_file
    from pb4u.simulation.stepwise_simulator import NetworkSimulator

    simulator = simulator_of(run)
    model = default_model() if str(run.model) == "auto" else str(run.model)
    device = "cuda" if str(simulator.settings().get("device")) == "cuda" else "cpu"
    if not isinstance(simulator, NetworkSimulator):
        return model, device, None
    with weights_file(model) as path:
        return model, device, digest(path)


def _content(value: str) -> tuple[tuple[str, str, str], ...]:
    """The files that are read for a value, with their digests; none for a name."""
    entry = DictionaryEntry.parse(value)
    file = Path(value) if entry is None else entry.path
    if (not file.suffix and "/" not in value) or not file.exists():
        return ()
    return tuple((value, str(each), digest(each)) for each in with_companions(file))


def footprints(jobs: Iterable[ClipJob]) -> list[Footprint]:
    """What each of the clips takes, from its counts of frames, triangles and vertices.

    Args:
        jobs: the clips.
    """
    body = lru_cache(maxsize=64)(_body_counts)
    triangles = lru_cache(maxsize=None)(_garment_triangles)
    recorded = lru_cache(maxsize=None)(_recorded_frames)
    told = []
    for job in jobs:
        scene = job.run
        points, corners, own_frames = body(str(scene.body))
        frames = scene.frames
        if frames is None:
            moves = None if scene.motion is None else str(scene.motion)
            frames = own_frames or recorded(moves, scene.crop, scene.fps) or DEFAULT_FRAMES
        frames += scene.lead_in if scene.keep_lead_in else 0
        faces = [each.triangles or triangles(each) for each in scene.garments]
        # A sheet has half as many vertices as triangles, and half as many more as its borders have edges.
        vertices = sum(count / 2 + 1.2 * count**0.5 for count in faces)
        number = 2 if job.half else 4
        moving = frames * 3 * number * (2 * vertices + points)
        still = 24 * sum(faces) + 17 * vertices + 24 * corners + points + 8000
        size = moving + still + _RECORD_BYTES[0] + _RECORD_BYTES[1] * frames
        model = str(job.run.model)
        base, more = _SECONDS_A_FRAME.get(model, _NETWORK_SECONDS)
        simulated = frames + (0 if scene.keep_lead_in else scene.lead_in)
        seconds = _SECONDS_A_CLIP + simulated * (base + more * sum(faces) / LEVELS["base"])
        told.append(Footprint(round(size), seconds))
    return told


def _body_counts(name: str) -> tuple[int, int, int | None]:
    """Vertices and faces of a body, and its frames where it moves by itself."""
    body = load_body(name)
    moves = not isinstance(body, ShapedBody) and body.frame_count > 1
    return len(body.contact), len(body.faces), body.frame_count if moves else None  # type: ignore[union-attr]


def _garment_triangles(garment: WornGarment) -> int:
    name = garment.garment
    assert isinstance(name, str | Path)
    entry = DictionaryEntry.parse(name)
    if entry is not None:
        return read_dictionary_garment(entry, MATERIALS["default"]).triangle_count
    if not Path(name).suffix:
        return LEVELS["base"]
    return sum(len(polygon) - 2 for polygon in read_source(Path(name)).polygons)


def _recorded_frames(motion: str | None, crop: tuple[int, int] | None, fps: float) -> int | None:
    """Frames of a recording at a rate; None of a clip without an end."""
    if motion is None or motion in motion_names():
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # told again where the clip is made
        return load_motion(motion, crop).available_frames(fps)


def expected_seconds(
    missing: Sequence[tuple[ClipJob, Footprint]], done: Sequence[tuple[Footprint, Mapping[str, Any]]], workers: int
) -> float:
    """Time that clips take [s], corrected by the time that those took that are done.

    Args:
        missing: the clips to make.
        done: records of those made before.
        workers: how many make them.
    """
    guessed = sum(footprint.seconds for footprint, _ in done)
    correction = sum(float(record["seconds"]) for _, record in done) / guessed if guessed else 1.0
    return correction * sum(footprint.seconds for _, footprint in missing) / max(1, min(workers, len(missing)))
