"""Flags on the look of pictures, which every verb that draws shares."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pb4u.cli.record_flags import given_values, record_flags
from pb4u.errors import InputError
from pb4u.export.registry import check_view, is_drawn
from pb4u.options import Flag

if TYPE_CHECKING:
    from pb4u.export.shading import Colour
    from pb4u.export.view import View

_PANEL = "Pictures and videos"


@dataclass(frozen=True)
class PictureRequest:
    """The look of pictures as flags give it.

    Args:
        view: Where pictures are seen from: front, back, left, right, or an angle about the vertical. Default: 25.
        elevation: Angle of the camera above the ground, 0 to 90. Default: 8.
        turntable: Turn of the camera over the whole clip in degrees, such as 360. Default: 0.
        size: Size of a picture in pixels. Default: 560x800.
        colour: Colour of the innermost garment in pictures, as a name or #RRGGBB; given again, of the next. Default:
            that of its material.
        background: Colour of background and ground, as a name or #RRGGBB. Default: light grey.
        weave: Draw the threads of cloth that has UVs. Default: on.
    """

    view: Annotated[str | None, Flag(_PANEL, "SIDE|DEGREES")] = None
    elevation: Annotated[float | None, Flag(_PANEL, "DEGREES")] = None
    turntable: Annotated[float | None, Flag(_PANEL, "DEGREES")] = None
    size: Annotated[str | None, Flag(_PANEL, "WIDTHxHEIGHT")] = None
    colour: Annotated[Sequence[str], Flag(_PANEL, "NAME|#RRGGBB")] = ()
    background: Annotated[str | None, Flag(_PANEL, "NAME|#RRGGBB")] = None
    weave: Annotated[bool | None, Flag(_PANEL)] = None


PICTURE_FLAGS = record_flags(PictureRequest)


def view_of(targets: Sequence[Path], values: Mapping[str, Any]) -> View | None:
    """The view that the flags request; None if no such flag is given.

    Args:
        targets: files to write, with known suffixes; if a flag is given, at least one must have pictures.
        values: values of the flags by name.

    Raises:
        InputError: a flag has no such value, or the files have no pictures of that kind.
    """
    from pb4u.export.view import View

    values = dict.fromkeys(values) | given_values(PictureRequest, values)
    options: dict[str, Any] = {
        name: values[name] for name in ("elevation", "turntable", "weave") if values[name] is not None
    }
    if values["view"] is not None:
        options["azimuth"] = _azimuth(values["view"])
    if (size := values["size"]) is not None:
        width, _, height = size.lower().partition("x")
        if not (width.isdecimal() and height.isdecimal()):
            raise InputError(f"--size is WIDTHxHEIGHT in pixels, such as 1080x1920; not {size!r}.")
        options["width"], options["height"] = int(width), int(height)
    if values["colour"]:
        options["cloths"] = tuple(_rgb(colour) for colour in values["colour"])
    if values["background"] is not None:
        options["background"] = _rgb(values["background"])
    if not options:
        return None
    view = View(**options)
    # Where none is drawn, the first is told of.
    for target in [target for target in targets if is_drawn(target)] or targets[:1]:
        check_view(target, view)
    return view


def _azimuth(side: str) -> float:
    from pb4u.export.view import SIDES

    if side in SIDES:
        return SIDES[side]
    try:
        angle = float(side)
    except ValueError:
        angle = math.nan
    if not math.isfinite(angle):
        raise InputError(f"--view is one of {', '.join(SIDES)} or an angle in degrees, not {side!r}.")
    return angle


def _rgb(colour: str) -> Colour:
    from PIL import ImageColor

    try:
        r, g, b = ImageColor.getrgb(colour)[:3]
    except ValueError as error:
        raise InputError(f"{colour!r} is not a colour; give a name such as crimson, or #RRGGBB.") from error
    return r / 255, g / 255, b / 255
