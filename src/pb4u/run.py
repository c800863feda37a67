"""What a run is: garments on a moving body, and how they are simulated.

`Run` is the one record of it. Scene files, the flags of `pb4u simulate`, `make_scene`, `load_simulator`, the clips of a
dataset and the studio's form are made of its fields (`options.py`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pb4u.body.built_in import DEFAULT_BODY
from pb4u.environment import USUAL, Environment
from pb4u.errors import InputError, refuse_unknown
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.options import NONE, Flag, are_pairs, described, is_whole, require_fitting

if TYPE_CHECKING:
    from pb4u.body.animated_body import AnimatedBody
    from pb4u.body.body_model import ShapedBody
    from pb4u.garment.garment import Garment
    from pb4u.garment.material import Material
    from pb4u.motion.motion import Motion
    from pb4u.progress import Progress
    from pb4u.scene.trajectory import Trajectory
else:
    AnimatedBody = ShapedBody = Garment = Material = Motion = object

MOST_GARMENTS = 8
"""Garments of a scene: laying them over each other takes twenty times as long for eight as for two, and with more the
outermost has no room left within the sleeves of its own cut."""

REST = "body"
"""Name of what is left of a garment beside the parts that are named."""

SCENE, GARMENT, BODY, MODEL = "Scene", "Garment", "Body and motion", "Model"
RESEARCH = "For released research code"
"""Headings of the help."""

STEPS, REFINEMENT, PASSES, NETWORK = "steps", "refinement", "passes", "network"
"""Parts of a model that options apply to: steps of time, solver iterations that can be limited, passes, a network."""


def _model(metavar: str | None = None, **options: Any) -> Flag:
    return Flag(MODEL, metavar, section="run", **options)


def _trim(metavar: str, **options: Any) -> Flag:
    return Flag(GARMENT, f"NAME.PART={metavar}", by_part=True, **options)


def _by_part() -> Any:
    return field(default_factory=dict, hash=False)


@dataclass(frozen=True)
class WornGarment:
    """One garment of a run.

    Args:
        garment: Built-in garment (`pb4u assets` lists them), a mesh file (.obj, .ply, .stl, .glb, .gltf, .off), in
            metres, that fits the body at rest, a sewing pattern (GarmentCode's .json, a .toml of an SVG, or .npz of
            `pb4u dress`), or FILE.pkl:NAME of a garments dictionary of HOOD's family; in Python a Garment too.
        material: Built-in material (`pb4u assets`), a JSON file in SI units or a Material; NAME.PART=MATERIAL, or a
            table by part, gives one to a part: a panel of its pattern, what its file calls a material, or a band along
            a border, hem, waist, cuff, collar or border for all of them ("body" is the rest). Default: the garment's
            own, a fabric if it is built in and flat, else "default".
        pins: Vertices that follow the body: none, waist (highest border), collar (uppermost 4 cm of a border), hem
            (lowest border), loop:N (of the borders by their vertices, loop:0 the one with the most), a file of indices
            or a list. Default: the garment's own; none if it has elastic in its waist.
        triangles: Triangles to simulate. Default: the file's own, or 2,500 of a built-in garment.
        texture: Image mapped on the garment by its UVs, or projected from front and back if it has none. Default: the
            images and colours of its own file (OBJ with MTL, glTF).
        tacks: Pairs A:B of vertices that are sewn together, counted from 0 in the author's mesh.
        buttons: Buttons that close it in front, at even distances along the borders that face each other there.
        tucked: Whether it is tucked into the trousers or the skirt, whatever its place in the order.
        grain: Direction X,Y,Z of the warp where it is worn at rest, such as 0,1,0, on to each face. Default: the
            direction of its panels, or of UVs in metres; else its cloth is the same in all directions.
        pin_stiffness: Total stiffness of springs in place of fixed pins [N/m]: with 300 a waistband moves by
            centimetres. Default: pins hold exactly.
        pins_until: Written frame, counted from 0, at which its pins are released.
        band_width: Width of a band [m]. Default: 0.035 of a waist, 0.03 of a cuff, 0.02 of hem and collar, 0.01 of a
            border.
        layers: Layers of cloth of a part, such as 2 of a hem that is turned over.
        interfacing: Bending stiffness that is added to a part [N m], about 2e-5 for a soft interfacing and 2e-4 for a
            firm one.
        elastic: Rest length of a part along the border over that of its cloth, such as 0.8 of an elastic waistband;
            of webbing unless the part has a material.

    Raises:
        InputError: a value of a wrong type or out of range.
    """

    garment: Annotated[str | Path | Garment, Flag(GARMENT, "NAME|FILE", is_file=True, form="Garment")] = "tshirt"
    material: Annotated[
        str | Path | Material | Mapping[str, str | Path | Material] | None,
        Flag(GARMENT, "[NAME[.PART]=]MATERIAL", is_file=True, form="Material", by_part=True),
    ] = field(default=None, hash=False)
    pins: Annotated[str | Path | Sequence[int] | None, Flag(GARMENT, "[NAME=]PINS", is_file=True, form="Pins")] = None
    triangles: Annotated[int | None, Flag(GARMENT, "[NAME=]N", label="triangles_asked", form="Triangles")] = None
    texture: Annotated[str | Path | None, Flag(GARMENT, "[NAME=]FILE", is_file=True)] = None
    tacks: Annotated[Sequence[tuple[int, int]], Flag(GARMENT, "[NAME=]A:B")] = ()
    buttons: Annotated[int | None, Flag(GARMENT, "[NAME=]N", least=1, most=100)] = None
    tucked: Annotated[bool, Flag(GARMENT, form="Tucked in")] = False
    grain: Annotated[tuple[float, float, float] | None, Flag(GARMENT, "[NAME=]X,Y,Z")] = None
    pin_stiffness: Annotated[float | None, Flag(GARMENT, "[NAME=]K", least=1, most=10_000_000)] = None
    pins_until: Annotated[int | None, Flag(GARMENT, "[NAME=]FRAME", least=0)] = None
    band_width: Annotated[Mapping[str, float], _trim("METRES", least=0.001, most=1)] = _by_part()
    layers: Annotated[Mapping[str, int], _trim("N", least=1, most=10)] = _by_part()
    interfacing: Annotated[Mapping[str, float], _trim("B", least=0, most=0.1)] = _by_part()
    elastic: Annotated[Mapping[str, float], _trim("RATIO", least=0.5, most=1.5)] = _by_part()

    def __post_init__(self) -> None:
        if not (self.pins is None or isinstance(self.pins, str | Path)):
            indices = list(self.pins) if isinstance(self.pins, Collection) else [None]
            if not all(map(is_whole, indices)):
                raise InputError(f"The pins must be a name, a file or a list of vertex indices, not {self.pins!r}.")
            object.__setattr__(self, "pins", tuple(map(int, indices)))
        if not are_pairs(self.tacks):
            raise InputError(f"Tacks must be pairs of vertices, such as [[10, 210]], not {self.tacks!r}.")
        object.__setattr__(self, "tacks", tuple((int(a), int(b)) for a, b in self.tacks))
        if self.grain is not None:
            object.__setattr__(self, "grain", _checked_direction(self.grain))
        _check(self)

    @property
    def materials(self) -> Mapping[str, str | Path | Material]:
        """Its material by part, with the rest under "body"; empty if none is given."""
        if self.material is None:
            return {}
        return self.material if isinstance(self.material, Mapping) else {REST: self.material}

    @property
    def name(self) -> str:
        """Name of the garment; the stem of a file."""
        if not isinstance(self.garment, str | Path):
            return self.garment.name
        entry = DictionaryEntry.parse(self.garment)
        return Path(self.garment).stem if entry is None else entry.title


@dataclass(frozen=True)
class Run:
    """Garments on a moving body, by name, by path or as loaded objects, and how they are simulated.

    Args:
        garments: Garments worn, inner first; in Python also a single one.
        body: woman, man, anny (extra), a model file of the SMPL family, a rigged character (.glb, .gltf, .vrm),
            a sequence of vertices, or none (a garment file then hangs from its pins, or falls to the ground).
        body_shape: Shape of the body, such as height=0.7,weight=0.4, or beta0=1.5,beta1=-0.5 of a file of the SMPL
            family; `pb4u assets` lists the names.
        clip: Clip that a rigged character performs. Default: its first.
        body_parts: Meshes or materials that make the body of a character, separated by commas. Default: all but hair,
            eyes and clothes, by their names.
        body_units: Unit of length of a character's or a sequence's file. Default: recognised by the size of a person.
        motion: Built-in motion (`pb4u assets`), or .amc, .bvh, AMASS .npz, VTO .pkl, or from a video GVHMR .pt, WHAM
            .pkl or TRAM .npy (FILE:PERSON of several people). Default: walk, or the body's own.
        crop: Frames A to B-1 of a recording, at its own rate.
        arms_away: Angle in degrees by which hanging arms are swung away from the torso. Default: as far as needed to
            keep recorded arms out of the body; 0 leaves them as recorded.
        raw_motion: Use motion from a video unchanged, without smoothing and without fixing its feet.
        recorded_fps: Frames per second of a recording or a sequence of vertices. Default: what its file says, or 30.
        lead_in: Frames from the rest pose into the motion, simulated but not written. Default: one second, or 0
            without a body.
        keep_lead_in: Write the lead-in frames as well, before those that --frames counts.
        frames: Frames to write. Default: the whole recording, or 60 of a built-in motion.
        fps: Frames per second; a network runs at its own, and the result is resampled.
        seed: Seed of everything random.
        model: solver, quick-solver (only its first iterations: fastest for most garments on a processor), skinning, or
            a network by name, .safetensors file or .pth of the released code. Default: pb4u-light, or pb4u-wide
            with --refine 0; neither is the paper's network (`pb4u info --model pb4u-light`).
        refine: Most solver iterations after each step of a network, 0 for the network only; or of the quick solver. A
            step that they leave failed is retried.
        contact: Push the garment out of the body after each step; with self_contact also no face or edge of the body
            goes through cloth.
        self_contact: No cloth goes through cloth, within a garment and between garments. Default: on for the solver and
            networks; skinning cannot.
        propagation_steps: Propagation steps of a network. Default: by the mesh's resolution.
        scaling: Factors on what a network of Pb4U-GNet's family predicts: by the edge length at each vertex (the
            paper's), by the mean edge length, none, or band-split, which scales wrinkles and leaves bulk motion
            unchanged. Default: as it was trained.
        passes: How often a network is evaluated in each step. Default: its own number, and more if a step needs it, or
            1 with --refine.
        device: Where a network computes; the solver always runs on the CPU. Of several cards the first that
            CUDA_VISIBLE_DEVICES lists.
        precision: Precision of a network's matrix products; auto is bfloat16 where the device multiplies faster in it
            and --refine is above 0.
        first_frame: How frame 0 is made: settled by the solver; in one long_step of the method itself, as in the
            paper; placed as given; or as in the released codes: release (Pb4U-GNet), hood, mgn, contourcraft. auto is
            settled if the solver takes part.
        as_recorded: Play an SMPL recording (.pkl, AMASS .npz) unchanged, with its own shape, place and height;
            --arms-away 20 is the released code's separate_arms.
        omitted: Body vertices left out of contact: smpl_aux.pkl, or a list. Default: the body's own.
        rest_shape: Rest shape of built-in garments: flat panels with a grain, or moulded, as they sit on the body.
        friction_law: Friction on bodies and on the ground: coulomb, by the normal force and equal in all directions; or
            the paper's, which resists sliding down by a hundredth of that. auto is coulomb if the solver takes part.
        substeps: Steps of the solver in a frame, for what moves fast. A network keeps the time step of its training.
        time_integration: Rule of integration in time: implicit-euler, which damps swings and is that of networks, or
            bdf2, which keeps a swing's height. auto is bdf2 for the solvers.
        air: Air that presses on moving cloth and drags it. auto is on if the solver takes part, and with wind.
        environment: Gravity, air and ground; flags and entries of jobs files are the fields of `Environment`.

    Raises:
        InputError: a value of a wrong type or out of range, or one garment worn twice.
    """

    garments: tuple[WornGarment, ...] = field(default_factory=lambda: (WornGarment(),))
    body: Annotated[
        str | Path | ShapedBody | AnimatedBody | None, Flag(BODY, "NAME|FILE|none", is_file=True, form="Body")
    ] = DEFAULT_BODY
    body_shape: Annotated[Mapping[str, float], Flag(BODY, "KEY=VALUE,..")] = field(default_factory=dict, hash=False)
    clip: Annotated[str | None, Flag(BODY, "NAME")] = None
    body_parts: Annotated[str | None, Flag(BODY, "NAME,..")] = None
    body_units: Annotated[
        Literal["metres", "centimetres", "millimetres", "inches", "decimetres", "feet"] | None, Flag(BODY, "NAME")
    ] = None
    motion: Annotated[str | Path | Motion | None, Flag(BODY, "NAME|FILE", is_file=True, form="Motion")] = None
    crop: Annotated[tuple[int, int] | None, Flag(BODY, "A:B")] = None
    arms_away: Annotated[float | None, Flag(BODY, "DEGREES", least=0, most=90)] = None
    raw_motion: Annotated[bool, Flag(BODY, names=("--raw-motion/--steady-motion",))] = False
    recorded_fps: Annotated[float | None, Flag(BODY, "N", least=1, most=1000)] = None
    lead_in: Annotated[int | None, Flag(BODY, "N", least=0, form="Lead-in")] = None
    keep_lead_in: Annotated[bool, Flag(BODY, names=("--keep-lead-in/--drop-lead-in",))] = False
    frames: Annotated[int | None, Flag(SCENE, "N", least=1, label="frames_asked", form="Frames")] = None
    fps: Annotated[float, Flag(SCENE, "N", least=1, most=1000)] = 30.0
    seed: Annotated[int, Flag(SCENE, "N", least=0)] = 0
    model: Annotated[str | Path, _model("NAME|FILE", is_file=True, form="Model")] = "auto"
    refine: Annotated[int, _model("N", least=0, most=10_000, applies_to=REFINEMENT, form="Refine")] = 5
    contact: Annotated[bool, _model(applies_to=STEPS)] = True
    self_contact: Annotated[bool | None, _model(applies_to=STEPS)] = None
    propagation_steps: Annotated[int | None, _model("K", least=1, most=500, applies_to=NETWORK, label="")] = None
    scaling: Annotated[
        Literal["per-vertex", "mean", "none", "band-split"] | None, _model("NAME", applies_to=NETWORK)
    ] = None
    passes: Annotated[int | None, _model("N", least=1, most=1000, applies_to=PASSES)] = None
    device: Annotated[Literal["auto", "cpu", "cuda"], _model()] = "auto"
    precision: Annotated[Literal["auto", "float32", "bfloat16"], _model(applies_to=NETWORK)] = "auto"
    first_frame: Annotated[
        Literal["auto", "settled", "long_step", "placed", "release", "hood", "mgn", "contourcraft"],
        _model("NAME", names=("--first-frame", "--start"), applies_to=STEPS),
    ] = "auto"
    as_recorded: Annotated[bool, Flag(RESEARCH, names=("--as-recorded/--retargeted",))] = False
    omitted: Annotated[str | Path | None, Flag(RESEARCH, "FILE", is_file=True)] = None
    rest_shape: Annotated[Literal["flat", "moulded"], Flag(SCENE, "NAME")] = "flat"
    friction_law: Annotated[Literal["auto", "coulomb", "paper"], _model("NAME", applies_to=STEPS)] = "auto"
    substeps: Annotated[int, _model("N", least=1, most=100, applies_to=STEPS)] = 1
    time_integration: Annotated[Literal["auto", "implicit-euler", "bdf2"], _model("NAME", applies_to=STEPS)] = "auto"
    air: Annotated[Literal["auto", "on", "off"], _model("NAME", applies_to=STEPS)] = "auto"
    environment: Annotated[Environment, Flag(SCENE, applies_to=STEPS)] = USUAL

    def __post_init__(self) -> None:
        if isinstance(self.body, str) and self.body == NONE:
            object.__setattr__(self, "body", None)
        alone = isinstance(self.garments, WornGarment)
        object.__setattr__(self, "garments", (self.garments,) if alone else tuple(self.garments))
        object.__setattr__(self, "body_shape", _checked_shape(self.body_shape))
        if self.crop is not None:
            object.__setattr__(self, "crop", _checked_crop(self.crop))
        _check(self)
        if not isinstance(self.environment, Environment):
            raise InputError(f"The environment of a run must be a pb4u.Environment, not {self.environment!r}.")
        if any(self.environment.wind) and self.air == "off":
            raise InputError('wind has no effect without air: give air = "on" too (--air on).')
        if not self.garments:
            raise InputError("A scene needs at least one garment; none is given.")
        if len(self.garments) > MOST_GARMENTS:
            raise InputError(f"At most {MOST_GARMENTS} garments can be worn over each other, not {len(self.garments)}.")
        for number, garment in enumerate(self.garments):
            if not isinstance(garment, WornGarment):
                raise InputError(f"The garments of a run must be WornGarment objects, not {garment!r}.")
            if any(_is_same(garment.garment, inner.garment) for inner in self.garments[:number]):
                raise InputError(
                    f"The garment {garment.name} is worn twice, and both would lie in the same place; garments of one "
                    "name must come from different files."
                )

    @property
    def led_frames(self) -> int:
        """Number of frames from the rest pose into the motion, at its own rate."""
        usual = 0 if self.body is None else round(self.fps)
        return usual if self.lead_in is None else self.lead_in

    @property
    def written_frames(self) -> int | None:
        """Number of written frames, with a kept lead-in; None if the motion decides."""
        return self.frames if self.frames is None or not self.keep_lead_in else self.frames + self.led_frames

    @property
    def files(self) -> tuple[object, ...]:
        """All values that name an input: a built-in name, a file or a loaded object."""
        files = [value for g in self.garments for name in _files(WornGarment) for value in of_parts(getattr(g, name))]
        return *files, *(getattr(self, name) for name in _files(Run))

    @property
    def options(self) -> Run:
        """The same simulation of the default scene: runs of equal options share a simulator."""
        return Run(**{name: getattr(self, name) for name in entries("run")})

    @property
    def scene(self) -> Run:
        """The same scene with default options: runs of equal scenes share their loaded scene."""
        return replace(self, **{name: getattr(Run, name) for name in entries("run")})

    def at_rate(self, fps: float) -> Run:
        """The same stretch of time at another frame rate.

        Args:
            fps: frames per second [1/s].
        """
        if math.isclose(fps, self.fps):
            return replace(self, fps=fps)
        lead_in = None if self.lead_in is None else round(self.lead_in * fps / self.fps)
        garments = tuple(
            g if g.pins_until is None else replace(g, pins_until=round(g.pins_until * fps / self.fps))
            for g in self.garments
        )
        run = replace(self, garments=garments, fps=fps, lead_in=lead_in)
        if self.written_frames is None:
            return run
        # All that is written, a kept lead-in included, is rounded up once.
        written = math.ceil((self.written_frames - 1) * fps / self.fps) + 1
        return replace(run, frames=written - (run.led_frames if self.keep_lead_in else 0))

    def with_entries(self, given: Mapping[str, Any], folder: Path | None = None) -> Run:
        """Copy of this run with some entries replaced, in the way that flags replace entries of a scene file.

        Args:
            given: value by name. `garment` is one, or a list, inner first, and replaces all garments and their entries;
                other entries of a garment are one for all, or a list with one each, None for no change. `body` also
                replaces its shape, clip, parts and omitted vertices, `motion` crop, clip, recorded_fps and raw_motion.
                Without a body all entries of one are removed.
            folder: folder of relative paths; None leaves them unchanged.

        Raises:
            InputError: an entry is unknown, or a value cannot be used.
        """
        refuse_unknown("entry", given, ENTRIES)
        values = {name: located(name, value, folder) for name, value in given.items()}
        garments: Sequence[WornGarment] = self.garments
        if "garment" in values:
            names = values.pop("garment")
            garments = [WornGarment(name) for name in (names if isinstance(names, list | tuple) else [names])]
        for name in entries("garments"):
            if name in values:
                each_one = _one_each(name, values.pop(name), len(garments))
                garments = [
                    garment if value is None else replace(garment, **{name: value})
                    for garment, value in zip(garments, each_one, strict=True)
                ]
        bodiless = "body" in values and values["body"] in (None, NONE)
        of_bodies = [name for name, entry in described(Run).items() if entry.flag.panel in (BODY, RESEARCH)]
        belongings = {
            "body": of_bodies if bodiless else ("clip", "body_parts", "body_units", "omitted"),
            "motion": ("crop", "clip", "recorded_fps", "raw_motion"),
        }
        replaced = {
            other: described(Run)[other].default
            for name, others in belongings.items()
            if name in values
            for other in others
        }
        shape: dict[str, Any] = {"body_shape": {}} if "body" in values else {}
        inner: dict[str, dict[str, Any]] = {}
        for name in [name for name in values if described(Run)[name].holder]:
            inner.setdefault(described(Run)[name].holder, {})[name] = values.pop(name)
        changed = {holder: replace(getattr(self, holder), **values) for holder, values in inner.items()}
        return replace(self, garments=tuple(garments), **{**replaced, **shape, **changed, **values})

    def simulate(self, path: str | Path | None = None, progress: Progress | None = None) -> Trajectory:
        """Trajectory of the run; see `pb4u.simulation.run_simulation.simulate`.

        Args:
            path: trajectory file to write as frames come; None keeps the frames in memory.
            progress: called with (frames done, frames in all); by default a bar where standard error is a terminal.
        """
        return resolve_name("pb4u.simulation.run_simulation:simulate")(self, path, progress)

    @staticmethod
    def open(path: str | Path) -> Run:
        """Read a scene file (TOML): `[scene]`, one `[[garments]]` for each garment, `[run]`, `[environment]`.

        The entries are the fields of `Run`, of `WornGarment` and of `Environment`; omitted ones have their default,
        except friction, which is the paper's.

        Args:
            path: the file; paths in it are relative to it.

        Raises:
            InputError: the file is missing or no TOML, an entry is unknown, or a value cannot be used.
        """
        return resolve_name("pb4u.scene_file:read_scene")(Path(path))

    def save(self, path: str | Path) -> Path:
        """Write the scene file that `open` reads, with every value that is set.

        Args:
            path: the file; paths that are relative to the current folder are written relative to it.

        Raises:
            InputError: something is a loaded object, which has no name to be written.
        """
        resolve_name("pb4u.scene_file:write_scene")(self, Path(path))
        return Path(path)


def entries(section: str) -> tuple[str, ...]:
    """Names of the entries of a section of a scene file.

    Args:
        section: "garments" or one of `SECTIONS`.
    """
    if section == "garments":
        return tuple(described(WornGarment))
    return tuple(name for name, entry in described(Run).items() if entry.flag.section == section)


def of_parts(value: object) -> tuple[object, ...]:
    """The values for all parts of a garment, if an entry has one for each; else the single value.

    Args:
        value: of an entry.
    """
    return tuple(value.values()) if isinstance(value, Mapping) else (value,)


def _files(record: type) -> tuple[str, ...]:
    return tuple(name for name, entry in described(record).items() if entry.flag.is_file)


def names_file(name: str, value: object) -> bool:
    """Whether the value of an entry names a file: a path, or a text with a dot or a slash.

    Args:
        name: of the entry; most never name a file.
        value: of it.
    """
    looks_so = isinstance(value, str) and (bool(Path(value).suffix) or "/" in value or "\\" in value)
    return name in (*_files(Run), *_files(WornGarment)) and (looks_so or isinstance(value, Path))


def located(name: str, value: Any, folder: Path | None) -> Any:
    """The value of an entry, or a list of values, with relative paths resolved from a folder.

    Args:
        name: of the entry.
        value: of the entry; a `Path` stays unchanged.
        folder: folder of relative paths; None leaves them unchanged.
    """
    if isinstance(value, list | tuple):
        return [located(name, part, folder) for part in value]
    if isinstance(value, Mapping):
        return {part: located(name, entry, folder) for part, entry in value.items()}
    return folder / value if folder is not None and isinstance(value, str) and names_file(name, value) else value


SECTIONS = tuple(dict.fromkeys(entry.flag.section for entry in described(Run).values()))
"""Sections of a scene file besides those of garments."""

ENTRIES = tuple(name for section in ("garments", *SECTIONS) for name in entries(section))
"""Every entry of a scene file; no two sections have one of the same name."""

_OF_ARRAYS = {
    "garment": "pb4u.Garment(name, vertices, faces, material)",
    "body": "pb4u.body_from_arrays(vertices, faces)",
}
"""What takes arrays in the place of a value."""


def _check(record: Run | WornGarment) -> None:
    """Refuse values of a wrong kind or out of range."""
    for name, maker in _OF_ARRAYS.items():
        if hasattr(getattr(record, name, None), "__array__"):
            raise InputError(f"The {name} is an array; give a name, a path or {maker}.")
    require_fitting(record)


def _checked_shape(shape: Any) -> dict[str, float]:
    if not isinstance(shape, Mapping):
        raise InputError(f"The shape of the body must be numbers by name, such as height = 0.7, not {shape!r}.")
    for key, value in shape.items():
        if isinstance(value, bool) or not isinstance(value, Real):
            raise InputError(f"The shape parameter {key} must be a number, not {value!r}.")
    return {key: float(value) for key, value in shape.items()}


def _checked_crop(crop: Any) -> tuple[int, int]:
    if not isinstance(crop, list | tuple) or len(crop) != 2 or not all(is_whole(frame) for frame in crop):
        raise InputError(f"A crop must be two frame numbers, the first and the one after the last, not {crop!r}.")
    return crop[0], crop[1]


def _is_direction(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) == 3 and all(isinstance(number, Real) for number in value)


def _checked_direction(grain: Any) -> tuple[float, float, float]:
    if not _is_direction(grain) or not 0.0 < math.hypot(*grain) < math.inf:
        raise InputError(f"The grain must be a direction of three numbers, such as [0, 1, 0], not {grain!r}.")
    x, y, z = map(float, grain)
    return x, y, z


def _is_same(garment: object, other: object) -> bool:
    if isinstance(garment, str | Path) and isinstance(other, str | Path):
        return Path(garment).resolve() == Path(other).resolve()
    return garment is other


def _one_each(name: str, value: Any, count: int) -> Sequence[Any]:
    """The value for each of `count` garments.

    A list of whole numbers is one choice of pins, one of pairs of tacks, one of three numbers a grain.
    """
    is_indices = name == "pins" and isinstance(value, list | tuple) and all(map(is_whole, value))
    if (
        not isinstance(value, list | tuple)
        or is_indices
        or (name == "tacks" and are_pairs(value))
        or (name == "grain" and _is_direction(value))
    ):
        return [value] * count
    if len(value) != count:
        raise InputError(f"{name} has {len(value)} values for {count} garments; give one for all, or one each.")
    return value
