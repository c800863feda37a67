"""Makes jobs of runs; validates all of them before any work."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

from pb4u.body.body_model import ShapedBody
from pb4u.body.character import Character
from pb4u.errors import InputError, unknown_name
from pb4u.garment.library import garment_names
from pb4u.garment.material import BUILT_IN, load_material
from pb4u.io.companions import with_companions
from pb4u.jobs.job import digest
from pb4u.measures.run_job import RunJob
from pb4u.motion.library import motion_names
from pb4u.run import Run
from pb4u.scene.moving_body import DEFAULT_MOTION, load_body_of
from pb4u.scene_file import named_file
from pb4u.simulation.checkpoint import weights_file
from pb4u.simulation.models import chosen_laws, chosen_model, simulator_of
from pb4u.simulation.stepwise_simulator import NetworkSimulator


class Model(NamedTuple):
    """A model as the jobs of a plan have it.

    Args:
        name: its name or file.
        device: "cpu" or "cuda".
        weights: SHA-256 of a network's weights; None for a model without weights.
        adapts: whether it has a number of propagation steps that can be set.
        fps: frame rate at which it must run [1/s]; None for any.
    """

    name: str
    device: str
    weights: str | None = None
    adapts: bool = False
    fps: float | None = None


class JobPlanner:
    """Makes jobs from runs; shared inputs, such as the content of a file, are read once."""

    def __init__(self) -> None:
        self._contents: dict[str, tuple[tuple[str, str, str], ...]] = {}
        self._checked: set[tuple[str, str]] = set()
        self._models: dict[Run, Model] = {}
        self._needs_motion = lru_cache(maxsize=None)(_needs_motion)

    def job(
        self, run: Run, label: str = "", keep: Literal["full", "half", "stills"] = "full", excess: bool = False
    ) -> RunJob:
        """Job of a run.

        Args:
            run: to simulate.
            label: name of its model in tables.
            keep: part of the trajectory to keep.
            excess: measure excess heights too.

        Raises:
            InputError: a name or a file that the run needs does not exist, or its model does not support the options.
        """
        self._require_names(run)
        model = self.model(run)
        resolved = run.with_entries({"model": model.name, "device": model.device, **chosen_laws(run)})
        how = run.clip, run.body_parts, run.body_units
        if run.motion is None and run.body is not None and self._needs_motion(str(run.body), *how):
            # Named, so that its label says what the body performs.
            resolved = replace(resolved, motion=DEFAULT_MOTION)
        contents = [row for value in dict.fromkeys(map(str, filter(None, resolved.files))) for row in self._read(value)]
        return RunJob(resolved, label, tuple(contents), model.weights, keep, excess)

    def model(self, run: Run) -> Model:
        """Model of a run.

        Args:
            run: its scene is ignored.

        Raises:
            InputError: there is no such model, or it does not support the options.
        """
        if run.options not in self._models:
            self._models[run.options] = _resolved(run)
        return self._models[run.options]

    def _require_names(self, run: Run) -> None:
        """Refuse names and files that are not there."""
        choices = {"garment": garment_names(), "motion": motion_names(), "material": tuple(BUILT_IN)}
        garments: list[tuple[str, object]] = [("garment", garment.garment) for garment in run.garments]
        cloths = [("material", value) for garment in run.garments for value in garment.materials.values()]
        values = [*garments, *cloths, *((kind, getattr(run, kind)) for kind in ("motion", "body", "omitted", "model"))]
        for kind, value in values:
            if value is None or (kind, str(value)) in self._checked or not isinstance(value, str | Path):
                continue
            self._checked.add((kind, str(value)))
            file = named_file(str(value))
            if file.suffix and not file.exists():
                raise InputError(f"There is no {kind} file {file}.")
            if kind == "body":
                load_body_of(str(value), run.clip, run.body_parts, run.body_units)
            elif kind == "material":
                load_material(value)
            elif not file.suffix and kind in choices and str(value) not in choices[kind]:
                raise unknown_name(kind, str(value), choices[kind])

    def _read(self, value: str) -> tuple[tuple[str, str, str], ...]:
        """The files that are read for a value, with their digests; none for a name."""
        if value not in self._contents:
            file = named_file(value)
            is_name = (not file.suffix and "/" not in value) or not file.exists()
            files = () if is_name else with_companions(file)
            self._contents[value] = tuple((value, str(file), digest(file)) for file in files)
        return self._contents[value]


def _needs_motion(body: str, clip: str | None, body_parts: str | None, body_units: str | None) -> bool:
    """Whether a body performs nothing by itself, as sequences and characters with a clip do."""
    loaded = load_body_of(body, clip, body_parts, body_units)
    if isinstance(loaded, Character):
        return loaded.clip is None and loaded.is_human
    return isinstance(loaded, ShapedBody)


def _resolved(run: Run) -> Model:
    simulator = simulator_of(run)
    name = chosen_model(run)
    device = "cuda" if str(simulator.settings().get("device")) == "cuda" else "cpu"
    if not isinstance(simulator, NetworkSimulator):
        return Model(name, device, fps=simulator.fps)
    with weights_file(name) as path:
        return Model(name, device, digest(path), simulator.checkpoint.model.network.propagates, simulator.fps)
