"""`pb4u convert` and `pb4u view`: a trajectory file into another format, and in the browser."""

from __future__ import annotations

import webbrowser
from collections.abc import Mapping
from pathlib import Path
from time import sleep as wait
from typing import Annotated, Any, Literal

import typer

from pb4u.cli.console import FrameRange, JsonFlag, check_json_target, keep_inputs, say, tell, verb, wrote
from pb4u.cli.outputs import FORMATS, OUTPUT_FLAGS
from pb4u.cli.picture_flags import PICTURE_FLAGS, view_of
from pb4u.cli.verbs import HelpAllFlag
from pb4u.progress import progress_bar


@verb(glb={"bones": OUTPUT_FLAGS["bones"]}, picture=PICTURE_FLAGS)
def convert(
    trajectory: Path,
    out: Annotated[Path, typer.Argument(help=f"File to write: {FORMATS}")],
    every: int = 1,
    range_: Annotated[FrameRange | None, typer.Option("--range", parser=FrameRange.parse, metavar="A:B")] = None,
    on: Literal["simulated", "source"] = "simulated",
    *,
    glb: Mapping[str, Any],
    picture: Mapping[str, Any],
    json: JsonFlag = None,
    help_all: HelpAllFlag = False,
) -> None:
    """Write a trajectory in another format.\f

    Args:
        trajectory: Trajectory .npz written by `pb4u simulate`, or a result .pkl of HOOD's family.
        out: file to write.
        every: Keep every N-th frame; the frame rate is divided by N.
        range_: First frame and the frame after the last, counted from 0.
        on: The simulated mesh, or the author's own with its vertex order, polygons and UVs.
        glb: number of bones of a .glb.
        picture: the fields of `PictureRequest`.
        json: file for the result.
        help_all: shows all options.
    """
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


@verb()
def view(
    trajectory: Annotated[Path | None, typer.Argument()] = None,
    other: Annotated[Path | None, typer.Argument()] = None,
    host: str = "127.0.0.1",
    port: int = 8094,
    browser: bool = True,
    out: Path | None = None,
) -> None:
    """Play, compare, simulate live and export, in the browser.\f

    Args:
        trajectory: Trajectory .npz of `pb4u simulate`, or a result .pkl of HOOD's family.
        other: Another trajectory, shown beside it.
        host: Address to listen on; 0.0.0.0 admits other machines that open its address with the token.
        port: Port to listen on; 0 chooses a free one.
        browser: Open the page in the browser.
        out: Folder in which exports are also saved, besides being downloaded.
    """
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
