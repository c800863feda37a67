"""Description of a whole run: the scene and the simulation options."""

from __future__ import annotations

import math
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import tomli_w

from pb4u.atomic_file import replace_file
from pb4u.errors import InputError, InputWarning, Interrupted, unknown_name
from pb4u.progress import Progress, shown, unheard
from pb4u.reading_limits import read_text
from pb4u.scene.specification import (
    GarmentSpecification,
    SceneSpecification,
    require_name,
    require_switch,
    require_whole,
)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from pb4u.scene.scene import Scene
    from pb4u.scene.trajectory import Frame, Trajectory
    from pb4u.simulation.simulator import RunRecord, Simulator

FORMAT_VERSION = 1
"""Version of the scene files that are read and written."""

MOST_REFINING = 10_000
"""Limit against mistyped numbers: from some hundred on the solver ends by itself."""

MOST_PASSES = 1000
"""Limit against mistyped numbers: networks are trained with 1 to 4."""

_HEADING = """\
# A scene of pb4u: run it with `pb4u simulate` and the name of this file.
# Garments stand inner first. A value with a dot or a slash is a file, relative to this one; any other is a name.

"""
_SECTIONS = ("format_version", "scene", "garments", "run")
_FILES = ("garment", "material", "pins", "body", "motion", "model", "omitted")
"""Entries that are a name or a file."""

Device = Literal["auto", "cpu", "cuda"]
FirstFrameChoice = Literal["auto", "settled", "long_step", "release", "hood", "mgn", "contourcraft"]
Precision = Literal["auto", "float32", "bfloat16"]


