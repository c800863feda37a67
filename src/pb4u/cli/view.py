"""`pb4u view`: the studio in the browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from time import sleep as wait
from typing import Annotated

import typer


def view(
    trajectory: Annotated[
        Path | None, typer.Argument(help="Trajectory .npz written by `pb4u simulate`.", show_default=False)
    ] = None,
    other: Annotated[Path | None, typer.Argument(help="Another one, shown beside it.", show_default=False)] = None,
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 lets everyone on the network in.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen on; 0 takes a free one.")] = 8094,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    out: Annotated[Path | None, typer.Option(help="Folder that exports are kept in, besides being downloaded.")] = None,
) -> None:
    """Play, compare, simulate live and export, in the browser."""
    from pb4u.scene.trajectory import Trajectory
    from pb4u.viewer.clip import RecordedClip
    from pb4u.viewer.studio import Studio

    clips = tuple(RecordedClip(Trajectory.open(path), path.name) for path in (trajectory, other) if path is not None)
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
