"""A run as a job: its address, its simulation, its metrics, and what is kept of its trajectory."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from pb4u import __version__
from pb4u.environment import Environment
from pb4u.errors import Pb4uError, noted
from pb4u.jobs.job import Failure, JobPack, Made, address, attempted, require_content
from pb4u.jobs.job_folder import FOLDER_VERSION
from pb4u.options import NONE, described
from pb4u.run import Run, WornGarment

# torch and all that needs it is imported where it is used: a worker sets its number of threads before.
if TYPE_CHECKING:
    from pb4u.measures.excess import Reference
    from pb4u.scene.scene import Scene
    from pb4u.scene.state import State
    from pb4u.scene.trajectory import Trajectory
    from pb4u.simulation.simulator import RunRecord, Simulator
    from pb4u.simulation.stepwise_simulator import NetworkSimulator

MOST_TOGETHER = 16
"""Clips simulated together at most: so many are lost where a run is killed."""

PICTURED = 0.6
"""Where in the clip, as a fraction of its length, the frame to draw lies: by then every motion is under way."""


class Simulated(NamedTuple):
    """A scene, its states and their computing times."""

    scene: Scene
    states: list[State]
    record: RunRecord


@dataclass(frozen=True)
class RunJob:
    """A run to be simulated and measured.

    Args:
        run: to simulate, with model and device by name.
        label: name of its model in tables.
        contents: (value in `run`, file that is read for it, SHA-256 of the file); a result depends on the content of
            its files, not on their paths.
        weights: SHA-256 of a network's weights; None for a model without weights.
        keep: part of the trajectory to keep: all in full or "half" precision, or "stills": the frame at `PICTURED`, and
            the worst.
        excess: also measure what single steps leave on states shared by all models, and the distance from the solver's
            rollout; costs two solves a frame for each scene.
    """

    run: Run
    label: str = ""
    contents: tuple[tuple[str, str, str], ...] = ()
    weights: str | None = None
    keep: Literal["full", "half", "stills"] = "full"
    excess: bool = False

    @cached_property
    def key(self) -> str:
        """Address of the result: the same for the same work, another for any other."""
        files: dict[str, list[str]] = {}
        for value, file, content in self.contents:
            # Of the value, what is beyond its own file is kept: a garment, level or person in it.
            entry = "" if value in files else entry_of(value, file)
            files.setdefault(value, []).append(f"{Path(file).name}{entry} {content}")
        identity = {
            "version": FOLDER_VERSION,
            "pb4u": __version__,
            "run": _plain(replace(self.run, lead_in=self.run.led_frames), files),
            "weights": self.weights,
            "keep": self.keep,
            "excess": self.excess,
        }
        return address(identity)

    @property
    def device(self) -> str:
        """Where it computes: "cpu" or "cuda"."""
        return self.run.device

    @property
    def labels(self) -> dict[str, Any]:
        """Options of the run as JSON: names as they were given, files by their stem and what is named in them."""
        return self.labelled({})

    def labelled(self, titles: Mapping[str, str]) -> dict[str, Any]:
        """The labels, some files by another title.

        Args:
            titles: value in `run` -> its title.
        """
        run = self.run
        stems = {value: Path(file).stem + entry_of(value, file) for value, file, _ in reversed(self.contents)}
        names = {**stems, **titles}

        def named(value: object) -> str | None:
            if isinstance(value, Mapping):
                return ",".join(f"{part}:{named(item)}" for part, item in value.items())
            return None if value is None else names.get(str(value), str(value))

        labels: dict[str, Any] = {}
        for name, entry in described(WornGarment).items():
            values = [getattr(garment, name) for garment in run.garments]
            if entry.kind == "name":
                unset = "default" if name == "material" else "own"
                labels[entry.label] = "+".join(named(value) or unset for value in values)
            else:
                labels[entry.label] = [_plain(value, {}) for value in values]
        for entry in described(Run).values():
            value = entry.value_in(run)
            labels[entry.label] = named(value) if entry.flag.is_file else _plain(value, {})
        labels |= {
            "garment": "+".join(titles.get(str(garment.garment), garment.name) for garment in run.garments),
            "body": named(run.body) or NONE,
            "motion": named(run.motion) or run.clip or ("own" if run.body else NONE),
            "lead_in": run.led_frames,
            "half": self.keep == "half",
        }
        return {label: value for label, value in labels.items() if label}

    def __str__(self) -> str:
        names = self.labels
        counts = [f"{count:,}" for count in names["triangles_asked"] if count]
        size = f", {'+'.join(counts)} triangles" if counts else ""
        steps = "" if self.run.propagation_steps is None else f", K {self.run.propagation_steps}"
        scene = f"{names['garment']} in {names['material']} on {names['body']}, {names['motion']}, seed {names['seed']}"
        return f"{scene}{size}, by {self.label or names['model']}{steps}"


def attempt(job: RunJob | JobPack) -> Made | Failure | list[Made | Failure]:
    """Do a job, or those of a pack; any error is returned as a `Failure` with a sentence.

    Args:
        job: the job, or the pack, which gives a list.
    """
    if not isinstance(job, JobPack):
        return attempted(make, job)
    simulated = _together(job.jobs)
    return [attempted(partial(make, simulated=simulated.get(single)), single) for single in job.jobs]


def _together(jobs: Sequence[RunJob]) -> dict[RunJob, Simulated]:
    """States of the jobs that could be simulated together; the others have to be simulated alone."""
    simulator, scenes = _network(jobs[0]), {}
    results: dict[RunJob, Simulated] = {}
    for job in jobs:
        with suppress(Pb4uError):
            scenes[job] = _scene_of(job, simulator)
    for numbers in simulator.packs(list(scenes.values())):
        pack = [list(scenes)[number] for number in numbers]
        # A job that has no finite first frame, or too little memory, says so when it is simulated alone.
        with suppress(Pb4uError, RuntimeError):
            trajectories = simulator.together([scenes[job] for job in pack])
            results |= {job: Simulated(scenes[job], *result) for job, result in zip(pack, trajectories, strict=True)}
    return results


def make(job: RunJob, simulated: Simulated | None = None) -> Made:
    """Simulate, measure and encode.

    Args:
        job: the run to make.
        simulated: its states and computing times, if it was simulated together with others.

    Raises:
        InputError: one of its inputs cannot be used, or changed since it was planned.
        Pb4uError: the state stopped being finite before the first frame to write, of which no stills are to be kept.
    """
    from pb4u.measures.divergence import hold_shifts, slid_from
    from pb4u.measures.run_report import machine, run_facts, run_report
    from pb4u.simulation.run_simulation import roll_out
    from pb4u.simulation.simulator import RunRecord

    began = time.perf_counter()
    with _quiet(), noted() as notes:
        for _, file, expected in job.contents:
            require_content(Path(file), expected)
        simulator = _simulator(job.run.options, job.weights)
        if simulated is None:
            scene, states, record = _scene_of(job, simulator), None, RunRecord()
        else:
            scene, states, record = simulated
            _network(job).warn_of(scene)
        trajectory = None
        try:
            trajectory = roll_out(job.run, simulator, scene, record=record, simulated=states)
        except Pb4uError as error:
            if record.failed_at is None:
                raise
            if job.keep != "stills":
                raise Pb4uError("The state stopped being finite before the first frame to write.") from error
    result: dict[str, Any] = {"metrics": {}, "metrics_paper": {}, "diverged": True, "diverged_at": 0}
    content = None
    if trajectory is None:
        result |= run_facts(simulator.header(scene), simulator, scene, record)
        result["notes"] = list(dict.fromkeys((*scene.notes, *notes)))
        if job.excess:
            result["metrics"] |= _excess(job.run.scene, simulator)
    else:
        result |= run_report(trajectory, simulator, scene, record, notes=notes)
        for measured, described in zip(result["garments"], trajectory.header.garments, strict=True):
            measured |= {
                "vertices": described["vertices"][1] - described["vertices"][0],
                "triangles": described["triangles"][1] - described["triangles"][0],
                **described["material"],
            }
        if job.excess:
            result["metrics"] |= _distance(job.run.scene, trajectory) | _excess(job.run.scene, simulator)
        if job.keep == "stills":
            shifts = hold_shifts(scene, trajectory)
            result["hold_shift"] = {"per_frame": shifts.max(axis=1).tolist(), "max": float(shifts.max())}
            result["slid_at"] = slid_from(shifts)
            result["pictured_frame"] = min(round(PICTURED * (scene.frames - 1)), trajectory.frame_count - 1)
        content = _encoded(job, trajectory, result)
    result |= {
        "solver_iterations": sum(result["solver_iterations"]),
        "own_steps": _own_steps(simulator, result["mean_edge_length"]) or result["propagation_steps"],
        "failed_at": record.failed_at,
        "scene_frames": scene.frames,
        "machine": machine(job.device),
        "bytes": len(content or b""),
        "seconds": time.perf_counter() - began + (0.0 if simulated is None else sum(record.step_seconds)),
    }
    return Made({**result, **job.labels}, content)


@lru_cache(maxsize=1)
def _simulator(options: Run, weights: str | None) -> Simulator:
    """The simulator of the options; jobs mostly share one, whose weights need not be read for each."""
    from pb4u.simulation.checkpoint import weights_file
    from pb4u.simulation.models import simulator_of

    if weights:
        with weights_file(str(options.model)) as path:
            require_content(path, weights)
    return simulator_of(options)


def _network(job: RunJob) -> NetworkSimulator:
    """The simulator of a job that is simulated in a pack."""
    from pb4u.simulation.stepwise_simulator import NetworkSimulator

    simulator = _simulator(job.run.options, job.weights)
    assert isinstance(simulator, NetworkSimulator)
    return simulator


def _scene_of(job: RunJob, simulator: Simulator) -> Scene:
    """Scene of a job at the rate of its simulator; its notes are the warnings raised while it was built."""
    from pb4u.simulation.run_simulation import simulated_fps

    with _quiet(), noted() as notes:
        fps = simulated_fps(job.run, simulator)
    scene = _scene(job.run.at_rate(fps).scene, job.run.fps)
    return replace(scene, notes=(*scene.notes, *notes))


@contextmanager
def _quiet() -> Iterator[None]:
    """Print no warning: the notes of the result have those of the product."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


