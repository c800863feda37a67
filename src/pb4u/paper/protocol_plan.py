"""From what was asked for to the rollouts to make. Everything that can be refused is refused here, before any work."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pb4u.body.library import body_names, load_body
from pb4u.errors import InputError, unknown_name
from pb4u.garment.library import FEWEST_TRIANGLES, LEVELS, MOST_TRIANGLES, garment_names
from pb4u.jobs.job import digest
from pb4u.motion.library import SUFFIXES as MOTION_SUFFIXES
from pb4u.motion.library import motion_names, recording_file
from pb4u.paper.protocols import PROTOCOLS, Protocol
from pb4u.paper.reference_energies import REFERENCE_LEAD_IN, stored_reference
from pb4u.paper.rollout import FPS, ModelRecord, RolloutJob, SceneRecord, Settings
from pb4u.scene.catalogue import SEEDS, SceneName
from pb4u.simulation.checkpoint import weights_file, weights_name
from pb4u.simulation.models import load_simulator, looks_at, model_descriptions
from pb4u.simulation.stepwise_simulator import QUICK_SOLVER, NetworkSimulator

DRAWN_SEEDS = (2000, 10000)
"""First seed of the motions that drawn scenes have, and the first beyond: trainings use none of them."""

REFINE = 5
"""Solver iterations after a network's step where it runs by default, as in `pb4u simulate`."""

_SOLVER = ModelRecord("solver", "solver")

_TRIAL = re.compile(r"\d+_\d+")


@dataclass(frozen=True)
class EvaluationRequest:
    """The arguments of `pb4u evaluate`; None keeps the protocol's own choice.

    Args:
        protocol: its name.
        models: names or files.
        garments: names or files.
        motions: names or files.
        bodies: names or files.
        levels: names such as 11K, or numbers of triangles.
        steps: numbers of propagation steps.
        frames: frames to write of each scene.
        lead_in: frames simulated before them.
        recordings: folder of CMU trials, SUBJECT/TRIAL.amc beside SUBJECT/SUBJECT.asf.
        refine: solver iterations after each step of a network.
        contact: contact response after each step of networks and solver.
        device: auto, cpu or cuda.
        floors: run the solver on scenes whose floor is not stored.
        scenes: number of scenes to draw, of a protocol that draws them.
        seed: of the draws.
        excess: also measure excess heights and distances from the solver; of the protocol `controls` always.
    """

    protocol: str = "resolution"
    models: tuple[str, ...] | None = None
    garments: tuple[str, ...] | None = None
    motions: tuple[str, ...] | None = None
    bodies: tuple[str, ...] | None = None
    levels: tuple[str, ...] | None = None
    steps: tuple[int, ...] | None = None
    frames: int | None = None
    lead_in: int = 30
    recordings: Path | None = None
    refine: int = 0
    contact: bool = False
    device: str = "auto"
    floors: bool = True
    scenes: int | None = None
    seed: int = 0
    excess: bool = False

    def as_json(self) -> dict[str, Any]:
        """The fields as JSON."""
        return asdict(self) | {"recordings": None if self.recordings is None else str(self.recordings)}


@dataclass(frozen=True)
class Case:
    """A job in its place in the tables.

    Args:
        level: name of the resolution.
        motion: what the motion is called.
        job: the rollout.
        floor: what the ratio is taken to: a rollout of the solver, the stored mean energies, or None.
        number: of the scene, where scenes are drawn.
    """

    level: str
    motion: str
    job: RolloutJob
    floor: RolloutJob | dict[str, float] | None
    number: int | None = None


@dataclass(frozen=True)
class Plan:
    """The rollouts of a run, and the cases that its tables are made of.

    Args:
        protocol: narrowed to what was asked for.
        cases: everything the tables are made of.
        jobs: the rollouts to make, each once, in the order to make them; the solver's for the floors among them.
        absent: a sentence on each thing left out.
    """

    protocol: Protocol
    cases: tuple[Case, ...]
    jobs: tuple[RolloutJob, ...]
    absent: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Motion:
    """A motion as scenes take it: its name or file, its seed, and what tables call it."""

    source: str
    seed: int | None
    label: str