@dataclass(frozen=True)
class RunSpecification:
    """A scene and the options of its simulation.

    Args:
        scene: garments, body and motion.
        model: "auto", "solver", "quick-solver", "skinning", "newton", a shipped network or a checkpoint file.
        contact: push the garment out of the body after each step (networks and solvers).
        self_contact: cloth feels cloth, within a garment and between garments; None is on for networks and solvers,
            which can.
        body_surface: cloth stays clear of faces and edges of the body too, not at its vertices alone.
        refine: most solver iterations after each step of a network, or of the quick solver; fewer where the cloth is
            near balance.
        passes: evaluations of a network in a step; None is its own number, or 1 where the solver refines.
        propagation_steps: override of K for a network; None follows the paper's rule.
        device: "auto", "cpu" or "cuda", for networks and newton.
        first_frame: way to make frame 0: "settled" by the solver, by one "long_step" of the method itself, or as the
            released code of "release" (Pb4U-GNet), "hood", "mgn" or "contourcraft" begins; "auto" is settled where the
            solver runs.
        precision: of a network's products: "float32", "bfloat16", or "auto": bfloat16 where the device multiplies
            faster in it and the solver refines.

    Raises:
        InputError: a value of a wrong type or out of range.
    """

    scene: SceneSpecification = field(default_factory=SceneSpecification)
    model: str | Path = "auto"
    contact: bool = True
    self_contact: bool | None = None
    body_surface: bool = False
    refine: int = 5
    passes: int | None = None
    propagation_steps: int | None = None
    device: Device = "auto"
    first_frame: FirstFrameChoice = "auto"
    precision: Precision = "auto"

    def __post_init__(self) -> None:
        require_name("model", self.model)
        require_switch("contact", self.contact)
        if self.self_contact is not None:
            require_switch("self_contact", self.self_contact)
        require_switch("body_surface", self.body_surface)
        require_whole("number of refining iterations", self.refine)
        require_whole("number of passes", self.passes, optional=True)
        require_whole("number of propagation steps", self.propagation_steps, optional=True)
        if not 0 <= self.refine <= MOST_REFINING:
            raise InputError(
                f"The number of refining iterations must be 0 or more, and {MOST_REFINING} at most, not {self.refine}."
            )
        if self.propagation_steps is not None and self.propagation_steps < 0:
            raise InputError(f"The number of propagation steps must be 0 or more, not {self.propagation_steps}.")
        if self.passes is not None and not 1 <= self.passes <= MOST_PASSES:
            raise InputError(f"A network takes at least 1 pass a step, and {MOST_PASSES} at most, not {self.passes}.")
        if self.device not in get_args(Device):
            raise unknown_name("device", str(self.device), get_args(Device))
        if self.first_frame not in get_args(FirstFrameChoice):
            raise unknown_name("first frame", str(self.first_frame), get_args(FirstFrameChoice))
        if self.precision not in get_args(Precision):
            raise unknown_name("precision", str(self.precision), get_args(Precision))

    def simulator(self) -> Simulator:
        """Simulator that the options name, loaded.

        Raises:
            InputError: an unknown model, a bad file or an impossible option.
        """
        # It brings torch, which a description does without.
        from pb4u.simulation.models import load_simulator

        return load_simulator(
            self.model,
            contact=self.contact,
            self_contact=self.self_contact,
            body_surface=self.body_surface,
            refine=self.refine,
            propagation_steps=self.propagation_steps,
            passes=self.passes,
            device=self.device,
            first_frame=self.first_frame,
            precision=self.precision,
        )

    def assemble(self, simulator: Simulator) -> Scene:
        """Scene, loaded, at the frame rate that the simulator has to run at.

        Args:
            simulator: simulator that will simulate it.

        Raises:
            InputError: something of the scene cannot be used.

        Warns:
            InputWarning: that rate is another than the scene's, or the scene has something unusual.
        """
        from pb4u.scene.assembly import assemble

        asked, simulated = self.scene.fps, simulator.fps or self.scene.fps
        if not math.isclose(simulated, asked):
            sentence = (
                f"{simulator.name} runs at {simulated:g} frames per second; the result is resampled to {asked:g}."
            )
            warnings.warn(sentence, InputWarning, stacklevel=2)
        return assemble(self.scene.at_rate(simulated))

    def simulate(self, path: str | Path | None = None, progress: Progress | None = None) -> Trajectory:
        """Simulate the whole run.

        Args:
            path: trajectory file to write as frames come; None keeps the frames in memory.
            progress: called with (frames done, frames in all), lead-in included; by default a bar on standard error
                where that is a terminal. `pb4u.progress.unheard` is quiet.

        Returns:
            The frames at the scene's own rate; fewer than asked for where the state stopped being finite.

        Raises:
            InputError: something of the run cannot be used.
        """
        simulator = self.simulator()
        scene = self.assemble(simulator)
        with shown(progress, simulator.name) as heard:
            return self.roll_out(simulator, scene, path, progress=heard)

    def files(self) -> tuple[object, ...]:
        """Everything that names what is read, be it a built-in name, a file or a loaded object."""
        worn = [value for each in self.scene.garments for value in (each.garment, each.material, each.pins)]
        return *worn, self.scene.body, self.scene.motion, self.scene.omitted, self.model

    def roll_out(
        self,
        simulator: Simulator,
        scene: Scene,
        path: str | Path | None = None,
        record: RunRecord | None = None,
        progress: Progress = unheard,
        interrupted: Path | None = None,
        seen: Callable[[Frame], None] | None = None,
    ) -> Trajectory:
        """Simulate a scene that was assembled from this description.

        Args:
            simulator: the one that `simulator` gives.
            scene: the one that `assemble` gives.
            path: trajectory file to write; as frames come, where they need no resampling. None keeps them in memory.
            record: receives the cost of the run and how it ended.
            progress: called with (frames done, frames in all), lead-in included.
            interrupted: trajectory file for the frames until an interrupt, where they were kept in memory.
            seen: called with every frame, at the rate it is simulated at.

        Returns:
            The frames at the scene's own rate.

        Raises:
            Interrupted: the frames until an interrupt are in a file, which it names.
        """
        from pb4u.export.selection import resampled
        from pb4u.scene.trajectory import Frame, Trajectory

        is_resampled = not math.isclose(scene.fps, self.scene.fps)
        if path is not None and not is_resampled:
            return simulator.simulate_to(scene, path, record, progress, seen)
        header, rows = simulator.header(scene), list[Frame]()
        try:
            for frame in simulator.written_frames(scene, record, progress):
                rows.append(frame)
                if seen is not None:
                    seen(frame)
        except KeyboardInterrupt as error:
            if rows and interrupted is not None:
                kept = Trajectory.collect(header, rows).save(interrupted)
                raise Interrupted(f"the first {len(rows)} frames are in {kept}", getattr(error, "signal", 2)) from error
            raise
        trajectory = Trajectory.collect(header, rows)
        if is_resampled:
            trajectory = resampled(trajectory, self.scene.fps, self.scene.written_frames)
            if record is not None and record.failed_at is not None:
                record.failed_at = trajectory.frame_count
        if path is not None:
            trajectory.save(path)
        return trajectory

    @classmethod
    def open(cls, path: str | Path) -> RunSpecification:
        """Read a scene file (TOML): `[scene]`, one `[[garments]]` for each garment, `[run]`.

        The entries are the arguments of the three specifications; what is left out has its default.

        Args:
            path: the file; paths in it are relative to it.

        Raises:
            InputError: the file is missing or no TOML, an entry is unknown, or a value cannot be used.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"There is no scene file {path}.")
        tables = read_tables(path, "a scene file")
        try:
            return cls._of_tables(tables, path.parent)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    @classmethod
    def _of_tables(cls, tables: dict[str, Any], folder: Path) -> RunSpecification:
        _refuse_unknown("section", tables, _SECTIONS)
        version = tables.get("format_version", FORMAT_VERSION)
        if version != FORMAT_VERSION:
            raise InputError(f"The file is of format version {version!r}; this version reads {FORMAT_VERSION}.")
        garments = tables.get("garments", [{}])
        if not isinstance(garments, list):
            raise InputError("Each garment is a section of its own, written [[garments]].")
        worn = tuple(GarmentSpecification(**_entries("[[garments]]", each, _GARMENT, folder)) for each in garments)
        scene = SceneSpecification(worn, **_entries("[scene]", tables.get("scene", {}), _SCENE, folder))
        return cls(scene, **_entries("[run]", tables.get("run", {}), _RUN, folder))

    def with_entries(self, entries: Mapping[str, Any], folder: Path) -> RunSpecification:
        """Description with other values, named as in a scene file but without its sections; they win as flags do.

        Args:
            entries: value by name, of `ENTRIES`. `garment` is one, or a list, inner first, and replaces all garments
                with what belongs to them; `material`, `pins`, `triangles` and `tucked` are one for all garments, or a
                list with one for each. `body` replaces its shape too, `motion` its crop.
            folder: relative files are found from there.

        Raises:
            InputError: an entry is unknown, or a value cannot be used.
        """
        _refuse_unknown("entry", entries, ENTRIES)
        given = {name: _located(name, value, folder) for name, value in entries.items()}
        scene = {name: given[name] for name in _SCENE if name in given}
        if "garment" in given:
            named = given["garment"]
            worn = [GarmentSpecification(each) for each in (named if isinstance(named, list) else [named])]
        else:
            worn = list(self.scene.garments)
        for name in _GARMENT:
            if name in given and name != "garment":
                values = _one_each(name, given[name], len(worn))
                worn = [replace(each, **{name: value}) for each, value in zip(worn, values, strict=True)]
        if "body" in given:
            scene.setdefault("body_shape", {})
        if "motion" in given:
            scene.setdefault("crop", None)
        run = {name: given[name] for name in _RUN if name in given}
        return replace(self, scene=replace(self.scene, garments=tuple(worn), **scene), **run)

    def save(self, path: str | Path) -> Path:
        """Write the scene file that `open` reads, with every value that is set.

        Args:
            path: the file; paths that are relative to the current folder are written relative to it.

        Raises:
            InputError: something is a loaded object, which has no name to be written.
        """
        path = Path(path)
        scene = {"format_version": FORMAT_VERSION, "scene": _written(self.scene, _SCENE, path.parent)}
        garments = [_written(each, _GARMENT, path.parent) for each in self.scene.garments]
        # One by one: the library writes short tables of a list on a line each, where nobody finds room for an entry.
        sections = [
            tomli_w.dumps(scene),
            *("[[garments]]\n" + tomli_w.dumps(each) for each in garments),
            tomli_w.dumps({"run": _written(self, _RUN, path.parent)}),
        ]
        replace_file(path, (_HEADING + "\n".join(sections)).encode())
        return path


_GARMENT, _SCENE, _RUN = (
    tuple(each.name for each in fields(kind) if each.name not in ("garments", "scene"))
    for kind in (GarmentSpecification, SceneSpecification, RunSpecification)
)
ENTRIES = (*_GARMENT, *_SCENE, *_RUN)
"""Every entry of a scene file; no two sections have one of the same name."""


def read_tables(path: Path, kind: str) -> dict[str, Any]:
    """The tables of a TOML file.

    Args:
        path: the file.
        kind: what it is, such as "a scene file".

    Raises:
        InputError: it is no TOML, or too large.
    """
    try:
        return tomllib.loads(read_text(path, kind))
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no {kind.partition(' ')[2]}, which is TOML: {error}.") from None


def _refuse_unknown(what: str, given: Iterable[str], known: tuple[str, ...]) -> None:
    for name in given:
        if name not in known:
            raise unknown_name(what, name, known)


def _entries(section: str, table: Any, known: tuple[str, ...], folder: Path) -> dict[str, Any]:
    """The entries of a section, its files found from the `folder` of the scene file."""
    if not isinstance(table, dict):
        raise InputError(f"The section {section} must hold entries such as name = value, not {table!r}.")
    _refuse_unknown(f"entry of {section}", table, known)
    return {name: _located(name, value, folder) for name, value in table.items()}


def _located(name: str, value: Any, folder: Path) -> Any:
    if isinstance(value, list):
        return [_located(name, each, folder) for each in value]
    return folder / value if name in _FILES and isinstance(value, str) and _is_file(value) else value


def _one_each(name: str, value: Any, count: int) -> list[Any]:
    """The value for each of `count` garments; a list of whole numbers is one choice of pins."""
    is_indices = name == "pins" and isinstance(value, list) and all(isinstance(each, int) for each in value)
    if not isinstance(value, list) or is_indices:
        return [value] * count
    if len(value) != count:
        raise InputError(f"{name} has {len(value)} values for {count} garments; give one for all, or one each.")
    return value


def _is_file(value: str) -> bool:
    return bool(Path(value).suffix) or "/" in value or os.sep in value


def _written(specification: Any, names: tuple[str, ...], folder: Path) -> dict[str, Any]:
    """What is set of a specification, as TOML holds it."""
    values = {name: getattr(specification, name) for name in names}
    return {name: _plain(name, value, folder) for name, value in values.items() if value is not None and value != {}}


def _plain(name: str, value: Any, folder: Path) -> Any:
    if name in _FILES and (isinstance(value, Path) or (isinstance(value, str) and _is_file(value))):
        file = value if os.path.isabs(value) else os.path.relpath(value, folder)
        written = Path(file).as_posix()
        return written if _is_file(written) else f"./{written}"
    if isinstance(value, dict):
        return {key: _plain(key, entry, folder) for key, entry in value.items()}
    if isinstance(value, tuple):
        return [_plain("", entry, folder) for entry in value]
    if isinstance(value, str | bool):
        return value
    if isinstance(value, Real):
        return int(value) if isinstance(value, Integral) else float(value)
    raise InputError(
        f"The {name} {getattr(value, 'name', value)} is a loaded object, which a scene file cannot hold; give it by "
        "name or file."
    )
