"""What surrounds garments and bodies: gravity, the air, and the ground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

from pb4u.errors import InputError
from pb4u.options import NONE, Flag, require_fitting

STANDARD_GRAVITY = 9.81
"""Magnitude of gravity [m/s^2] in every scene that does not say otherwise; forces and residuals are measured in it."""

UP = (0.0, 1.0, 0.0)
"""Normal of the ground, the vertical of the world: the files of the package have +Y up."""

STRONGEST_WIND = 50.0
"""Speed of the air [m/s] above which it is refused: a hurricane's."""

_AIR = ("wind", "gusts", "air_density")


@dataclass(frozen=True)
class Environment:
    """Gravity, air and ground of a scene.

    Args:
        gravity: Acceleration of free fall [m/s^2] along X, Y and Z, Y being up.
        wind: Mean velocity of the air [m/s] along X, Y and Z; needs --air on.
        gusts: Seed of the gusts of that wind. Default: a steady wind.
        air_density: Density of the air [kg/m^3].
        ground: Height of the ground plane [m]; none for no ground.

    Raises:
        InputError: a value is not a finite number, or out of range.
    """

    gravity: Annotated[tuple[float, float, float], Flag(metavar="X,Y,Z")] = (0.0, -STANDARD_GRAVITY, 0.0)
    wind: Annotated[tuple[float, float, float], Flag(metavar="X,Y,Z")] = (0.0, 0.0, 0.0)
    gusts: Annotated[int | None, Flag(metavar="SEED", least=0)] = None
    air_density: Annotated[float, Flag(metavar="RHO", least=0)] = 1.2
    ground: Annotated[float | None, Flag(metavar="HEIGHT|none")] = 0.0

    def __post_init__(self) -> None:
        if str(self.ground) == NONE:
            object.__setattr__(self, "ground", None)
        require_fitting(self)
        for name in ("gravity", "wind"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        for name in ("air_density", "ground"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, float(getattr(self, name)))
        if math.hypot(*self.wind) > STRONGEST_WIND:
            raise InputError(f"wind must be {STRONGEST_WIND:g} m/s or less, not {math.hypot(*self.wind):g}.")

    @property
    def in_still_air(self) -> Environment:
        """The same environment without wind."""
        return replace(self, wind=USUAL.wind)

    @property
    def metadata(self) -> dict[str, Any]:
        """Entries of a trajectory's metadata: gravity and ground, and other values that differ from the default."""
        usual = {"gravity": list(self.gravity), "ground_height": self.ground}
        return usual | {name: value for name, value in self.changed.items() if name in _AIR}

    @staticmethod
    def of_metadata(metadata: Mapping[str, Any]) -> Environment:
        """Environment of a trajectory; entries missing in its metadata have their default.

        Args:
            metadata: of the trajectory.
        """
        ground = metadata.get("ground_height", USUAL.ground)
        return Environment(ground=ground, **{name: metadata[name] for name in ("gravity", *_AIR) if name in metadata})

    @property
    def changed(self) -> dict[str, Any]:
        """Fields that differ from their default, by name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value != getattr(Environment, name)}


USUAL = Environment()
"""Standard gravity, still air, and the ground at height 0."""
