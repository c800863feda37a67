"""`pb4u convert` and `pb4u view`: a trajectory file into another format, and in the browser."""

from __future__ import annotations

import math
import webbrowser
from pathlib import Path
from time import sleep as wait
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from pb4u.cli.console import (
    FORMATS,
    FrameRange,
    JsonFlag,
    check_json_target,
    keep_inputs,
    progress_bar,
    write_json,
    wrote,
)
from pb4u.errors import InputError

if TYPE_CHECKING:
    from pb4u.export.picture import View


def convert(
    trajectory: Annotated[
        Path,
        typer.Argument(
            help="Trajectory .npz written by `pb4u simulate`, or a result .pkl of HOOD's family.", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Argument(help=f"File to write: {FORMATS}", show_default=False)],
    every: Annotated[int, typer.Option(help="Keep every N-th frame; the frame rate is divided by N.")] = 1,
    range_: Annotated[
        FrameRange | None,
        typer.Option(
            "--range",
            parser=FrameRange.parse,
            metavar="A:B",
            help="First frame and the frame after the last, counted from 0.",
        ),
    ] = None,
    on: Annotated[
        Literal["simulated", "source"],
        typer.Option(help="The simulated mesh, or the author's own with its vertex order, polygons and UVs."),
    ] = "simulated",
    view: Annotated[
        str | None,
        typer.Option(
            metavar="SIDE|DEGREES",
            help="Where pictures are seen from: front, back, left, right, or an angle about the vertical. Default: 25.",
        ),
    ] = None,
    turntable: Annotated[
        float | None,
        typer.Option(metavar="DEGREES", help="Turn of the camera over the whole clip, as 360. Default: 0."),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Size of a picture in pixels. Default: 560x800.")
    ] = None,
    colour: Annotated[
        str | None, typer.Option(help="Colour of the first garment in pictures, as a name or #RRGGBB. Default: blue.")
    ] = None,
    background: Annotated[
        str | None, typer.Option(help="Colour behind it, as a name or #RRGGBB. Default: light grey.")
    ] = None,
    json: JsonFlag = None,
) -> None:
    """Write a trajectory in another format."""
    from pb4u.export.registry import check_target, export
    from pb4u.export.result_pickle import open_trajectory
    from pb4u.export.selection import on_source, select_frames

    check_target(out)
    check_json_target(json)
    keep_inputs([trajectory], [("--json", json)], [out])
    seen = _view(view, turntable, size, colour, background)
    opened = open_trajectory(trajectory)
    chosen = select_frames(opened, range_, every)
    if on == "source":
        chosen = on_source(chosen)
    with progress_bar(f"writing {out.name}") as report:
        export(chosen, out, report, seen)
    summary = {"out": str(out), "frames": chosen.frame_count, "vertices": chosen.positions.shape[1], "fps": chosen.fps}
    if json:
        write_json(summary, json)
    if json != "-":
        print(wrote([out], chosen.frame_count))


def _view(
    side: str | None, turntable: float | None, size: str | None, colour: str | None, background: str | None
) -> View | None:
    """The view that the flags ask for; None where none is given. Raises InputError for what is none."""
    from pb4u.export.picture import SIDES, View

    asked: dict[str, Any] = {}
    if side is not None:
        asked["azimuth"] = SIDES[side] if side in SIDES else _number(side)
    if turntable is not None:
        asked["turntable"] = turntable
    if size is not None:
        width, _, height = size.lower().partition("x")
        if not (width.isdecimal() and height.isdecimal() and all(16 <= int(n) <= 8192 for n in (width, height))):
            raise InputError(f"--size is WIDTHxHEIGHT in pixels, 16 to 8192 each, such as 1080x1920; not {size!r}.")
        asked["width"], asked["height"] = int(width), int(height)
    for name, given in (("cloth", colour), ("background", background)):
        if given is not None:
            asked[name] = _rgb(given)
    return View(**asked) if asked else None


def _number(side: str) -> float:
    from pb4u.export.picture import SIDES

    try:
        angle = float(side)
    except ValueError:
        angle = math.nan
    if not math.isfinite(angle):
        raise InputError(f"--view is one of {', '.join(SIDES)} or an angle in degrees, not {side!r}.")
    return angle


def _rgb(colour: str) -> tuple[float, float, float]:
    from PIL import ImageColor

    try:
        r, g, b = ImageColor.getrgb(colour)[:3]
    except ValueError as error:
        raise InputError(f"{colour!r} is no colour; give a name such as crimson, or #RRGGBB.") from error
    return r / 255, g / 255, b / 255


def view(
    trajectory: Annotated[
        Path | None,
        typer.Argument(
            help="Trajectory .npz of `pb4u simulate`, or a result .pkl of HOOD's family.", show_default=False
        ),
    ] = None,
    other: Annotated[Path | None, typer.Argument(help="Another one, shown beside it.", show_default=False)] = None,
    host: Annotated[
        str,
        typer.Option(
            help="Address to listen on; 0.0.0.0 lets in who comes by the network with the token of its address."
        ),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen on; 0 takes a free one.")] = 8094,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    out: Annotated[Path | None, typer.Option(help="Folder that exports are kept in, besides being downloaded.")] = None,
) -> None:
    """Play, compare, simulate live and export, in the browser."""
    from pb4u.export.result_pickle import open_trajectory
    from pb4u.viewer.clip import RecordedClip
    from pb4u.viewer.studio import Studio

    clips = tuple(RecordedClip(open_trajectory(path), path.name) for path in (trajectory, other) if path is not None)
    studio = Studio(clips, host, port, out)
    try:
        print(f"The studio is at {studio.url} (Ctrl-C ends it).", flush=True)
        if browser:
            webbrowser.open(studio.url)
        while True:
            wait(3600)
    except KeyboardInterrupt:
        pass
    finally:
        studio.close()
