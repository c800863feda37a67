"""What surrounds garments and bodies: gravity, the air, and the ground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any

from pb4u.errors import InputError

STANDARD_GRAVITY = 9.81
"""Magnitude of gravity [m/s^2] in every scene that does not say otherwise; forces and residuals are measured in it."""

UP = (0.0, 1.0, 0.0)
"""Normal of the ground, the vertical of the world: the files of the package have +Y up."""

STRONGEST_WIND = 50.0
"""Speed of the air [m/s] above which it is refused: a hurricane's."""

_AIR = ("wind", "gusts", "air_density")


def _vector(name: str, value: Any) -> tuple[float, ...]:
    if not hasattr(value, "__len__") or isinstance(value, str) or len(value) != 3:
        raise InputError(f"{name} must be three numbers, along X, Y and Z, not {value!r}.")
    return tuple(_number(name, part) for part in value)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise InputError(f"{name} must be a finite number, not {value!r}.")
    return float(value)


@dataclass(frozen=True)
class Environment:
    """Gravity, air and ground of a scene.

    Args:
        gravity: (3,) acceleration of free fall [m/s^2].
        wind: (3,) mean velocity of the air [m/s].
        gusts: seed of the gusts of that wind; None for a steady wind.
        air_density: density of the air [kg/m^3].
        ground: height of the ground plane [m]; None for no ground.

    Raises:
        InputError: a value is no finite number, or out of range.
    """

    gravity: tuple[float, float, float] = (0.0, -STANDARD_GRAVITY, 0.0)
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gusts: int | None = None
    air_density: float = 1.2
    ground: float | None = 0.0

    def __post_init__(self) -> None:
        for name in ("gravity", "wind"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))
        object.__setattr__(self, "air_density", _number("air_density", self.air_density))
        if self.ground is not None:
            object.__setattr__(self, "ground", _number("ground", self.ground))
        if self.air_density < 0.0:
            raise InputError(f"air_density must be 0 kg/m^3 or more, not {self.air_density:g}.")
        if math.hypot(*self.wind) > STRONGEST_WIND:
            raise InputError(f"wind must be {STRONGEST_WIND:g} m/s or less, not {math.hypot(*self.wind):g}.")
        if self.gusts is not None and (type(self.gusts) is not int or self.gusts < 0):
            raise InputError(f"gusts must be a whole number from 0 on, their seed, not {self.gusts!r}.")

    @property
    def in_still_air(self) -> Environment:
        """The same environment without wind."""
        return replace(self, wind=USUAL.wind)

    @property
    def metadata(self) -> dict[str, Any]:
        """Entries of a trajectory's metadata: gravity and ground, and what else is not as usual."""
        usual = {"gravity": list(self.gravity), "ground_height": self.ground}
        return usual | {name: value for name, value in self.changed.items() if name in _AIR}

    @staticmethod
    def of_metadata(metadata: Mapping[str, Any]) -> Environment:
        """Environment of a trajectory; what its metadata do not say is as usual.

        Args:
            metadata: of the trajectory.
        """
        ground = metadata.get("ground_height", USUAL.ground)
        return Environment(ground=ground, **{name: metadata[name] for name in ("gravity", *_AIR) if name in metadata})

    @property
    def changed(self) -> dict[str, Any]:
        """Fields that are not as usual, by name."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: value for name, value in values.items() if value != getattr(Environment, name)}


USUAL = Environment()
"""Standard gravity, still air, and the ground at height 0."""
