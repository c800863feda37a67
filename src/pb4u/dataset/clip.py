"""One clip of a dataset: its address, its simulation, its metrics and the bytes of its trajectory."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pb4u import __version__
from pb4u.errors import InputWarning, Pb4uError
from pb4u.jobs.job import Failure, Job, address, attempted, require_content
from pb4u.run import Run, WornGarment

# torch and all that needs it is imported where it is used: a worker sets its number of threads before.
if TYPE_CHECKING:
    from pb4u.simulation.simulator import Simulator

DATASET_VERSION = 1
"""Raised when a clip or its measuring comes to mean something else, so that no older one is taken for it."""


@dataclass(frozen=True)
class ClipJob(Job):
    """A clip to be made.

    Args:
        run: what is simulated, model and device by name.
        half: whether the trajectory is kept in half precision.
        contents: (value in `run`, file that is read for it, SHA-256 of the file); a clip belongs to the content of its
            files, not to their place.
        weights: SHA-256 of a network's weights; None for what has none.
    """

    run: Run
    half: bool = False
    contents: tuple[tuple[str, str, str], ...] = ()
    weights: str | None = None

    @cached_property
    def key(self) -> str:
        files: dict[str, list[str]] = {}
        for value, file, content in self.contents:
            files.setdefault(value, []).append(f"{Path(file).name} {content}")
        identity = {
            "dataset_version": DATASET_VERSION,
            "pb4u": __version__,
            "run": _plain(self.run, files),
            "weights": self.weights,
            "half": self.half,
        }
        return address(identity)

    @property
    def device(self) -> str:
        return self.run.device

    @property
    def labels(self) -> dict[str, Any]:
        """What the clip was asked to be, as JSON: names as they are in the jobs file."""
        scene, names = self.run, {value: Path(file).stem for value, file, _ in reversed(self.contents)}

        def named(value: object) -> str | None:
            return None if value is None else names.get(str(value), str(value))

        return {
            "garment": "+".join(each.name for each in scene.garments),
            "material": "+".join(named(each.material) or "default" for each in scene.garments),
            "pins": "+".join(named(each.pins) or "own" for each in scene.garments),
            "triangles_asked": [each.triangles for each in scene.garments],
            "body": named(scene.body),
            "body_shape": dict(scene.body_shape),
            "motion": named(scene.motion) or "own",
            "seed": scene.seed,
            "fps": scene.fps,
            "lead_in": scene.lead_in,
            "frames_asked": scene.frames,
            "crop": None if scene.crop is None else list(scene.crop),
            "arms_away": scene.arms_away,
            "model": named(self.run.model),
            "refine": self.run.refine,
            "contact": self.run.contact,
            "self_contact": self.run.self_contact,
            "first_frame": self.run.first_frame,
            "device": self.run.device,
            "half": self.half,
        }

    def __str__(self) -> str:
        told = self.labels
        return f"{told['garment']} in {told['material']} on {told['body']}, {told['motion']}, seed {told['seed']}"


@dataclass(frozen=True)
class Clip:
    """A clip that was made.

    Args:
        record: labels, counts, timing and metrics, as JSON but for numbers that are not finite.
        trajectory: the bytes of its .npz.
    """

    record: dict[str, Any]
    trajectory: bytes


def attempt(job: ClipJob) -> Clip | Failure:
    """Make a clip; whatever goes wrong comes back as a `Failure` with a sentence."""
    return attempted(make, job)


def make(job: ClipJob) -> Clip:
    """Simulate, measure and encode.

    Args:
        job: the clip to make.

    Raises:
        InputError: something of it cannot be used, or changed since it was planned.
        Pb4uError: the state stopped being finite before the first frame to write.
    """
    from pb4u.measures.run_report import run_report
    from pb4u.simulation.run_simulation import roll_out, scene_for
    from pb4u.simulation.simulator import RunRecord

    began = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", InputWarning)
        for _, file, expected in job.contents:
            require_content(Path(file), expected)
        simulator = _simulator(job.run.options)
        scene = scene_for(job.run, simulator)
        record = RunRecord()
        try:
            trajectory = roll_out(job.run, simulator, scene, record=record)
        except Pb4uError as error:
            if record.failed_at is None:
                raise
            raise Pb4uError("The state stopped being finite before the first frame to write.") from error
    report = run_report(trajectory, simulator, scene, record)
    notes = list(dict.fromkeys([*report.pop("notes"), *(str(each.message) for each in caught)]))
    report["solver_iterations"] = sum(report["solver_iterations"])
    for measured, described in zip(report["garments"], trajectory.header.garments, strict=True):
        measured |= {
            "vertices": described["vertices"][1] - described["vertices"][0],
            "triangles": described["triangles"][1] - described["triangles"][0],
            **described["material"],
        }
    content = trajectory.encode(job.half)
    return Clip(
        {
            **job.labels,
            **{name: value for name, value in report.items() if name not in job.labels},
            "failed_at": record.failed_at,
            "notes": notes,
            "bytes": len(content),
            "seconds": time.perf_counter() - began,
        },
        content,
    )


@lru_cache(maxsize=1)
def _simulator(options: Run) -> Simulator:
    """The simulator of the options; clips mostly share one, whose weights need not be read for each."""
    from pb4u.simulation.models import simulator_of

    return simulator_of(options)


def _plain(specification: object, files: Mapping[str, list[str]]) -> Any:
    """A specification as JSON, files by their names and contents."""
    if isinstance(specification, Run | WornGarment):
        return {each.name: _plain(getattr(specification, each.name), files) for each in fields(specification)}
    if isinstance(specification, tuple):
        return [_plain(each, files) for each in specification]
    if isinstance(specification, str | Path):
        return files.get(str(specification), str(specification))
    return specification