def plan(request: EvaluationRequest) -> Plan:
    """The rollouts of a request.

    Args:
        request: what was asked for.

    Raises:
        InputError: something is unknown, unusable or empty.
    """
    if request.protocol not in PROTOCOLS:
        raise unknown_name("protocol", request.protocol, PROTOCOLS)
    protocol = PROTOCOLS[request.protocol]
    _check_numbers(request)
    levels = dict(_level(name) for name in request.levels or protocol.levels)
    protocol = replace(
        protocol,
        garments=tuple(_garment(name) for name in request.garments or protocol.garments),
        bodies=tuple(_body(name) for name in request.bodies or protocol.bodies),
        motions=request.motions or (protocol.recordings if request.recordings else protocol.motions),
        levels=tuple(levels),
        frames=request.frames or protocol.frames,
        steps=request.steps or protocol.steps,
        excess=request.excess or protocol.excess,
    )
    motions = [_motion(name, request.recordings) for name in protocol.motions]
    device = _device(request.device)
    models, absent = _models(request, protocol, device)
    if any(steps is not None for steps in protocol.steps) and not any(model.adapts for model in models):
        raise InputError(
            " ".join(["None of the models has propagation steps to vary; name a network with --models.", *absent])
        )
    if protocol.scenes:
        protocol = replace(protocol, scenes=request.scenes or protocol.scenes)
        cases = _drawn_cases(request, protocol, levels, motions, models, device)
    else:
        cases = _combined_cases(request, protocol, levels, motions, models, device)
    jobs = {case.job.key: case.job for case in cases}
    jobs |= {case.floor.key: case.floor for case in cases if isinstance(case.floor, RolloutJob)}
    if request.floors:
        # What pictures show beside the models.
        pictured = (case for case in cases if protocol.pictures(case.level, case.motion, case.job.scene.body))
        jobs |= {job.key: job for job in (_solver_on(case.job.scene) for case in pictured)}
    # Coarse scenes first, so that tables fill early; the jobs of a scene together, so that it is made once.
    scenes = {scene: rank for rank, scene in enumerate(dict.fromkeys(job.scene for job in jobs.values()))}
    order = sorted(jobs.values(), key=lambda job: (job.scene.triangles, scenes[job.scene]))
    labels = tuple(dict.fromkeys(case.job.model.label for case in cases))
    return Plan(replace(protocol, models=labels), tuple(cases), tuple(order), absent)


def _combined_cases(
    request: EvaluationRequest,
    protocol: Protocol,
    levels: dict[str, int],
    motions: list[_Motion],
    models: list[ModelRecord],
    device: str,
) -> list[Case]:
    """Everything with everything else."""
    solver_runs = not request.contact and any(model.name == "solver" for model in models)
    cases = []
    for level, garment, body, motion in product(protocol.levels, protocol.garments, protocol.bodies, motions):
        scene = _scene(garment, body, motion, levels[level], protocol.frames, request.lead_in)
        floor = _solver_on(scene) if solver_runs else _floor(scene, motion, level, request)
        if isinstance(floor, RolloutJob):
            floor = replace(floor, excess=protocol.excess)
        for model in models:
            for steps in protocol.steps if model.adapts else (None,):
                job = RolloutJob(scene, model, _settings(model, steps, request, device), protocol.excess)
                cases.append(Case(level, motion.label, job, floor))
    return cases


def _drawn_cases(
    request: EvaluationRequest,
    protocol: Protocol,
    levels: dict[str, int],
    motions: list[_Motion],
    models: list[ModelRecord],
    device: str,
) -> list[Case]:
    """Scenes drawn by their numbers, so that more of them leave the first as they are; each model in its ways."""
    cases = []
    for number in range(protocol.scenes):
        level, motion, scene = _drawn_scene(request, protocol, levels, motions, number)
        for model in models:
            for way, settings in _ways(model, device):
                floor = RolloutJob(scene, _SOLVER, replace(settings, refine=0, device="cpu"))
                job = RolloutJob(scene, replace(model, label=f"{model.label}{way}"), settings, protocol.excess)
                if model.name == "solver":
                    floor = job
                cases.append(Case(level, motion.label, job, floor if request.floors else None, number))
    return cases


def _ways(model: ModelRecord, device: str) -> list[tuple[str, Settings]]:
    """The ways a model is run where scenes are drawn: on its own, and as `pb4u simulate` runs it."""
    if not looks_at(model.name, "contact"):
        return [("", Settings())]
    place = device if model.weights is not None else "cpu"
    iterations = REFINE if looks_at(model.name, "refine") else 0
    as_it_comes = Settings(refine=iterations, contact=True, self_contact=True, device=place)
    if model.name == QUICK_SOLVER:
        return [(", by default", as_it_comes)]
    return [(", alone", Settings(device=place)), (", by default", as_it_comes)]


