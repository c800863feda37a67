"""The result of a simulation, and its file: an uncompressed .npz, mapped into memory and read without pickle."""

from __future__ import annotations

import contextlib
import json
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np

from pb4u.errors import InputError, Interrupted
from pb4u.garment.garment import Garment
from pb4u.geometry.appearance import Appearances
from pb4u.io.atomic_file import move_into_place, working_folder
from pb4u.io.reading_limits import require_room
from pb4u.scene.author_mesh import Polygons, SourceTrack, joined_indices, joined_uvs, offsets
from pb4u.scene.mapped_archive import map_archive
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory_check import require_consistent

FORMAT_VERSION = 1
HALF_VERSION = 2
"""Format of files in half precision, in which positions are offsets from an origin of each frame."""
_REQUIRED = (
    "format_version", "positions", "velocities", "faces", "rest_positions", "pinned", "vertex_garment",
    "body_positions", "body_faces", "body_contact", "fps", "metadata",
)  # fmt: skip
_STREAMED = ("positions", "velocities", "body_positions")
_ORIGINS = {"positions": "position_origins", "body_positions": "body_position_origins"}
"""Member of offsets -> member (frames, 3) float32 [m] of what they are taken from, in half precision."""


@dataclass(frozen=True, eq=False)
class TrajectoryHeader:
    """Static part of a trajectory: everything that does not change from frame to frame.

    Args:
        faces: (faces, 3) int64.
        rest_positions: (vertices, 3) float32 [m].
        pinned: (vertices,) bool.
        vertex_garment: (vertices,) int32 garment of each vertex.
        body_faces: (body faces, 3) int64.
        body_contact: (body vertices,) bool.
        fps: frames per second [1/s].
        metadata: names, counts, garments with their materials and rows, and versions, as JSON.
        uvs: (uv points, 2) float64 UV coordinates, or None.
        uv_faces: (faces, 3) int64 UV points of each face, or None.
        source: the author's mesh where it differs from the simulated one.
        rest_uv: (faces, 3, 2) float64 corners [m] of faces that lie flat at rest, NaN for those of garments whose rest
            shape is `rest_positions`; None where all are.
        polygons: the faces before they were cut into triangles, where this mesh is the author's own; or None.
        appearances: colours and images of the faces, where their author gave any.
    """

    faces: np.ndarray
    rest_positions: np.ndarray
    pinned: np.ndarray
    vertex_garment: np.ndarray
    body_faces: np.ndarray
    body_contact: np.ndarray
    fps: float
    metadata: dict[str, Any] = field(default_factory=dict)
    uvs: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    source: SourceTrack | None = None
    polygons: Polygons | None = None
    rest_uv: np.ndarray | None = None
    appearances: Appearances | None = None

    @staticmethod
    def of(scene: Scene, metadata: dict[str, Any]) -> TrajectoryHeader:
        """Header of what is simulated of a scene, its garments and its bodies each joined into one mesh.

        Args:
            scene: garments and bodies.
            metadata: entries added to those of the garments.
        """
        garments, bodies = [worn.garment for worn in scene.garments], scene.colliders
        vertices, triangles = offsets([g.vertices for g in garments]), offsets([g.faces for g in garments])
        uvs, uv_faces = joined_uvs([(g.uvs, g.uv_faces, len(g.faces)) for g in garments])
        sources = [*scene.labels.get("sources", ()), *[None] * len(garments)]
        described = [
            {
                "name": garment.name,
                "material": asdict(garment.material),
                "vertices": vertices[k : k + 2],
                "triangles": triangles[k : k + 2],
                "source": sources[k],
                "rest_area": float(garment.face_areas.sum()),
                **({"panels": list(garment.panels)} if garment.panels else {}),
            }
            for k, garment in enumerate(garments)
        ]
        return TrajectoryHeader(
            faces=joined_indices([g.faces for g in garments], vertices),
            rest_positions=np.concatenate([g.vertices for g in garments]).astype(np.float32),
            pinned=np.concatenate([g.pinned for g in garments]),
            vertex_garment=np.repeat(np.arange(len(garments), dtype=np.int32), np.diff(vertices)),
            body_faces=joined_indices([body.faces for body in bodies], offsets([body.contact for body in bodies])),
            body_contact=np.concatenate([body.contact for body in bodies]),
            fps=scene.fps,
            metadata={"garments": described, "material": described[0]["material"], **metadata},
            uvs=uvs,
            uv_faces=uv_faces,
            source=SourceTrack.joined(garments),
            rest_uv=_joined_rest(garments),
            appearances=Appearances.joined([g.appearances for g in garments], [len(g.faces) for g in garments]),
        )

    @property
    def garments(self) -> list[dict[str, Any]]:
        """Entries of each garment in `metadata`; one entry for files of older versions, which have none."""
        whole = {
            "name": self.metadata.get("garment", "garment"),
            "material": self.metadata.get("material"),
            "vertices": [0, len(self.rest_positions)],
            "triangles": [0, len(self.faces)],
            "source": None,
        }
        return self.metadata.get("garments") or [whole]

    @property
    def outlines(self) -> Polygons:
        """Polygons for formats that take them: the author's own, or else the triangles."""
        return self.polygons or Polygons.of_triangles(self.faces, self.uv_faces)

    def with_metadata(self, **entries: Any) -> TrajectoryHeader:
        """Copy of the header with some metadata entries replaced."""
        return replace(self, metadata={**self.metadata, **entries})

    def _members(self) -> dict[str, np.ndarray]:
        members: dict[str, np.ndarray] = {
            "format_version": np.array(FORMAT_VERSION, dtype=np.int64),
            "faces": self.faces.astype(np.int64),
            "rest_positions": self.rest_positions.astype(np.float32),
            "pinned": self.pinned.astype(bool),
            "vertex_garment": self.vertex_garment.astype(np.int32),
            "body_faces": self.body_faces.astype(np.int64),
            "body_contact": self.body_contact.astype(bool),
            "fps": np.array(self.fps, dtype=np.float64),
            "metadata": np.array(json.dumps(self.metadata)),
        }
        if self.rest_uv is not None:
            members["rest_uv"] = self.rest_uv.astype(np.float64)
        members |= _looks(self, "")
        if self.source is not None:
            members |= {
                "source_faces": self.source.faces.astype(np.int64),
                "source_triangle": self.source.triangle.astype(np.int64),
                "source_barycentric": self.source.barycentric.astype(np.float64),
                **_looks(self.source, "source_"),
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


def _joined_rest(garments: Sequence[Garment]) -> np.ndarray | None:
    if all(garment.rest_uv is None for garment in garments):
        return None
    parts = (np.full((len(g.faces), 3, 2), np.nan) if g.rest_uv is None else g.rest_uv for g in garments)
    return np.concatenate(list(parts))


@dataclass(frozen=True, eq=False)
class Frame:
    """One written frame.

    Args:
        positions: (vertices, 3) float32 [m] of the garments.
        velocities: (vertices, 3) float32 [m/s] of the garments.
        body_positions: (body vertices, 3) float32 [m].
    """

    positions: np.ndarray
    velocities: np.ndarray
    body_positions: np.ndarray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Garment and body over time.

    Args:
        header: everything that does not change from frame to frame.
        positions: (frames, vertices, 3) float32 [m].
        velocities: (frames, vertices, 3) float32 [m/s].
        body_positions: (frames, body vertices, 3) float32 [m].
    """

    header: TrajectoryHeader
    positions: np.ndarray
    velocities: np.ndarray
    body_positions: np.ndarray

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self.positions)

    @property
    def faces(self) -> np.ndarray:
        """Vertex indices (faces, 3) int64 of the garments' triangles."""
        return self.header.faces

    @property
    def fps(self) -> float:
        """Frames per second [1/s]."""
        return self.header.fps

    @property
    def metadata(self) -> dict[str, Any]:
        """Names, counts, garments and versions, as JSON data."""
        return self.header.metadata

    @property
    def frames(self) -> Iterable[Frame]:
        """Frames in their order."""
        for p, v, b in zip(self.positions, self.velocities, self.body_positions, strict=True):
            yield Frame(p, v, b)

    @classmethod
    def collect(cls, header: TrajectoryHeader, frames: Iterable[Frame]) -> Trajectory:
        """Gather frames in memory.

        Args:
            header: everything that does not change from frame to frame.
            frames: one or more, in order.

        Raises:
            InputError: there is no frame.
        """
        rows = list(frames)
        if not rows:
            raise InputError("A trajectory needs at least one frame.")
        return cls(
            header,
            np.stack([f.positions for f in rows]).astype(np.float32),
            np.stack([f.velocities for f in rows]).astype(np.float32),
            np.stack([f.body_positions for f in rows]).astype(np.float32),
        )

    def save(self, path: str | Path) -> Path:
        """Write the .npz, beside and moved into place. Other formats: `pb4u.export_trajectory`.

        Args:
            path: path of the .npz.
        """
        with TrajectoryWriter(path, self.header) as writer:
            for frame in self.frames:
                writer.append(frame)
        return Path(path)

    def encode(self, half: bool = False) -> bytes:
        """The bytes of the .npz.

        Args:
            half: float16 in place of float32. Positions are offsets from the middle of each frame's bounding box, so
                that they are good to 0.25 mm in a box of 2 m, wherever in the world it is; velocities to 0.05 %.
        """
        members = self.header._members()
        if half:
            members["format_version"] = np.array(HALF_VERSION, dtype=np.int64)
        for name in _STREAMED:
            values = np.asarray(getattr(self, name), dtype=np.float32)
            if half and name in _ORIGINS:
                low, high = values.min(axis=1), values.max(axis=1)
                origins = np.where(np.isfinite(low + high), 0.5 * (low + high), np.float32(0.0))
                members[_ORIGINS[name]], values = origins, values - origins[:, None]
            with np.errstate(over="ignore", invalid="ignore"):  # what ran away is infinite then
                members[name] = values.astype(np.float16 if half else np.float32)
        whole = BytesIO()
        with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            _write_members(archive, members)
        return whole.getvalue()

    @classmethod
    def open(cls, path: str | Path) -> Trajectory:
        """Map a trajectory file into memory; frames are read from disk as they are touched.

        Args:
            path: path of the .npz.

        Raises:
            InputError: the file is cut short, of a newer format, not a trajectory, or holds what does not fit together.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"There is no trajectory file {path}.")
        try:
            members = map_archive(path)
        except InputError as error:
            told = str(error).removeprefix(f"{path}: ")
            raise InputError(f"{path} cannot be read as a trajectory (cut short or another format): {told}") from error
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
            raise InputError(f"{path} is not a pb4u trajectory: it lacks {', '.join(missing)}.")
        header = _header_from(members, require_consistent(members, path))
        if version == HALF_VERSION:
            members |= _whole_precision(members, path)
        return cls(header, *(members[name] for name in _STREAMED))


def _whole_precision(members: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """The streamed members of a file in half precision, as they are in one of the first format."""
    # Each takes twice its size in the file, and is no longer mapped.
    require_room(path, 4 * sum(members[name].size for name in _STREAMED))
    whole = {name: np.asarray(members[name], dtype=np.float32) for name in _STREAMED}
    for name, origins in _ORIGINS.items():
        whole[name] = whole[name] + members[origins][:, None]
    return whole


def _header_from(members: dict[str, np.ndarray], metadata: dict[str, Any]) -> TrajectoryHeader:
    source = None
    if "source_triangle" in members:
        source = SourceTrack(
            members["source_faces"], members["source_triangle"], members["source_barycentric"],
            members.get("source_uvs"), members.get("source_uv_faces"), Polygons.from_members(members, "source_"),
            Appearances.from_members(members, "source_"),
        )  # fmt: skip
    return TrajectoryHeader(
        members["faces"], members["rest_positions"], members["pinned"], members["vertex_garment"],
        members["body_faces"], members["body_contact"], float(members["fps"]), metadata,
        members.get("uvs"), members.get("uv_faces"), source, Polygons.from_members(members), members.get("rest_uv"),
        Appearances.from_members(members),
    )  # fmt: skip


class TrajectoryWriter:
    """Streams frames to disk, so that length is not bounded by memory; the file appears when it is closed.

    An error on the way leaves nothing; an interrupt leaves the frames until then, at `interrupted_path`.

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
            InputError: the disk takes no more.
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
            InputError: the disk takes no more.
        """
        try:
            for raw in self._raw.values():
                raw.close()
            if self.frame_count:
                beside = self._folder / "trajectory.npz"
                with zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
                    _write_members(archive, self.header._members())
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
            "takes twice the size of the file."
        )

    def _copy_member(self, archive: zipfile.ZipFile, name: str) -> None:
        shape = (self.frame_count, *self._shapes[name])
        with archive.open(f"{name}.npy", "w", force_zip64=True) as member, (self._folder / name).open("rb") as raw:
            np.lib.format.write_array_header_1_0(member, {"descr": "<f4", "fortran_order": False, "shape": shape})
            # An interrupt may have left a part of a further frame.
            left = 4 * math.prod(shape)
            while block := raw.read(min(left, 1 << 20)):
                member.write(block)
                left -= len(block)

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
    """What is kept of an interrupted run: the first `frames` frames, in the file `path`.

    Args:
        frames: number of frames.
        path: of the file.
    """
    return f"the first {'frame is' if frames == 1 else f'{frames} frames are'} in {path}"


def interrupted_path(path: Path) -> Path:
    """Path of the frames that were there when a run was interrupted; a trajectory that lies at `path` stays.

    Args:
        path: where the whole trajectory would lie.
    """
    return path.with_name(f"{path.stem}.interrupted.npz")