# Jobs of an evaluation come sorted by scene: the garment is cut and meshed once for all the models.
@lru_cache(maxsize=1)
def _scene(run: Run, written_fps: float) -> Scene:
    """Scene of a run, whose result is written at `written_fps` [1/s]."""
    from pb4u.scene.assembly import build_scene

    with _quiet():
        return build_scene(run, written_fps)


@lru_cache(maxsize=1)
def _reference(run: Run) -> Reference:
    """Solver's rollout of a scene, and the states that all models are compared on."""
    from pb4u.measures.excess import Reference
    from pb4u.simulation.simulator import RunRecord
    from pb4u.simulation.stepwise_simulator import SolverSimulator
    from pb4u.simulation.timeline import Timeline

    scene = _scene(run, run.fps)
    timeline, solver = Timeline.of(scene), SolverSimulator()
    first = solver.first_frame.start(timeline, solver.method(timeline, RunRecord())).state
    return Reference.of(solver.potential, timeline, first, scene.total_frames, scene.lead_in)


def _distance(run: Run, trajectory: Trajectory) -> dict[str, Any]:
    """Distance [m] of each frame from the reference's."""
    import numpy as np

    from pb4u.measures.excess import series

    pairs = zip(trajectory.positions, _reference(run).states[run.led_frames :], strict=False)
    away = [float(np.linalg.norm(x - y.positions.numpy(), axis=1).mean()) for x, y in pairs]
    return {"distance_to_reference": series(away)}


