"""`pb4u convert`: a trajectory file into another format."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from pb4u.cli.console import FORMATS, FrameRange, JsonFlag, check_json_target, progress_bar, write_json, wrote


class Surface(str, Enum):
    """Which mesh is written."""

    simulated = "simulated"
    source = "source"


def convert(
    trajectory: Annotated[Path, typer.Argument(help="Trajectory .npz written by `pb4u simulate`.", show_default=False)],
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
        Surface, typer.Option(help="The simulated mesh, or the author's own with its vertex order, polygons and UVs.")
    ] = Surface.simulated,
    json: JsonFlag = None,
) -> None:
    """Write a trajectory in another format."""
    from pb4u.export.registry import check_target, export
    from pb4u.export.selection import on_source, select_frames
    from pb4u.scene.trajectory import Trajectory

    check_target(out)
    check_json_target(json)
    opened = Trajectory.open(trajectory)
    chosen = select_frames(opened, range_, every)
    if on is Surface.source:
        chosen = on_source(chosen)
    with progress_bar(f"writing {out.name}") as report:
        export(chosen, out, report)
    summary = {"out": str(out), "frames": chosen.frame_count, "vertices": chosen.positions.shape[1], "fps": chosen.fps}
    if json:
        write_json(summary, json)
    if json != "-":
        print(wrote([out], chosen.frame_count))
