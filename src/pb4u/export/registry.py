"""Which suffix is written by what."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from pb4u.errors import InputError
from pb4u.export.animation import Progress, write_gif, write_mp4
from pb4u.export.obj_sequence import write_obj_sequence
from pb4u.export.picture import write_still
from pb4u.scene.trajectory import Trajectory

Writer = Callable[[Trajectory, Path, Progress | None], None]


def _beside(write: Writer) -> Writer:
    """Write next to the target and move into place, so that a failure leaves nothing half-written."""

    def write_beside(trajectory: Trajectory, path: Path, progress: Progress | None) -> None:
        beside = path.with_name(f".{path.stem}.part{path.suffix}")
        try:
            write(trajectory, beside, progress)
            os.replace(beside, path)
        except OSError as error:
            raise InputError(f"Cannot write {path}: {error.strerror or error}.") from error
        finally:
            beside.unlink(missing_ok=True)

    return write_beside


WRITERS: dict[str, Writer] = {
    ".npz": lambda trajectory, path, progress: _discard(trajectory.save(path)),
    ".obj": lambda trajectory, path, progress: write_obj_sequence(trajectory, path),
    ".png": _beside(lambda trajectory, path, progress: write_still(trajectory, path)),
    ".gif": _beside(lambda trajectory, path, progress: write_gif(trajectory, path, progress=progress)),
    ".mp4": _beside(lambda trajectory, path, progress: write_mp4(trajectory, path, progress=progress)),
}


def _discard(_: object) -> None:
    return None


def check_target(path: Path) -> None:
    """Raises InputError for an unknown suffix or a folder that is absent or read-only, before any work is done."""
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"Cannot tell what to write from the name {path}: end it in one of {', '.join(WRITERS)}.")
    folder = path.parent if str(path.parent) else Path()
    if not folder.is_dir():
        raise InputError(f"The folder {folder} does not exist; make it first.")
    if not os.access(folder, os.W_OK):
        raise InputError(f"The folder {folder} cannot be written to.")


def export(trajectory: Trajectory, path: str | Path, progress: Progress | None = None) -> Path:
    """Write `trajectory` in the format its suffix names. Raises InputError for an unknown suffix or folder."""
    path = Path(path)
    check_target(path)
    WRITERS[path.suffix.lower()](trajectory, path, progress)
    return path
