"""Description of a scene before anything of it is loaded, with the defaults and checks that need no file.

Defaults of frames, motion and triangle counts depend on what is loaded: see `assembly` and `garment.library`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pb4u.errors import InputError
from pb4u.garment.dictionary_entry import DictionaryEntry

if TYPE_CHECKING:
    from pb4u.body.animated_body import AnimatedBody
    from pb4u.body.body_model import ShapedBody
    from pb4u.garment.garment import Garment
    from pb4u.garment.material import Material
    from pb4u.motion.motion import Motion


MOST_GARMENTS = 8
"""Garments of a scene: laying them over each other takes twenty times as long for eight as for two, and with more the
outermost has no room left within the sleeves of its own cut."""


@dataclass(frozen=True)
class GarmentSpecification:
    """One garment of a scene.

    Args:
        garment: built-in name, mesh file, or a Garment fitted to the resting body.
        material: built-in name, JSON file or Material; None is the garment's own, "default" of a name or file.
        pins: vertices that follow the body: a name, a border or a file as for `resolve_pins`, or vertex indices; None
            is the garment's own.
        triangles: number of triangles to simulate; None is the garment's own.
        tucked: whether it goes into what is worn from the waist, such as trousers, wherever it stands in the order.

    Raises:
        InputError: a value of a wrong type.
    """

    garment: str | Path | Garment = "tshirt"
    material: str | Path | Material | None = None
    pins: str | Path | Sequence[int] | None = None
    triangles: int | None = None
    tucked: bool = False

    def __post_init__(self) -> None:
        require_name("garment", self.garment)
        require_switch("tucked", self.tucked)
        require_name("material", self.material, optional=True)
        require_whole("number of triangles", self.triangles, optional=True)
        if self.pins is None or isinstance(self.pins, str | Path):
            return
        indices = list(self.pins) if isinstance(self.pins, Collection) else [None]
        if not all(isinstance(index, Integral) and not isinstance(index, bool) for index in indices):
            raise InputError(f"The pins must be a name, a file or a list of vertex indices, not {self.pins!r}.")
        object.__setattr__(self, "pins", tuple(map(int, indices)))

    @property
    def name(self) -> str:
        """Name of the garment; the stem of a file."""
        if not isinstance(self.garment, str | Path):
            return self.garment.name
        entry = DictionaryEntry.parse(self.garment)
        return Path(self.garment).stem if entry is None else entry.title


@dataclass(frozen=True)
class SceneSpecification:
    """Garments on a moving body, by name, by path or as loaded objects.

    Args:
        garments: the garments worn, inner first.
        body: built-in name, model or sequence file, or a body already loaded.
        body_shape: shape parameters of the body by name, see `pb4u assets`; a loaded body has its shape.
        motion: built-in name, recording or Motion; None is the default, or the body's own where it is a sequence.
        frames: frames to write; None is the whole recording, or two seconds of a motion without end.
        lead_in: frames simulated before the first written one, from the rest pose into the motion (reference 1.9).
        keep_lead_in: write those frames as well, before the `frames` asked for.
        crop: (first, stop) frames of a recording, counted at its own rate.
        fps: frames per second [1/s].
        arms_away: degrees by which hanging arms are held away from the torso; None: arms of a recording by as much as
            they would go into the body.
        seed: seed of procedural motion and of everything random.
        as_recorded: whether an SMPL recording is played as it is, on its own shape, place and height.
        omitted: file of the body vertices that are left out of contact; None is the body's own.

    Raises:
        InputError: a value of a wrong type or out of range, or one garment worn twice.
    """

    garments: tuple[GarmentSpecification, ...] = field(default_factory=lambda: (GarmentSpecification(),))
    body: str | Path | ShapedBody | AnimatedBody = "woman"
    body_shape: Mapping[str, float] = field(default_factory=dict, hash=False)
    motion: str | Path | Motion | None = None
    frames: int | None = None
    lead_in: int = 30
    keep_lead_in: bool = False
    crop: tuple[int, int] | None = None
    fps: float = 30.0
    arms_away: float | None = None
    seed: int = 0
    as_recorded: bool = False
    omitted: str | Path | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "garments", tuple(self.garments))
        object.__setattr__(self, "body_shape", _checked_shape(self.body_shape))
        if self.crop is not None:
            object.__setattr__(self, "crop", _checked_crop(self.crop))
        require_name("body", self.body)
        require_name("motion", self.motion, optional=True)
        require_switch("keep_lead_in", self.keep_lead_in)
        require_switch("as_recorded", self.as_recorded)
        require_name("omitted", self.omitted, optional=True)
        require_whole("number of frames", self.frames, optional=True)
        require_whole("lead-in", self.lead_in)
        require_whole("seed", self.seed)
        require_number("frames per second", self.fps)
        if self.arms_away is not None:
            require_number("angle that arms are held away by", self.arms_away)
        if self.frames is not None and self.frames < 1:
            raise InputError(f"The number of frames must be 1 or more, not {self.frames}.")
        if self.lead_in < 0:
            raise InputError(f"The lead-in must be 0 frames or more, not {self.lead_in}.")
        if not 1.0 <= self.fps <= 1000.0:
            raise InputError(f"Frames per second must lie between 1 and 1000, not {self.fps:g}.")
        if self.seed < 0:
            raise InputError(f"The seed must be 0 or more, not {self.seed}.")
        if self.arms_away is not None and not 0.0 <= self.arms_away <= 90.0:
            raise InputError(f"Arms are held away by 0 to 90 degrees, not {self.arms_away:g}.")
        self._check_garments()

    def _check_garments(self) -> None:
        if not self.garments:
            raise InputError("A scene has at least one garment; none is given.")
        if len(self.garments) > MOST_GARMENTS:
            raise InputError(f"At most {MOST_GARMENTS} garments are worn over each other, not {len(self.garments)}.")
        for worn in self.garments:
            if not isinstance(worn, GarmentSpecification):
                raise InputError(f"The garments of a scene are GarmentSpecification objects, not {worn!r}.")
        for number, worn in enumerate(self.garments):
            if any(_is_same(worn.garment, inner.garment) for inner in self.garments[:number]):
                raise InputError(
                    f"The garment {worn.name} is worn twice, and both would lie in the same place; garments of one "
                    "name must come from different files."
                )

    @property
    def written_frames(self) -> int | None:
        """Number of frames that are written, a kept lead-in included; None where the motion decides."""
        return self.frames if self.frames is None or not self.keep_lead_in else self.frames + self.lead_in

    def at_rate(self, fps: float) -> SceneSpecification:
        """Specification of the same stretch of time at another frame rate.

        Args:
            fps: frames per second [1/s].
        """
        if math.isclose(fps, self.fps):
            return replace(self, fps=fps)
        frames = None if self.frames is None else math.ceil((self.frames - 1) * fps / self.fps) + 1
        return replace(self, fps=fps, frames=frames, lead_in=round(self.lead_in * fps / self.fps))


def with_companions(path: Path) -> list[Path]:
    """A file and those that are read with it: the skeleton of a trial, the mesh of a point cache and its cache.

    Args:
        path: the file.
    """
    suffixes = {".amc": (".asf",), ".pc2": (".obj",), ".obj": (".pc2", ".mdd"), ".mdd": (".obj",)}
    beside = suffixes.get(path.suffix.lower(), ())
    near = (each for each in path.absolute().parent.glob("*") if each.suffix.lower() in beside)
    return [path, *(each for each in near if each.suffix.lower() == ".asf" or each.stem == path.stem)]


_MADE_OF_ARRAYS = {
    "garment": "pb4u.Garment(name, vertices, faces, material)",
    "body": "pb4u.body_from_arrays(vertices, faces)",
}


def require_name(what: str, value: object, optional: bool = False) -> None:
    """Refuse what is neither text, a path nor an object of the package.

    Args:
        what: name of the value in the refusal.
        value: as given.
        optional: whether None is accepted.

    Raises:
        InputError: the value is a number, a collection or empty text.
    """
    if hasattr(value, "__array__"):
        made = _MADE_OF_ARRAYS.get(what, "a loaded object")
        raise InputError(f"The {what} is an array; give a name, a path or {made}.")
    plain = isinstance(value, Real | Mapping | list | tuple | set) or (value is None and not optional)
    if plain or value == "":
        raise InputError(f"The {what} must be a name, a path or a loaded object, not {value!r}.")


def require_whole(what: str, value: object, optional: bool = False) -> None:
    """Refuse what is no whole number.

    Args:
        what: name of the value in the refusal.
        value: as given.
        optional: whether None is accepted.

    Raises:
        InputError: the value is no whole number.
    """
    if not (value is None and optional) and (isinstance(value, bool) or not isinstance(value, Integral)):
        raise InputError(f"The {what} must be a whole number, not {value!r}.")


def require_number(what: str, value: object) -> None:
    """Refuse what is no number.

    Args:
        what: name of the value in the refusal.
        value: as given.

    Raises:
        InputError: the value is no number.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"The {what} must be a number, not {value!r}.")


def require_switch(what: str, value: object) -> None:
    """Refuse what is neither true nor false.

    Args:
        what: name of the value in the refusal.
        value: as given.

    Raises:
        InputError: the value is neither True nor False.
    """
    if not isinstance(value, bool):
        raise InputError(f"The value of {what} must be true or false, not {value!r}.")


def _checked_shape(shape: Any) -> dict[str, float]:
    if not isinstance(shape, Mapping):
        raise InputError(f"The shape of the body must be numbers by name, such as height = 0.7, not {shape!r}.")
    for key, value in shape.items():
        require_number(f"shape parameter {key}", value)
    return {key: float(value) for key, value in shape.items()}


def _checked_crop(crop: Any) -> tuple[int, int]:
    if not isinstance(crop, list | tuple) or len(crop) != 2:
        raise InputError(f"A crop is two frames, the first and the one after the last, not {crop!r}.")
    for frame in crop:
        require_whole("frame of a crop", frame)
    return crop[0], crop[1]


def _is_same(garment: str | Path | Garment, other: str | Path | Garment) -> bool:
    if isinstance(garment, str | Path) and isinstance(other, str | Path):
        return Path(garment) == Path(other)
    return garment is other
