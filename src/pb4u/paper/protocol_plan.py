"""Plans the rollouts of an evaluation; validates all of them before any work."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pb4u.body.library import body_names, load_body
from pb4u.errors import InputError, refuse_unknown, unknown_name
from pb4u.garment.library import FEWEST_TRIANGLES, LEVELS, MOST_TRIANGLES
from pb4u.measures.job_planner import JobPlanner, Model
from pb4u.measures.run_job import RunJob
from pb4u.motion.library import SUFFIXES as MOTION_SUFFIXES, motion_names, recording_file
from pb4u.paper.evaluation_request import EvaluationRequest
from pb4u.paper.protocols import PROTOCOLS, Protocol
from pb4u.paper.reference_energies import REFERENCE_LEAD_IN, stored_reference
from pb4u.run import Run, WornGarment
from pb4u.simulation.checkpoint import weights_name
from pb4u.simulation.models import looks_at, model_descriptions
from pb4u.simulation.stepwise_simulator import QuickSolver
from pb4u.training.catalogue import SEEDS

FPS = 30.0
"""Frames per second of every protocol."""

DRAWN_SEEDS = (2000, 10000)
"""First seed of the motions that drawn scenes have, and the first beyond: trainings use none of them."""

REFINE = 5
"""Solver iterations after a network's step where it runs by default, as in `pb4u simulate`."""

ALONE: dict[str, Any] = {
    "refine": 0,
    "contact": False,
    "self_contact": False,
    "precision": "float32",
    "friction_law": "paper",
    "time_integration": "implicit-euler",
    "air": "off",
}
"""Options of a run by a method alone; the energies that tables compare do not know contact between cloths."""

BY_DEFAULT: dict[str, Any] = {
    **ALONE,
    "refine": REFINE,
    "contact": True,
    "self_contact": True,
    "friction_law": "coulomb",
}
"""Those of a run as `pb4u simulate` makes it."""

_TRIAL = re.compile(r"\d+_\d+")


@dataclass(frozen=True)
class Case:
    """A job with its position in the tables.

    Args:
        level: name of the resolution.
        motion: name of the motion.
        seed: of a built-in motion; None for a recording.
        job: the rollout.
        floor: reference of the ratio: a rollout of the solver, the stored mean energies, or None.
        number: of the scene, if scenes are drawn at random.
    """

    level: str
    motion: str
    seed: int | None
    job: RunJob
    floor: RunJob | dict[str, float] | None
    number: int | None = None

    @property
    def garment(self) -> str:
        """Name of the garment."""
        return self.job.run.garments[0].name


@dataclass(frozen=True)
class Plan:
    """The rollouts of a run, and the cases in its tables.

    Args:
        protocol: restricted to the request.
        cases: all entries of the tables.
        jobs: the rollouts to make, each once, in the order to make them; the solver's for the floors among them.
        absent: a sentence on each omitted part.
    """

    protocol: Protocol
    cases: tuple[Case, ...]
    jobs: tuple[RunJob, ...]
    absent: tuple[str, ...] = ()


class _Motion(NamedTuple):
    """A motion as scenes take it: its name or file, its seed, and what tables call it."""

    source: str
    seed: int | None
    label: str


def plan(request: EvaluationRequest) -> Plan:
    """The rollouts of a request.

    Args:
        request: options of the evaluation.

    Raises:
        InputError: something is unknown, unusable or empty.
    """
    refuse_unknown("protocol", [request.protocol], PROTOCOLS)
    return _Planning(request).plan()


