"""How pictures look: camera, size and colours."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pb4u.errors import InputError
from pb4u.export.shading import Colour

SIDES = {"front": 0.0, "left": 90.0, "back": 180.0, "right": -90.0}
"""Azimuths [deg] by name; left and right are the body's own."""

LEAST_SIDE, MOST_SIDE = 16, 8192
"""Pixels of a picture's side: below the least no garment is seen, above the most graphics drivers give up."""

HIGHEST_ELEVATION = 90.0


@dataclass(frozen=True)
class View:
    """Camera, size and colours of pictures.

    Args:
        width: of a picture [pixels].
        height: of a picture [pixels].
        azimuth: angle around the vertical [deg]; 0 is in front of the body, positive towards its left.
        elevation: angle above the horizontal [deg], 0 to 90, where the ground is seen from above.
        turntable: turn of the camera about the vertical over the whole clip [deg].
        show_body: whether the body is drawn.
        cloths: colours of the garments in order; further garments have their default colour.
        weave: whether the threads of the cloth are drawn where it has UVs.
        background: colour of background and ground, sRGB [0 to 1].

    Raises:
        InputError: a size or an angle is out of range.
    """

    width: int = 560
    height: int = 800
    azimuth: float = 25.0
    elevation: float = 8.0
    turntable: float = 0.0
    show_body: bool = True
    cloths: tuple[Colour, ...] = ()
    weave: bool = True
    background: Colour = (0.93, 0.935, 0.94)

    def __post_init__(self) -> None:
        if not all(LEAST_SIDE <= side <= MOST_SIDE for side in (self.width, self.height)):
            raise InputError(
                f"A picture must have {LEAST_SIDE} to {MOST_SIDE} pixels on each side, not {self.width} x "
                f"{self.height}."
            )
        if not (math.isfinite(self.azimuth) and math.isfinite(self.turntable)):
            raise InputError(
                f"Angles of the camera must be finite, not {self.azimuth:g} and {self.turntable:g} degrees."
            )
        if not 0.0 <= self.elevation <= HIGHEST_ELEVATION:
            raise InputError(
                f"The elevation of the camera must be 0 to {HIGHEST_ELEVATION:g} degrees, not {self.elevation:g}."
            )
