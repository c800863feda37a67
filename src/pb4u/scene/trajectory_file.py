"""The file of a trajectory: an uncompressed .npz, streamed frame by frame, and mapped into memory without pickle."""

from __future__ import annotations

import contextlib
import json
import math
import zipfile
from collections.abc import Mapping
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from pb4u.errors import InputError, Interrupted
from pb4u.io.atomic_file import move_into_place, working_folder
from pb4u.io.reading_limits import require_room
from pb4u.scene.mapped_archive import map_archive
from pb4u.scene.trajectory_check import require_consistent

if TYPE_CHECKING:
    from pb4u.scene.author_mesh import SourceTrack
    from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

FORMAT_VERSION = 1
HALF_VERSION = 2
"""Format of files in half precision, in which positions are offsets from an origin of each frame."""
_REQUIRED = (
    "format_version", "positions", "velocities", "faces", "rest_positions", "pinned", "vertex_garment",
    "body_positions", "body_faces", "body_contact", "fps", "metadata",
)  # fmt: skip
_MOVING_BODY = {"positions", "faces", "fps", "contact"}
"""What `pb4u.body.sequence_files` writes."""
_STREAMED = ("positions", "velocities", "body_positions")
_ORIGINS = {"positions": "position_origins", "body_positions": "body_position_origins"}
"""Member of offsets -> member (frames, 3) float32 [m] of what they are taken from, in half precision."""


