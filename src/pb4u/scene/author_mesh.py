"""The mesh as its author made it, beside the simulated one: polygons, UVs, and its places on the simulated faces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pb4u.garment.garment import Garment
from pb4u.geometry.appearance import Appearances
from pb4u.geometry.topology import joined_indices, offsets
from pb4u.geometry.triangulation import triangulate


@dataclass(frozen=True, eq=False)
class Polygons:
    """Faces with any number of corners, concatenated.

    Args:
        sizes: (polygons,) int64 number of corners of each, 3 or more.
        corners: (sum of sizes,) int64 vertex at each corner.
        uv_corners: (sum of sizes,) int64 UV point at each corner, or None.
    """

    sizes: np.ndarray
    corners: np.ndarray
    uv_corners: np.ndarray | None = None

    @classmethod
    def of(cls, polygons: Sequence[np.ndarray], polygon_uvs: Sequence[np.ndarray] | None = None) -> Polygons | None:
        """Polygons of a mesh; None where all are triangles, which the faces describe already.

        Args:
            polygons: (corners,) int64 vertex indices of each polygon.
            polygon_uvs: (corners,) int64 UV point indices of each, or None.
        """
        sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
        if not (sizes > 3).any():
            return None
        return cls(sizes, np.concatenate(polygons), None if polygon_uvs is None else np.concatenate(polygon_uvs))

    @classmethod
    def of_triangles(cls, faces: np.ndarray, uv_faces: np.ndarray | None) -> Polygons:
        """Triangles as polygons.

        Args:
            faces: (faces, 3) int64 vertex indices.
            uv_faces: (faces, 3) int64 UV point indices, or None.
        """
        uv_corners = None if uv_faces is None else uv_faces.reshape(-1)
        return cls(np.full(len(faces), 3, dtype=np.int64), faces.reshape(-1), uv_corners)

    def each(self, of_corners: np.ndarray) -> Iterator[list[int]]:
        """The values at the corners of each polygon, one polygon after another.

        Args:
            of_corners: (sum of sizes,) int64 value of each corner, such as `corners`.
        """
        values, start = of_corners.tolist(), 0
        for size in self.sizes.tolist():
            yield values[start : start + size]
            start += size

    def members(self, prefix: str = "") -> dict[str, np.ndarray]:
        """Arrays of a trajectory file, each (polygons,) or (sum of sizes,) int64, by name.

        Args:
            prefix: put before each name.
        """
        members = {f"{prefix}polygon_sizes": self.sizes, f"{prefix}polygon_corners": self.corners}
        if self.uv_corners is not None:
            members[f"{prefix}polygon_uv_corners"] = self.uv_corners
        return {name: values.astype(np.int64) for name, values in members.items()}

    @classmethod
    def from_members(cls, members: dict[str, np.ndarray], prefix: str = "") -> Polygons | None:
        """Polygons of a trajectory file; None where it has none.

        Args:
            members: arrays of the file by name; sizes and corners (n,) int64 as `members` wrote them.
            prefix: before the name of each.
        """
        sizes, corners = members.get(f"{prefix}polygon_sizes"), members.get(f"{prefix}polygon_corners")
        if sizes is None or corners is None:
            return None
        return cls(sizes, corners, members.get(f"{prefix}polygon_uv_corners"))

    @staticmethod
    def joined(parts: Sequence[Polygons], vertices: Sequence[int], uvs: Sequence[int]) -> Polygons:
        """Polygons of several meshes joined into one.

        Args:
            parts: polygons of each mesh.
            vertices: index of the first vertex of each mesh in the joined one.
            uvs: index of the first UV point of each, likewise; a mesh without UVs has one for all corners.
        """
        have_uvs = any(part.uv_corners is not None for part in parts)
        uv_corners = [
            np.zeros_like(part.corners) if part.uv_corners is None else part.uv_corners
            for part in parts if have_uvs
        ]  # fmt: skip
        return Polygons(
            np.concatenate([part.sizes for part in parts]),
            joined_indices([part.corners for part in parts], vertices),
            joined_indices(uv_corners, uvs) if have_uvs else None,
        )


@dataclass(frozen=True, eq=False)
class SourceTrack:
    """Attachment of the author's own mesh to the simulated one: each vertex to a point of a simulated face.

    Args:
        faces: (source faces, 3) int64 triangulated source.
        triangle: (source vertices,) int64 simulated face under each source vertex.
        barycentric: (source vertices, 3) float64 barycentric coordinates in that face.
        uvs: (uv points, 2) float64 UV coordinates, or None.
        uv_faces: (source faces, 3) int64 UV points of each face, or None.
        polygons: the faces before they were cut into triangles; None where all were triangles.
        appearances: colours and images of the faces, where the author gave any.
    """

    faces: np.ndarray
    triangle: np.ndarray
    barycentric: np.ndarray
    uvs: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    polygons: Polygons | None = None
    appearances: Appearances | None = None

    @staticmethod
    def of(garment: Garment) -> SourceTrack:
        """Track of a garment; onto itself where the simulated mesh is the author's.

        Args:
            garment: the garment.
        """
        if garment.source is None:
            first = np.unique(garment.faces.reshape(-1), return_index=True)[1]
            places = garment.faces, first // 3, np.eye(3)[first % 3]
            return SourceTrack(*places, garment.uvs, garment.uv_faces, None, garment.appearances)
        mesh = garment.source.source
        corners, polygon = triangulate(mesh.vertices, mesh.polygons)
        uv_faces = None if mesh.polygon_uvs is None else np.concatenate(mesh.polygon_uvs)[corners]
        faces = np.concatenate(mesh.polygons)[corners]
        polygons = Polygons.of(mesh.polygons, mesh.polygon_uvs)
        looks = None if mesh.appearances is None else mesh.appearances.at(polygon)
        return SourceTrack(
            faces, garment.source.triangle, garment.source.barycentric, mesh.uvs, uv_faces, polygons, looks
        )

    @staticmethod
    def joined(garments: Sequence[Garment]) -> SourceTrack | None:
        """Attachment of the authors' meshes of several garments; None if all are simulated unchanged.

        Args:
            garments: the garments, in the order of their vertices.
        """
        if all(garment.source is None for garment in garments):
            return None
        tracks = [SourceTrack.of(garment) for garment in garments]
        if len(tracks) == 1:
            return tracks[0]
        vertices = offsets([track.barycentric for track in tracks])
        uvs, uv_faces = joined_uvs([(track.uvs, track.uv_faces, len(track.faces)) for track in tracks])
        outlines = [track.polygons or Polygons.of_triangles(track.faces, track.uv_faces) for track in tracks]
        return SourceTrack(
            joined_indices([track.faces for track in tracks], vertices),
            joined_indices([track.triangle for track in tracks], offsets([garment.faces for garment in garments])),
            np.concatenate([track.barycentric for track in tracks]),
            uvs,
            uv_faces,
            Polygons.joined(outlines, vertices, offsets([(0,) if track.uvs is None else track.uvs for track in tracks]))
            if any(track.polygons for track in tracks)
            else None,
            Appearances.joined([track.appearances for track in tracks], [len(track.faces) for track in tracks]),
        )


def joined_uvs(
    parts: Sequence[tuple[np.ndarray | None, np.ndarray | None, int]],
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """UV coordinates (uv points, 2) and UV faces (faces, 3) int64 of meshes joined into one; None where none has any.

    Args:
        parts: UV coordinates (uv points, 2) and UV faces (faces, 3) int64 indices of each mesh, or None, and its number
            of faces. A mesh without them gets one point at the origin.
    """
    if all(uvs is None for uvs, _, _ in parts):
        return None, None
    maps = [
        (np.zeros((1, 2)), np.zeros((count, 3), dtype=np.int64)) if uvs is None or faces is None else (uvs, faces)
        for uvs, faces, count in parts
    ]
    starts = offsets([uvs for uvs, _ in maps])
    return np.concatenate([uvs for uvs, _ in maps]), joined_indices([faces for _, faces in maps], starts)


def split_seams(
    vertices: int, faces: np.ndarray, uvs: np.ndarray | None, uv_faces: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The mesh for formats that have one UV for each vertex: vertices at a seam are copied.

    Args:
        vertices: how many there are.
        faces: (faces, 3) int64.
        uvs: (uv points, 2), or None.
        uv_faces: (faces, 3) int64 UV points, or None.

    Returns:
        (written,) int64 the vertex of each written one, beginning 0, 1, ..., vertices-1; (faces, 3) corners as
        written ones; (written, 2) float32 UVs, or None.
    """
    if uvs is None or uv_faces is None:
        return np.arange(vertices), faces, None
    pairs, corner = np.unique(np.column_stack([faces.ravel(), uv_faces.ravel()]), axis=0, return_inverse=True)
    first = np.r_[True, pairs[1:, 0] != pairs[:-1, 0]]
    written = np.empty(len(pairs), dtype=np.int64)
    written[first] = pairs[first, 0]
    written[~first] = vertices + np.arange(np.count_nonzero(~first))
    of_vertex = np.r_[np.arange(vertices), pairs[~first, 0]]
    coordinates = np.zeros((len(of_vertex), 2), dtype=np.float32)
    coordinates[written] = uvs[pairs[:, 1]]
    return of_vertex, written[corner.reshape(-1)].reshape(faces.shape), coordinates
