"""The result of a simulation: garments and bodies over time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.trims import Trims
from pb4u.geometry.appearance import Appearances
from pb4u.geometry.topology import joined_indices, offsets
from pb4u.scene.author_mesh import Polygons, SourceTrack, joined_uvs
from pb4u.scene.scene import Scene
from pb4u.scene.trajectory_file import TrajectoryWriter, encoded, read_members


@dataclass(frozen=True, eq=False)
class TrajectoryHeader:
    """Static part of a trajectory: all data that do not change from frame to frame.

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
        rest_uv: (faces, 3, 2) float64 corners [m] of faces that lie flat at rest, along the grain where `metadata` says
            that a garment has one; NaN for garments whose rest shape is `rest_positions`; None if that holds for all.
        polygons: the faces before they were cut into triangles, where this mesh is the author's own; or None.
        appearances: colours and images of the faces, where their author gave any.
        material_layers: (faces, materials) float64 number of layers of each of the `materials` in `metadata` on each
            face, in the mean of its area; None where each face is one layer of one.
        trims: (faces, 2) float64 interfacing [N m] and elastic of the faces, as `Trims`; None where there are none.
        buttons: (buttons,) int64 vertices that buttons close; None where there are none.
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
    material_layers: np.ndarray | None = None
    trims: np.ndarray | None = None
    buttons: np.ndarray | None = None

    @staticmethod
    def of(scene: Scene, metadata: dict[str, Any]) -> TrajectoryHeader:
        """Header for the simulation of a scene, with all garments joined into one mesh and all bodies into another.

        Args:
            scene: garments and bodies.
            metadata: entries added to those of the garments.
        """
        garments, bodies = [dressed.garment for dressed in scene.garments], scene.colliders
        vertices, triangles = offsets([g.vertices for g in garments]), offsets([g.faces for g in garments])
        uvs, uv_faces = joined_uvs([(g.uvs, g.uv_faces, len(g.faces)) for g in garments])
        sources = [*scene.labels.get("sources", ()), *[None] * len(garments)]
        described = [
            {
                "name": garment.name,
                "material": garment.material.five_numbers,
                "vertices": vertices[k : k + 2],
                "triangles": triangles[k : k + 2],
                "source": sources[k],
                "rest_area": float(garment.face_areas.sum()),
                "has_grain": garment.has_grain,
                **({"panels": list(garment.panels)} if garment.panels else {}),
                **({"parts": [asdict(part) for part in garment.sewn]} if garment.sewn else {}),
            }
            for k, garment in enumerate(garments)
        ]
        return TrajectoryHeader(
            faces=joined_indices([g.faces for g in garments], vertices),
            rest_positions=np.concatenate([g.vertices for g in garments]).astype(np.float32),
            pinned=np.concatenate([g.pinned for g in garments]),
            vertex_garment=np.repeat(np.arange(len(garments), dtype=np.int32), np.diff(vertices)),
            body_faces=joined_indices(
                [np.zeros((0, 3), dtype=np.int64), *(body.faces for body in bodies)],
                [0, *offsets([body.contact for body in bodies])],
            ),
            body_contact=np.concatenate([np.zeros(0, dtype=bool), *(body.contact for body in bodies)]),
            fps=scene.fps,
            metadata={
                "garments": described,
                "material": described[0]["material"],
                "materials": _materials(garments, triangles),
                **metadata,
            },
            uvs=uvs,
            uv_faces=uv_faces,
            source=SourceTrack.joined(garments),
            rest_uv=_joined_rest(garments),
            appearances=Appearances.joined([g.appearances for g in garments], [len(g.faces) for g in garments]),
            material_layers=_joined_layers(garments),
            trims=_joined_trims(garments),
            buttons=_joined_buttons(garments, vertices),
        )

    @staticmethod
    def of_members(members: dict[str, np.ndarray], metadata: dict[str, Any]) -> TrajectoryHeader:
        """Header of a trajectory file.

        Args:
            members: arrays (...) of the file by name, as `read_members` gives them.
            metadata: its metadata.
        """
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
            Appearances.from_members(members), members.get("material_layers"), members.get("trims"),
            members.get("buttons"),
        )  # fmt: skip

    @property
    def garments(self) -> list[dict[str, Any]]:
        """Entries of each garment in `metadata`; a single entry for files of older versions, which have none."""
        entry = {
            "name": self.metadata.get("garment", "garment"),
            "material": self.metadata.get("material"),
            "vertices": [0, len(self.rest_positions)],
            "triangles": [0, len(self.faces)],
            "source": None,
        }
        return self.metadata.get("garments") or [entry]

    @property
    def materials(self) -> list[tuple[dict[str, Any], np.ndarray]]:
        """Each material in `metadata` (in older files one for each garment), and the mask (faces,) bool of its
        faces."""
        span = [0, len(self.faces)]
        older = [{**(item.get("material") or {}), "faces": [item.get("triangles", span)]} for item in self.garments]
        materials = []
        for material in self.metadata.get("materials") or older:
            faces = np.zeros(len(self.faces), dtype=bool)
            for first, stop in material["faces"]:
                faces[first:stop] = True
            materials.append((material, faces))
        return materials

    @property
    def outlines(self) -> Polygons:
        """Polygons for formats that take them: the author's own, or else the triangles."""
        return self.polygons or Polygons.of_triangles(self.faces, self.uv_faces)

    def with_metadata(self, **entries: Any) -> TrajectoryHeader:
        """Copy of the header with some metadata entries replaced."""
        return replace(self, metadata={**self.metadata, **entries})