def encoded(trajectory: Trajectory, half: bool = False) -> bytes:
    """The bytes of the .npz of a trajectory.

    Args:
        trajectory: to write.
        half: float16 instead of float32. Positions are offsets from the middle of each frame's bounding box, so that
            they are good to 0.25 mm in a box of 2 m, wherever in the world it is; velocities to 0.05 %.
    """
    members = _header_members(trajectory.header)
    if half:
        members["format_version"] = np.array(HALF_VERSION, dtype=np.int64)
    for name in _STREAMED:
        values = np.asarray(getattr(trajectory, name), dtype=np.float32)
        if half and name in _ORIGINS:
            low, high = values.min(axis=1), values.max(axis=1)
            origins = np.where(np.isfinite(low + high), 0.5 * (low + high), np.float32(0.0))
            members[_ORIGINS[name]], values = origins, values - origins[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # what ran away is infinite then
            members[name] = values.astype(np.float16 if half else np.float32)
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        _write_members(archive, members)
    return buffer.getvalue()


def read_members(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays (...) of a trajectory file by name, in the units of `Trajectory` and its header, and its metadata.

    Frames are memory-mapped: they are read from disk on access.

    Args:
        path: path of the .npz.

    Raises:
        InputError: the file is cut short, of a newer format, not a trajectory, or holds what does not fit together.
    """
    if not path.is_file():
        raise InputError(f"There is no trajectory file {path}.")
    try:
        members = map_archive(path)
    except InputError as error:
        if path.suffix.lower() != ".npz":
            raise InputError(f"{path} is not a trajectory; give the .npz that `pb4u simulate` wrote.") from error
        reason = str(error).removeprefix(f"{path}: ")
        raise InputError(f"{path} cannot be read as a trajectory (cut short or another format): {reason}") from error
    version = members.get("format_version", np.array(FORMAT_VERSION))
    if version.shape != () or version.dtype.kind not in "iu":
        raise InputError(f"{path} is not a pb4u trajectory: its format version is not a whole number.")
    if version > HALF_VERSION:
        raise InputError(
            f"{path} has trajectory format {version}; this version reads up to {HALF_VERSION}: update pb4u."
        )
    required = (*_REQUIRED, *(_ORIGINS.values() if version == HALF_VERSION else ()))
    missing = [name for name in required if name not in members]
    if missing:
        instead = "; it is a moving body, which is given as --body" if set(members) >= _MOVING_BODY else ""
        raise InputError(f"{path} is not a pb4u trajectory: it lacks {', '.join(missing)}{instead}.")
    metadata = require_consistent(members, path)
    if version == HALF_VERSION:
        members |= _whole_precision(members, path)
    return members, metadata


def _whole_precision(members: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """The streamed members of a file in half precision, as they are in one of the first format."""
    # In memory each takes twice its size in the file.
    require_room(path, sum(members[name].nbytes for name in _STREAMED))
    arrays = {name: np.asarray(members[name], dtype=np.float32) for name in _STREAMED}
    for name, origins in _ORIGINS.items():
        arrays[name] = arrays[name] + members[origins][:, None]
    return arrays


def _header_members(header: TrajectoryHeader) -> dict[str, np.ndarray]:
    members: dict[str, np.ndarray] = {
        "format_version": np.array(FORMAT_VERSION, dtype=np.int64),
        "faces": header.faces.astype(np.int64),
        "rest_positions": header.rest_positions.astype(np.float32),
        "pinned": header.pinned.astype(bool),
        "vertex_garment": header.vertex_garment.astype(np.int32),
        "body_faces": header.body_faces.astype(np.int64),
        "body_contact": header.body_contact.astype(bool),
        "fps": np.array(header.fps, dtype=np.float64),
        "metadata": np.array(json.dumps(header.metadata)),
    }
    if header.rest_uv is not None:
        members["rest_uv"] = header.rest_uv.astype(np.float64)
    if header.material_layers is not None:
        members["material_layers"] = header.material_layers.astype(np.float64)
    if header.trims is not None:
        members["trims"] = header.trims.astype(np.float64)
    if header.buttons is not None:
        members["buttons"] = header.buttons.astype(np.int64)
    members |= _looks(header, "")
    if header.source is not None:
        members |= {
            "source_faces": header.source.faces.astype(np.int64),
            "source_triangle": header.source.triangle.astype(np.int64),
            "source_barycentric": header.source.barycentric.astype(np.float64),
            **_looks(header.source, "source_"),
        }
    return members


def _looks(mesh: TrajectoryHeader | SourceTrack, prefix: str) -> dict[str, np.ndarray]:
    """Members of a file that say how a mesh looks: UVs, polygons, colours and images."""
    members: dict[str, np.ndarray] = {}
    if mesh.uvs is not None and mesh.uv_faces is not None:
        uvs, uv_faces = mesh.uvs.astype(np.float64), mesh.uv_faces.astype(np.int64)
        members = {f"{prefix}uvs": uvs, f"{prefix}uv_faces": uv_faces}
    for part in (mesh.polygons, mesh.appearances):
        members |= {} if part is None else part.members(prefix)
    return members


def _write_members(archive: zipfile.ZipFile, members: Mapping[str, np.ndarray]) -> None:
    for name, array in members.items():
        with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
            np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)


class TrajectoryWriter:
    """Streams frames to disk, so that length is not bounded by memory; the file appears when it is closed.

    An error leaves no file; an interrupt leaves the frames so far, at `interrupted_path`.

    Args:
        path: path of the file.
        header: everything that does not change from frame to frame.

    Raises:
        InputError: the folder is absent or cannot be written.
    """

    def __init__(self, path: str | Path, header: TrajectoryHeader) -> None:
        self.path = Path(path)
        self.header = header
        self.frame_count = 0
        if not self.path.parent.is_dir():
            raise InputError(f"The folder {self.path.parent} does not exist; make it first.")
        self._open = ExitStack()
        try:
            self._folder = self._open.enter_context(working_folder(self.path))
            self._raw: dict[str, BinaryIO] = {name: (self._folder / name).open("wb") for name in _STREAMED}
        except OSError as error:
            self._open.close()
            raise InputError(f"Cannot write in {self.path.parent}: {error.strerror}.") from error
        self._shapes: dict[str, tuple[int, ...]] = {}

    def append(self, frame: Frame) -> None:
        """Write one frame.

        Args:
            frame: the frame.

        Raises:
            InputError: the disk is full.
        """
        try:
            for name in _STREAMED:
                row = np.ascontiguousarray(getattr(frame, name), dtype="<f4")
                self._shapes[name] = row.shape
                self._raw[name].write(row.tobytes())
        except OSError as error:
            raise self._not_written(error) from error
        self.frame_count += 1

    def close(self) -> None:
        """Assemble the file and move it into place. Without a frame nothing is written.

        Raises:
            InputError: the disk is full.
        """
        try:
            for raw in self._raw.values():
                raw.close()
            if self.frame_count:
                beside = self._folder / "trajectory.npz"
                with zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
                    _write_members(archive, _header_members(self.header))
                    for name in _STREAMED:
                        self._copy_member(archive, name)
                move_into_place(beside, self.path)
        except OSError as error:
            raise self._not_written(error) from error
        finally:
            self.abandon()

    def _not_written(self, error: OSError) -> InputError:
        return InputError(
            f"Cannot write {self.path}: {error.strerror or error}; its {self.frame_count} frames are lost. Writing "
            "needs twice the size of the file."
        )

    def _copy_member(self, archive: zipfile.ZipFile, name: str) -> None:
        shape = (self.frame_count, *self._shapes[name])
        with archive.open(f"{name}.npy", "w", force_zip64=True) as member, (self._folder / name).open("rb") as raw:
            np.lib.format.write_array_header_1_0(member, {"descr": "<f4", "fortran_order": False, "shape": shape})
            # An interrupt may have left a part of a further frame.
            remaining = 4 * math.prod(shape)
            while block := raw.read(min(remaining, 1 << 20)):
                member.write(block)
                remaining -= len(block)

    def abandon(self) -> None:
        """Delete what was written; no file appears."""
        for raw in self._raw.values():
            # What a full disk did not take is tried once more.
            with contextlib.suppress(OSError):
                raw.close()
        self._open.close()

    def __enter__(self) -> TrajectoryWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        elif isinstance(error, KeyboardInterrupt) and self.frame_count:
            self.path = interrupted_path(self.path)
            self.close()
            raise Interrupted(kept_sentence(self.frame_count, self.path), getattr(error, "signal", 2)) from error
        else:
            self.abandon()


def kept_sentence(frames: int, path: Path) -> str:
    """Sentence on the first `frames` frames of an interrupted run, kept in the file `path`, and their use.

    Args:
        frames: number of frames.
        path: of the file.
    """
    what = f"the first {'frame is' if frames == 1 else f'{frames} frames are'} in {path}"
    return f"{what}, for `pb4u view` and `pb4u convert`; `pb4u simulate` cannot continue from there"


def interrupted_path(path: Path) -> Path:
    """Path for the frames of an interrupted run; an existing trajectory at `path` stays.

    Args:
        path: path of the complete trajectory.
    """
    return path.with_name(f"{path.stem}.interrupted.npz")