class _Planning:
    """Planning of one request: the models, levels and motions that its rollouts share."""

    def __init__(self, request: EvaluationRequest) -> None:
        _check_numbers(request)
        protocol = PROTOCOLS[request.protocol]
        if request.recordings is not None and not (request.motions or protocol.recordings):
            raise InputError(
                f"The protocol {request.protocol} has no recordings of its own; name those to use with --motions, "
                "such as 07_02."
            )
        self.request, self.planner = request, JobPlanner()
        self.levels = dict(_level(name) for name in request.levels or protocol.levels)
        self.protocol = replace(
            protocol,
            garments=request.garments or protocol.garments,
            bodies=request.bodies or protocol.bodies,
            motions=request.motions or (protocol.recordings if request.recordings else protocol.motions),
            levels=tuple(self.levels),
            frames=protocol.frames if request.frames is None else request.frames,
            steps=request.propagation_steps or protocol.steps,
            excess=request.measure == "excess" or protocol.excess,
            scenes=(request.scenes or protocol.scenes) if protocol.scenes else 0,
        )
        self.motions = [_motion(name, request.recordings) for name in self.protocol.motions]
        _check_told_apart("garments", {name: WornGarment(name).name for name in self.protocol.garments})
        _check_told_apart("motions", {str((motion.source, motion.seed)): motion.label for motion in self.motions})
        # As cases have them, by which pictures and the page name them.
        self.protocol = replace(self.protocol, motions=tuple(motion.label for motion in self.motions))
        self.models, self.absent = self._present_models()

    def plan(self) -> Plan:
        if any(self.protocol.steps) and not any(model.adapts for model in self.models.values()):
            absent = " ".join(self.absent)
            raise InputError(
                f"None of the models has propagation steps to vary; name a network with --models. {absent}".strip()
            )
        cases = list(self._drawn() if self.protocol.scenes else self._combined())
        jobs = {case.job.key: case.job for case in cases}
        jobs |= {case.floor.key: case.floor for case in cases if isinstance(case.floor, RunJob)}
        if self.request.floors == "run":
            # What pictures show beside the models.
            pictured = (c for c in cases if self.protocol.pictures(c.level, c.motion, str(c.job.run.body)))
            jobs |= {job.key: job for job in (self._solver_on(case.job.run) for case in pictured)}
        # Coarse scenes first, so that tables fill early; the jobs of a scene together, so that it is made once.
        scenes = {scene: rank for rank, scene in enumerate(dict.fromkeys(job.run.scene for job in jobs.values()))}
        order = sorted(jobs.values(), key=lambda job: (job.run.garments[0].triangles or 0, scenes[job.run.scene]))
        labels = tuple(dict.fromkeys(case.job.label for case in cases))
        return Plan(replace(self.protocol, models=labels), tuple(cases), tuple(order), self.absent)

    def _job(self, scene: Run, label: str, model: str, excess: bool = False, **options: Any) -> RunJob:
        run = replace(scene, **{**ALONE, "device": self.request.device, **options})
        return self.planner.job(replace(run, model=model), label, "stills", excess)

    def _solver_on(self, scene: Run, excess: bool = False) -> RunJob:
        """The run that a floor is taken from: nothing but the potential is at work."""
        return self._job(replace(scene, propagation_steps=None), "solver", "solver", excess)

    def _combined(self) -> Iterator[Case]:
        """Everything with everything else."""
        protocol, request = self.protocol, self.request
        solver_runs = not request.contact and any(model.name == "solver" for model in self.models.values())
        for level, garment, body, motion in product(protocol.levels, protocol.garments, protocol.bodies, self.motions):
            scene = self._scene(garment, body, motion, level)
            floor = self._solver_on(scene, protocol.excess) if solver_runs else self._floor(scene, motion, level)
            for label, model in self.models.items():
                for steps, scaling in product(protocol.steps, protocol.scalings) if model.adapts else ((None, None),):
                    options = {"propagation_steps": steps, "scaling": scaling, **self._options(model.name)}
                    called = label if scaling is None else f"{label}, scaling {scaling}"
                    job = self._job(scene, called, model.name, protocol.excess, **options)
                    yield Case(level, motion.label, motion.seed, job, floor)

    def _drawn(self) -> Iterator[Case]:
        """Scenes drawn by their numbers, so that more of them leave the first as they are; each model in its ways."""
        for number in range(self.protocol.scenes):
            level, motion, scene = self._drawn_scene(number)
            for label, model in self.models.items():
                for way, options in _ways(model.name):
                    job = self._job(scene, f"{label}{way}", model.name, self.protocol.excess, **options)
                    floor = job
                    if model.name != "solver":
                        floor = self._job(scene, "solver", "solver", self.protocol.excess, **{**options, "refine": 0})
                    yield Case(
                        level, motion.label, motion.seed, job, floor if self.request.floors == "run" else None, number
                    )

    def _drawn_scene(self, number: int) -> tuple[str, _Motion, Run]:
        """Level, motion and scene of a number. Garments and motions go in turns, so that few scenes have all."""
        protocol = self.protocol
        rng = np.random.default_rng([self.request.seed, number])
        garments = protocol.garments
        motion = self.motions[(number + number // len(garments)) % len(self.motions)]
        if motion.source in motion_names() and motion.label == motion.source:
            seed = int(rng.integers(*DRAWN_SEEDS))
            motion = _Motion(motion.source, seed, f"{motion.source}-{seed}")
        body, level, material = (
            str(rng.choice(choices)) for choices in (protocol.bodies, protocol.levels, protocol.materials)
        )
        parameters = getattr(load_body(body), "shape", {}) if body in body_names() else {}
        shape = {name: round(float(rng.uniform()), 2) for name in parameters}
        scene = self._scene(garments[number % len(garments)], body, motion, level)
        return level, motion, scene.with_entries({"material": material, "body_shape": shape})

    def _scene(self, garment: str, body: str, motion: _Motion, level: str) -> Run:
        return Run(
            (WornGarment(garment, triangles=self.levels[level]),), body=body, motion=motion.source,
            seed=motion.seed or 0, frames=self.protocol.frames, lead_in=self.request.lead_in, fps=FPS,
            rest_shape="moulded",
        )  # fmt: skip

    def _floor(self, scene: Run, motion: _Motion, level: str) -> RunJob | dict[str, float] | None:
        name, garment = motion.label if motion.seed is None else motion.source, str(scene.garments[0].garment)
        if (scene.body, scene.lead_in) == ("woman", REFERENCE_LEAD_IN) and not Path(garment).suffix:
            title = f"test/{garment}/{name}" + ("" if motion.seed is None else f"-{motion.seed}")
            stored = stored_reference(title, level, self.protocol.frames)
            if stored is not None:
                return stored
        return self._solver_on(scene, self.protocol.excess) if self.request.floors == "run" else None

    def _options(self, model: str) -> dict[str, Any]:
        """The requested options that a model uses."""
        options = {"refine": self.request.refine, "contact": self.request.contact}
        if model == QuickSolver.name:
            options["refine"] = self.request.refine or REFINE
        return {name: value for name, value in options.items() if looks_at(model, name)}

    def _present_models(self) -> tuple[dict[str, Model], tuple[str, ...]]:
        """The models to run by what tables call them, and a sentence on the protocol's own that have no weights yet."""
        names = tuple(dict.fromkeys(self.request.models or self.protocol.models))
        missing = () if self.request.models else tuple(name for name in names if name not in model_descriptions())
        present = [name for name in names if name not in missing]
        labels = [weights_name(Path(name)) if Path(name).suffix else name for name in present]
        # Checkpoints are often all called best: then each goes by its path.
        labels = [name if labels.count(label) > 1 else label for name, label in zip(present, labels, strict=True)]
        models = {}
        for label, name in zip(labels, present, strict=True):
            if Path(name).suffix and not Path(name).is_file():
                raise InputError(f"There is no model file {name}.")
            models[label] = self.planner.model(
                Run(**{**ALONE, "refine": REFINE, "model": name, "device": self.request.device})
            )
            fps = models[label].fps
            if fps is not None and not math.isclose(fps, FPS, rel_tol=1e-3):
                raise InputError(f"{name} runs at {fps:g} frames per second; the protocols run at {FPS:g}.")
        return models, (f"No weights are there yet for {', '.join(missing)}: left out.",) if missing else ()


def _ways(model: str) -> list[tuple[str, dict[str, Any]]]:
    """The ways a model is run where scenes are drawn: on its own, and as `pb4u simulate` runs it."""
    if not looks_at(model, "contact"):
        return [("", {})]
    by_default = {**BY_DEFAULT, "refine": REFINE if looks_at(model, "refine") else 0}
    return [*([] if model == QuickSolver.name else [(", alone", {})]), (", by default", by_default)]


def _check_numbers(request: EvaluationRequest) -> None:
    draws = bool(PROTOCOLS[request.protocol].scenes)
    if draws and (request.contact or request.refine or request.propagation_steps):
        raise InputError(
            f"The protocol {request.protocol} runs networks alone and by default: leave out --contact, --refine and "
            "--propagation-steps."
        )
    drawing = ", ".join(name for name, protocol in PROTOCOLS.items() if protocol.scenes)
    if not draws and request.scenes is not None:
        raise InputError(f"--scenes applies only to protocols that draw scenes at random: {drawing}.")
    if not draws and request.seed:
        raise InputError(
            f"--seed is for the scenes of {drawing}; in other protocols the seed is part of the motion's "
            "name, as in --motions walk-7."
        )
    if request.recordings is not None and not request.recordings.is_dir():
        raise InputError(f"There is no folder of recordings {request.recordings}.")
    for name in ("models", "garments", "motions", "bodies", "levels", "propagation_steps"):
        if getattr(request, name) == ():
            raise InputError(f"--{name.replace('_', '-')} is empty; give at least one name, or leave it out.")


def _check_told_apart(kind: str, names: dict[str, str]) -> None:
    """Refuse two different ones that tables would call the same."""
    twice = next((name for name in names.values() if list(names.values()).count(name) > 1), None)
    if twice is not None:
        raise InputError(f"Two {kind} are called {twice} in the tables; rename one of the files.")


def _level(name: str) -> tuple[str, int]:
    """Name and number of triangles of a level."""
    levels = {key.lower(): (key, count) for key, count in LEVELS.items()}
    if name.lower() in levels:
        return levels[name.lower()]
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([kK]?)", name.strip())
    if not match:
        raise InputError(f"There is no level {name!r}; give a number of triangles, or one of {', '.join(LEVELS)}.")
    triangles = round(float(match[1]) * (1000 if match[2] else 1))
    if not FEWEST_TRIANGLES <= triangles <= MOST_TRIANGLES:
        raise InputError(
            f"A level must have between {FEWEST_TRIANGLES} and {MOST_TRIANGLES} triangles; {name} has {triangles}."
        )
    names = {count: key for key, count in LEVELS.items()}
    return names.get(triangles, f"{triangles // 1000}K" if triangles % 1000 == 0 else str(triangles)), triangles


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
    raise InputError(f"{unknown_name('motion', name, motion_names())} CMU trials are named like 07_02.")