def _drawn_scene(
    request: EvaluationRequest, protocol: Protocol, levels: dict[str, int], motions: list[_Motion], number: int
) -> tuple[str, _Motion, SceneRecord]:
    """Level, motion and scene of a number. Garments and motions go in turns, so that few scenes have all of them."""
    rng = np.random.default_rng([request.seed, number])
    garments = protocol.garments
    garment = garments[number % len(garments)]
    motion = motions[(number + number // len(garments)) % len(motions)]
    if motion.source in motion_names() and motion.label == motion.source:
        seed = int(rng.integers(*DRAWN_SEEDS))
        motion = _Motion(motion.source, seed, f"{motion.source}-{seed}")
    body, level, material = (str(rng.choice(each)) for each in (protocol.bodies, protocol.levels, protocol.materials))
    shape: tuple[tuple[str, float], ...] = ()
    if body in body_names():
        parameters = getattr(load_body(body), "shape", {})
        shape = tuple((name, round(float(rng.uniform()), 2)) for name in parameters)
    scene = _scene(garment, body, motion, levels[level], protocol.frames, request.lead_in)
    return level, motion, replace(scene, material=material, shape=shape)


def _check_numbers(request: EvaluationRequest) -> None:
    if request.frames is not None and request.frames < 1:
        raise InputError(f"The number of frames must be 1 or more, not {request.frames}.")
    if request.lead_in < 0:
        raise InputError(f"The lead-in must be 0 frames or more, not {request.lead_in}.")
    if any(steps < 1 for steps in request.steps or ()):
        raise InputError(f"Numbers of propagation steps must be 1 or more, not {min(request.steps or ())}.")
    draws = bool(PROTOCOLS[request.protocol].scenes)
    if draws and (request.contact or request.refine or request.steps):
        raise InputError(
            f"The protocol {request.protocol} runs networks alone and by default: leave out --contact, --refine and "
            "--propagation-steps."
        )
    if not draws and request.scenes is not None:
        drawing = ", ".join(name for name, protocol in PROTOCOLS.items() if protocol.scenes)
        raise InputError(f"--scenes are of protocols that draw their scenes: {drawing}.")
    if request.scenes is not None and request.scenes < 1:
        raise InputError(f"The number of scenes must be 1 or more, not {request.scenes}.")
    if request.seed < 0:
        raise InputError(f"The seed must be 0 or more, not {request.seed}.")
    if request.recordings is not None and not request.recordings.is_dir():
        raise InputError(f"There is no folder of recordings {request.recordings}.")
    for name in ("models", "garments", "motions", "bodies", "levels", "steps"):
        if getattr(request, name) == ():
            flag = "propagation-steps" if name == "steps" else name
            raise InputError(f"--{flag} names nothing; give at least one, or leave it out.")


def _garment(name: str) -> str:
    if name in garment_names():
        return name
    if Path(name).suffix:
        if not Path(name).is_file():
            raise InputError(f"There is no garment file {name}.")
        return name
    raise unknown_name("garment", name, garment_names())


def _body(name: str) -> str:
    load_body(name)
    return name


def _level(name: str) -> tuple[str, int]:
    """What a level is called, and its number of triangles."""
    named = {key.lower(): (key, count) for key, count in LEVELS.items()}
    if name.lower() in named:
        return named[name.lower()]
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([kK]?)", name.strip())
    if not match:
        raise InputError(f"There is no level {name!r}; give a number of triangles, or one of {', '.join(LEVELS)}.")
    triangles = round(float(match[1]) * (1000 if match[2] else 1))
    if not FEWEST_TRIANGLES <= triangles <= MOST_TRIANGLES:
        raise InputError(
            f"A level has between {FEWEST_TRIANGLES} and {MOST_TRIANGLES} triangles; {name} has {triangles}."
        )
    known = {count: key for key, count in LEVELS.items()}
    return known.get(triangles, f"{triangles // 1000}K" if triangles % 1000 == 0 else str(triangles)), triangles


def _motion(name: str, recordings: Path | None) -> _Motion:
    clip, _, seed = name.rpartition("-")
    if name in motion_names():
        return _Motion(name, SEEDS["test"][0], name)
    if clip in motion_names() and seed.isdecimal():
        return _Motion(clip, int(seed), name)
    if _TRIAL.fullmatch(name):
        file = (recordings or Path()) / name.split("_")[0] / f"{name}.amc"
        if recordings is None or not file.is_file():
            raise InputError(
                f"The CMU trial {name} is not there"
                + (f" as {file}." if recordings else "; give the folder of recordings with --recordings.")
            )
        return _Motion(str(file), None, name)
    file, person = recording_file(name)
    if file.suffix.lower() in MOTION_SUFFIXES:
        if not file.is_file():
            raise InputError(f"There is no motion file {file}.")
        return _Motion(name, None, file.stem if person is None else f"{file.stem}_{person}")
    raise InputError(f"{unknown_name('motion', name, motion_names())} CMU trials are written as 07_02.")


def _scene(garment: str, body: str, motion: _Motion, triangles: int, frames: int, lead_in: int) -> SceneRecord:
    files = {"garment": garment, "body": body, "motion": motion.source}
    built_in = (*garment_names(), *body_names(), *motion_names())
    digests = tuple(
        (field, digest(Path(file))) for field, file in files.items() if file not in built_in and Path(file).is_file()
    )
    return SceneRecord(garment, body, motion.source, motion.seed, triangles, frames, lead_in, digests=digests)


def _floor(
    scene: SceneRecord, motion: _Motion, level: str, request: EvaluationRequest
) -> RolloutJob | dict[str, float] | None:
    name = motion.label if motion.seed is None else motion.source
    if (scene.body, scene.lead_in) == ("woman", REFERENCE_LEAD_IN) and "garment" not in dict(scene.digests):
        stored = stored_reference(str(SceneName("test", scene.garment, name, motion.seed)), level, scene.frames)
        if stored is not None:
            return stored
    return _solver_on(scene) if request.floors else None


def _solver_on(scene: SceneRecord) -> RolloutJob:
    """The run that a floor is taken from: nothing but the potential is at work."""
    return RolloutJob(scene, _SOLVER, Settings())


def _settings(model: ModelRecord, steps: int | None, request: EvaluationRequest, device: str) -> Settings:
    if model.weights is not None:
        return Settings(steps, request.refine, request.contact, device=device)
    if model.name == QUICK_SOLVER:
        return Settings(refine=request.refine or REFINE, contact=request.contact)
    refine = request.refine if looks_at(model.name, "refine") else 0
    return Settings(refine=refine, contact=request.contact and looks_at(model.name, "contact"))


def _device(asked: str) -> str:
    if asked not in ("auto", "cpu", "cuda"):
        raise InputError(f"A device is auto, cpu or cuda, not {asked!r}.")
    return "cuda" if asked == "cuda" or (asked == "auto" and torch.cuda.is_available()) else "cpu"


def _models(request: EvaluationRequest, protocol: Protocol, device: str) -> tuple[list[ModelRecord], tuple[str, ...]]:
    """The models to run, and a sentence on the protocol's own that have no weights yet."""
    wanted = tuple(dict.fromkeys(request.models or protocol.models))
    missing = () if request.models else tuple(name for name in wanted if name not in model_descriptions())
    present = [name for name in wanted if name not in missing]
    labels = [weights_name(Path(name)) if Path(name).suffix else name for name in present]
    # Checkpoints are often all called best: then each goes by its path.
    labels = [name if labels.count(label) > 1 else label for name, label in zip(present, labels, strict=True)]
    records = [_model(name, label, device) for name, label in zip(present, labels, strict=True)]
    absent = (f"No weights are there yet for {', '.join(missing)}: left out.",) if missing else ()
    return records, absent


def _model(name: str, label: str, device: str) -> ModelRecord:
    if Path(name).suffix and not Path(name).is_file():
        raise InputError(f"There is no model file {name}.")
    simulator = load_simulator(name, contact=False, self_contact=False, device=device)
    if simulator.fps is not None and not math.isclose(simulator.fps, FPS, rel_tol=1e-3):
        raise InputError(f"{name} runs at {simulator.fps:g} frames per second; the protocols run at {FPS:g}.")
    if not isinstance(simulator, NetworkSimulator):
        return ModelRecord(name, label)
    adapts = simulator.checkpoint.model.network.propagates
    with weights_file(name) as path:
        return ModelRecord(name, label, digest(path), adapts)