def _materials(garments: Sequence[Garment], first_triangles: Sequence[int]) -> list[dict[str, Any]]:
    """Every material of every garment, with the ranges [first, stop) of the triangles made of it."""
    materials = []
    for garment, first in zip(garments, first_triangles, strict=False):
        for number, material in enumerate(garment.materials or (garment.material,)):
            mask = np.ones(len(garment.faces), dtype=bool)
            if garment.face_material is not None:
                mask = garment.face_material == number
            ranges = [[start + first, stop + first] for start, stop in ranges_of(mask)]
            materials.append({"garment": garment.name, **asdict(material), "faces": ranges})
    return materials


def ranges_of(chosen: np.ndarray) -> list[list[int]]:
    """Ranges [first, stop) of the indices for which `chosen` (n,) bool is true, as metadata lists them."""
    return np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]))).reshape(-1, 2).tolist()


def _joined_rest(garments: Sequence[Garment]) -> np.ndarray | None:
    if all(garment.rest_uv is None for garment in garments):
        return None
    parts = (np.full((len(g.faces), 3, 2), np.nan) if g.rest_uv is None else g.rest_uv for g in garments)
    return np.concatenate(list(parts))


def _joined_layers(garments: Sequence[Garment]) -> np.ndarray | None:
    if all(garment.material_layers is None for garment in garments):
        return None
    return block_diag(*(garment.layers for garment in garments))


def _joined_trims(garments: Sequence[Garment]) -> np.ndarray | None:
    if all(garment.trims is None for garment in garments):
        return None
    return np.concatenate([(g.trims or Trims.none(len(g.faces))).columns for g in garments])


def _joined_buttons(garments: Sequence[Garment], first_vertices: Sequence[int]) -> np.ndarray | None:
    of_each = [g.buttons + first for g, first in zip(garments, first_vertices, strict=False) if g.buttons is not None]
    return np.concatenate(of_each) if of_each else None


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

    def with_frames(self, change: Callable[[np.ndarray], np.ndarray], fps: float) -> Trajectory:
        """The trajectory with other frames, computed from the present ones.

        Args:
            change: gives (frames, vertices, 3) from the positions, the velocities and the positions of the body.
            fps: frames per second [1/s].
        """
        arrays = self.positions, self.velocities, self.body_positions
        return Trajectory(replace(self.header, fps=fps), *map(change, arrays))

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
            half: float16 instead of float32. Positions are offsets from the middle of each frame's bounding box, so
                that they are good to 0.25 mm in a box of 2 m, wherever in the world it is; velocities to 0.05 %.
        """
        return encoded(self, half)

    @classmethod
    def open(cls, path: str | Path) -> Trajectory:
        """Map a trajectory file into memory; frames are read from disk on access.

        Args:
            path: path of the .npz.

        Raises:
            InputError: the file is cut short, of a newer format, not a trajectory, or holds what does not fit together.
        """
        members, metadata = read_members(Path(path))
        header = TrajectoryHeader.of_members(members, metadata)
        return cls(header, members["positions"], members["velocities"], members["body_positions"])