def _excess(run: Run, simulator: Simulator) -> dict[str, Any]:
    """Excess heights [m] on the shared states of the reference; none of what takes no steps."""
    from pb4u.measures.excess import BEATEN_BY, series
    from pb4u.simulation.simulator import RunRecord
    from pb4u.simulation.stepwise_simulator import StepwiseSimulator

    if not isinstance(simulator, StepwiseSimulator):
        return {}
    reference = _reference(run)
    heights = reference.excess(simulator.method(reference.timeline, RunRecord()))
    below = sum(height < -BEATEN_BY for height in heights)
    return {"excess_height": {**series(heights), "states": len(heights), "below_reference": below}}


def _own_steps(simulator: Simulator, mean_edge_length: float) -> int | None:
    """K by the network's own rule, whatever the run sets; None for models without propagation steps."""
    from pb4u.simulation.stepwise_simulator import NetworkSimulator

    if not isinstance(simulator, NetworkSimulator):
        return None
    return simulator.checkpoint.model.network.propagation_steps(mean_edge_length) or None


def _encoded(job: RunJob, trajectory: Trajectory, result: dict[str, Any]) -> bytes:
    """Bytes of the trajectory file that is kept."""
    if job.keep != "stills":
        return trajectory.encode(job.keep == "half")
    frames = [result["pictured_frame"], _worst_frame(result, trajectory.frame_count)]
    arrays = {name: getattr(trajectory, name)[frames] for name in ("positions", "velocities", "body_positions")}
    return replace(trajectory, **arrays).encode()


def _worst_frame(result: dict[str, Any], frames: int) -> int:
    """The frame that shows best what is wrong: where it diverged or slid for good, else where most is inside."""
    if result["diverged"]:
        return min(int(result["diverged_at"]), frames - 1)
    values = result["metrics"].get("penetration_percent", {}).get("per_frame", [0.0])
    if result["slid_at"] is not None:
        values = result["hold_shift"]["per_frame"]
    return max(range(len(values)), key=values.__getitem__)


def entry_of(value: str, file: str) -> str:
    """Part of a value that names an entry within its file, such as ":tshirt" or ":3"; "" if it names only the file.

    Args:
        value: as a run has it.
        file: path of its file.
    """
    return Path(value).as_posix().removeprefix(Path(file).as_posix())


def _plain(specification: object, files: Mapping[str, list[str]]) -> Any:
    """A specification as JSON, files by their names and contents."""
    if isinstance(specification, Run | WornGarment | Environment):
        return {field.name: _plain(getattr(specification, field.name), files) for field in fields(specification)}
    if isinstance(specification, tuple):
        return [_plain(item, files) for item in specification]
    if isinstance(specification, str | Path):
        return files.get(str(specification), str(specification))
    return specification
