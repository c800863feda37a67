"""`pb4u convert` and `pb4u view`: a trajectory file into another format, and in the browser."""

from __future__ import annotations

import webbrowser
from collections.abc import Mapping
from pathlib import Path
from time import sleep as wait
from typing import Annotated, Any, Literal

import typer

from pb4u.cli.console import (
    FrameRange,
    JsonFlag,
    check_json_target,
    keep_inputs,
    say,
    tell,
    with_flags,
    wrote,
)
from pb4u.cli.outputs import FORMATS, OUTPUT_FLAGS
from pb4u.cli.picture_flags import PICTURE_FLAGS, view_of
from pb4u.progress import progress_bar


@with_flags(glb={"bones": OUTPUT_FLAGS["bones"]}, picture=PICTURE_FLAGS)
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
    *,
    glb: Mapping[str, Any],
    picture: Mapping[str, Any],
    json: JsonFlag = None,
) -> None:
    """Write a trajectory in another format."""
    from pb4u.compat.result_pickle import open_trajectory
    from pb4u.export.registry import check_bones, check_target, export
    from pb4u.export.selection import on_source, select_frames

    bones = glb["bones"]
    check_target(out)
    if bones is not None:
        check_bones(out, bones)
    check_json_target(json)
    keep_inputs([trajectory], [("--json", json)], [out], "OUT")
    seen = view_of([out], picture)
    opened = open_trajectory(trajectory)
    chosen = select_frames(opened, range_, every)
    if on == "source":
        chosen = on_source(chosen)
    with progress_bar(f"writing {out.name}") as report:
        export(chosen, out, report, seen, say, bones)
    summary = {"out": str(out), "frames": chosen.frame_count, "vertices": chosen.positions.shape[1], "fps": chosen.fps}
    tell(summary, json, wrote([out], chosen.frame_count))


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
    from pb4u.compat.result_pickle import open_trajectory
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
