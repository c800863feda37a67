"""Which suffix is written by what."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from pb4u.errors import InputError
from pb4u.export.animation import write_gif, write_mp4
from pb4u.export.finite_frames import hold_finite
from pb4u.export.gltf import write_glb
from pb4u.export.obj_sequence import frame_path, write_obj_sequence
from pb4u.export.picture import write_still
from pb4u.export.point_cache import check_companion, companion, write_mdd, write_pc2
from pb4u.export.progress import Progress
from pb4u.export.usd import check_usd, write_usd
from pb4u.scene.trajectory import Trajectory

Writer = Callable[[Trajectory, Path, Progress | None], object]

WRITERS: dict[str, Writer] = {
    ".npz": lambda trajectory, path, progress: trajectory.save(path),
    ".obj": write_obj_sequence,
    ".pc2": write_pc2,
    ".mdd": write_mdd,
    ".usdc": write_usd,
    ".usda": write_usd,
    ".usdz": write_usd,
    ".glb": write_glb,
    ".png": lambda trajectory, path, progress: write_still(trajectory, path),
    ".jpg": lambda trajectory, path, progress: write_still(trajectory, path),
    ".gif": lambda trajectory, path, progress: write_gif(trajectory, path, progress=progress),
    ".mp4": lambda trajectory, path, progress: write_mp4(trajectory, path, progress=progress),
}
"""A writer may write more than one file, all of them in the folder of the path that it is given."""

_CHECKS: dict[str, Callable[[Path], None]] = {
    ".pc2": check_companion,
    ".mdd": check_companion,
    ".usdc": check_usd,
    ".usda": check_usd,
    ".usdz": check_usd,
}


def check_target(path: Path) -> None:
    """Look at what can be told before any work is done.

    Raises InputError for an unknown suffix, a folder that is absent or read-only, or a name that is taken by a
    folder; MissingExtraError when the format needs an extra.
    """
    suffix = path.suffix.lower()
    if suffix not in WRITERS:
        raise InputError(f"Cannot tell what to write from the name {path}: end it in one of {', '.join(WRITERS)}.")
    folder = path.parent
    if not folder.is_dir():
        raise InputError(f"The folder {folder} does not exist; make it first.")
    if not os.access(folder, os.W_OK):
        raise InputError(f"The folder {folder} cannot be written to.")
    if path.is_dir():
        raise InputError(f"{path} is a folder; choose another name.")
    if suffix in _CHECKS:
        _CHECKS[suffix](path)


def written_files(path: Path, frames: int) -> tuple[Path, ...]:
    """The files that `export` writes for a trajectory of so many frames."""
    suffix = path.suffix.lower()
    if suffix == ".obj":
        return tuple(frame_path(path, t) for t in range(frames))
    return (path, companion(path)) if suffix in (".pc2", ".mdd") else (path,)


def export(trajectory: Trajectory, path: str | Path, progress: Progress | None = None) -> Path:
    """Write `trajectory` in the format its suffix names; files appear when they are complete, or not at all.

    Frames that are not finite are held (`finite_frames`), except in .npz, which keeps what was simulated.
    Raises InputError for a target that cannot be written and MissingExtraError when the format needs an extra.
    """
    path = Path(path)
    check_target(path)
    suffix = path.suffix.lower()
    shown = trajectory if suffix == ".npz" else hold_finite(trajectory)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.stem}.", dir=path.parent) as folder:
            WRITERS[suffix](shown, Path(folder) / path.name, progress)
            for written in sorted(Path(folder).iterdir()):
                os.replace(written, path.with_name(written.name))
    except OSError as error:
        raise InputError(f"Cannot write {path}: {error.strerror or error}.") from error
    return path
