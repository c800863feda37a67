"""Which suffix is written by what. Importing this module imports no writer."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from pb4u.errors import InputError, on_disk
from pb4u.io.atomic_file import LOCK, MARK, check_writable, move_into_place, working_folder
from pb4u.progress import Progress, no_progress
from pb4u.registry import Registry

if TYPE_CHECKING:
    from pb4u.export.view import View
    from pb4u.scene.trajectory import Trajectory


@dataclass(frozen=True)
class Format:
    """A format of files, by suffix; functions are named "module:function" and imported when needed.

    Args:
        suffixes: of the file names, in lower case.
        description: one sentence for the command line, without its full stop.
        writer: called with the trajectory, the path and the progress to call; it may write more than one file, all in
            the folder of the path, and may return a note for the user.
        check: called with the path before any work is done; raises where the format cannot be written there.
        files: called with the path and the number of frames; the files written, where that is more than the path.
        stale: called with the path and the number of frames; gives the surplus files of a longer sequence written
            before, to be deleted after the export.
        coloured: whether it shows images and colours of garments; where a remeshing has lost them, the author's own
            mesh is written.
        finite: whether frames that are not finite are replaced first (`finite_frames`).
        drawn: whether it shows pictures; the writer takes a `view` then.
        side_multiple: number of which width and height of its pictures must be multiples [pixels].
    """

    suffixes: tuple[str, ...]
    description: str
    writer: str
    check: str = ""
    files: str = ""
    stale: str = ""
    coloured: bool = False
    finite: bool = True
    drawn: bool = False
    side_multiple: int = 1


_OWN = (
    Format((".npz",), "NPZ is exact and keeps velocities", "pb4u.export.registry:write_npz", finite=False),
    Format(
        (".obj",),
        "OBJ is good to 0.5 µm, one file a frame, the garment alone",
        "pb4u.export.mesh_sequence:write_obj_sequence",
        "pb4u.export.mesh_sequence:check_frames",
        files="pb4u.export.mesh_sequence:frame_files",
        stale="pb4u.export.mesh_sequence:later_frame_files",
    ),
    Format(
        (".pc2",),
        "PC2 is exact, the garment alone, and comes with an .obj; in Blender, set the frame rate to the trajectory's",
        "pb4u.export.mesh_sequence:write_pc2",
        "pb4u.export.mesh_sequence:check_companion",
        "pb4u.export.mesh_sequence:cache_files",
    ),
    Format(
        (".mdd",),
        "MDD is as PC2",
        "pb4u.export.mesh_sequence:write_mdd",
        "pb4u.export.mesh_sequence:check_companion",
        "pb4u.export.mesh_sequence:cache_files",
    ),
    Format(
        (".abc",), "ABC (Alembic) is exact", "pb4u.export.alembic:write_alembic", "pb4u.export.alembic:check_alembic"
    ),
    Format(
        (".usdc", ".usda", ".usdz"),
        "USD is exact",
        "pb4u.export.usd:write_usd",
        "pb4u.export.usd:check_usd",
        coloured=True,
    ),
    Format(
        (".glb",),
        "GLB is within 1 mm (else a warning says how far off)",
        "pb4u.export.gltf:write_glb",
        coloured=True,
    ),
    Format(
        (".png", ".jpg"),
        "PNG and JPG show five moments side by side",
        "pb4u.export.picture:write_still",
        coloured=True,
        drawn=True,
    ),
    Format(
        (".gif",),
        "GIF leaves frames out, down to about 15 a second",
        "pb4u.export.picture:write_gif",
        coloured=True,
        drawn=True,
    ),
    Format(
        (".mp4",),
        "MP4 shows every frame, in H.264 where an encoder for it works here (such as an ffmpeg's), else in VP9",
        "pb4u.export.picture:write_mp4",
        "pb4u.export.video_writer:check_mp4",
        coloured=True,
        drawn=True,
        side_multiple=2,  # colours are stored at half the resolution
    ),
)

WRITERS: Registry[Format] = Registry("format", {suffix: form for form in _OWN for suffix in form.suffixes})
"""The format of every suffix."""


def formats_help() -> str:
    """List of all suffixes, and a sentence on each format, as text."""
    return ". ".join([" ".join(WRITERS), *dict.fromkeys(form.description for form in WRITERS.values())]) + "."


def check_target(path: Path) -> None:
    """Refuse a file that cannot be written, as far as that is known before any work is done.

    Args:
        path: file to write.

    Raises:
        InputError: an unknown suffix, or what `check_writable` refuses.
        MissingExtraError: the format needs an extra.
    """
    form = WRITERS.get(path.suffix.lower())
    if form is None:
        if path.suffix.lower() in (".fbx", ".blend", ".ma", ".mb", ".max", ".c4d", ".uasset", ".hip"):
            programs = "for Blender, Maya, Unreal or Houdini write .usdc, .abc or .glb"
            raise InputError(f"{path.suffix} is the private format of a program and is not written; {programs}.")
        what = f"{path.suffix} is not a format that is written" if path.suffix else f"{path} has no suffix"
        raise InputError(f"{what}; give the file one of the suffixes {', '.join(WRITERS)}.")
    check_writable(path)
    if form.check:
        _function(form.check)(path)


def written_files(path: Path, frames: int) -> tuple[Path, ...]:
    """The files that `export` writes for a trajectory of so many frames.

    Args:
        path: of a suffix in `WRITERS`.
        frames: number of frames.
    """
    form = WRITERS[path.suffix.lower()]
    return _function(form.files)(path, frames) if form.files else (path,)


def would_overwrite(path: Path, file: Path) -> bool:
    """Whether writing `path` replaces the input `file`, or adds to it if it is a folder of frames.

    Args:
        path: file to write, of a suffix in `WRITERS`.
        file: file or folder that is read.
    """
    written = written_files(path, _COUNTED_FRAMES)
    if file.is_dir():
        return path.suffix.lower() in (".obj", ".ply") and is_same_file(path.parent, file)
    # Frames are numbered from 0: the file is one of theirs where its name is their first one's with another number.
    names = {re.sub(r"\d{4,}$", "0000", name.stem) + name.suffix for name in written if len(written) > 2}
    if names:
        return is_same_file(path.parent, file.parent) and re.sub(r"\d{4,}$", "0000", file.stem) + file.suffix in names
    return any(is_same_file(name, file) for name in written)


_COUNTED_FRAMES = 3
"""Frames that tell a sequence of files from a file with a companion."""


def is_same_file(one: Path, other: Path) -> bool:
    """Whether two paths name the same file, whether or not it exists.

    Args:
        one: a path.
        other: another path.
    """
    return one.samefile(other) if one.exists() and other.exists() else one.resolve() == other.resolve()


def is_drawn(path: Path) -> bool:
    """Whether a file shows pictures; its suffix is one of `WRITERS`.

    Args:
        path: path with a suffix of `WRITERS`.
    """
    return WRITERS[path.suffix.lower()].drawn


def check_view(path: Path, view: View) -> None:
    """Refuse a view that pictures in a file cannot have.

    Args:
        path: file to write, of a suffix in `WRITERS`.
        view: camera, size and colours.

    Raises:
        InputError: the file has no pictures, or they cannot have that size.
    """
    form = WRITERS[path.suffix.lower()]
    if not form.drawn:
        drawn = ", ".join(suffix for suffix, other in WRITERS.items() if other.drawn)
        raise InputError(f"{path.suffix} is not a picture; options of the view are for {drawn}.")
    n = form.side_multiple
    if view.width % n or view.height % n:
        raise InputError(
            f"Width and height of a {path.suffix} must be multiples of {n} pixels, and {view.width}x{view.height} are "
            "not; take "
            f"{view.width + view.width % n}x{view.height + view.height % n}."
        )


def check_bones(path: Path, bones: int) -> None:
    """Refuse a number of bones for a format without bones.

    Args:
        path: file to write.
        bones: how many of each surface.

    Raises:
        InputError: the file is not a GLB, or the number is out of range.
    """
    from pb4u.export.bone_baking import MOST_BONES

    if path.suffix.lower() != ".glb":
        raise InputError(f"{path.suffix} has no bones; --bones is for .glb.")
    if not 1 <= bones <= MOST_BONES:
        raise InputError(f"The number of bones must be from 1 to {MOST_BONES}, not {bones}.")


def export(
    trajectory: Trajectory,
    path: str | Path,
    progress: Progress | None = None,
    view: View | None = None,
    say: Callable[[str], None] | None = None,
    bones: int | None = None,
) -> Path:
    """Write a trajectory in the format its suffix names; files appear when they are complete, or not at all.

    Args:
        trajectory: frames that are not finite are replaced (`finite_frames`), except in .npz, which keeps the simulated
            values.
        path: file to write.
        progress: called with the number of finished parts.
        view: camera, size and colours of pictures.
        say: called with a sentence on details of the written file, such as a video's codec.
        bones: number of bones of each surface of a GLB; None for morph targets.

    Raises:
        InputError: the target cannot be written, or not with this view.
        MissingExtraError: the format needs an extra.
    """
    path = Path(path)
    check_target(path)
    form = WRITERS[path.suffix.lower()]
    if view is not None:
        check_view(path, view)
    header = trajectory.header
    if form.coloured and _function("pb4u.export.selection:looks_are_on_source")(header):
        trajectory = _function("pb4u.export.selection:on_source")(trajectory)
    shown = _function("pb4u.export.finite_frames:hold_finite")(trajectory) if form.finite else trajectory
    writer = _function(form.writer)
    seen: dict[str, Any] = {"view": view} if form.drawn else {}
    if bones is not None:
        check_bones(path, bones)
        seen["bones"] = bones
    with on_disk(f"Cannot write {path}"):
        with working_folder(path) as folder:
            remark = writer(shown, folder / path.name, progress or no_progress, **seen)
            complete = sorted(p for p in folder.iterdir() if p.name != LOCK and p.suffix != MARK)
            if not complete:
                raise InputError(f"Cannot write {path}: nothing was written.")
            for written in complete:
                move_into_place(written, path.with_name(written.name))
        for stale in _function(form.stale)(path, shown.frame_count) if form.stale else ():
            stale.unlink()
    if remark and say is not None:
        say(f"{path.name} {remark}")
    return path


def write_npz(trajectory: Trajectory, path: Path, progress: Progress) -> None:
    """Write the trajectory as it is, in one step.

    Args:
        trajectory: to write.
        path: file to write.
        progress: not called.
    """
    trajectory.save(path)


def _function(name: str) -> Callable[..., Any]:
    return resolve_name(name)
