"""The triangles of an author's mesh, and what about them a simulation cannot use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pb4u.garment.garment import SourceMesh
from pb4u.geometry.orientation import faces_to_flip
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import face_areas
from pb4u.geometry.triangulation import triangulate
from pb4u.geometry.welding import coincident_border_vertices

FLATTEST = 1e-6
"""A triangle lower than this share of its longest side has no usable area."""


@dataclass(frozen=True, eq=False)
class SourceSurface:
    """A source mesh cut into triangles, with its faults.

    Args:
        source: the author's mesh.
        corners: (triangles, 3) int64 into the polygon corners laid end to end.
        polygon: (triangles,) int64 the polygon of each triangle.
    """

    source: SourceMesh
    corners: np.ndarray
    polygon: np.ndarray

    @classmethod
    def of(cls, source: SourceMesh) -> SourceSurface:
        """The triangles of `source`."""
        return cls(source, *triangulate(source.vertices, source.polygons))

    @cached_property
    def all_faces(self) -> np.ndarray:
        """(triangles, 3) int64 vertices of every triangle."""
        faces: np.ndarray = np.concatenate(self.source.polygons)[self.corners]
        return faces

    @cached_property
    def collapsed(self) -> np.ndarray:
        """(triangles,) bool: a vertex twice, or no area."""
        a, b, c = self.all_faces.T
        corners = self.source.vertices[self.all_faces]
        longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        flat: np.ndarray = 2.0 * face_areas(self.source.vertices, self.all_faces) <= FLATTEST * longest**2
        collapsed: np.ndarray = (a == b) | (b == c) | (c == a) | flat
        return collapsed

    @cached_property
    def repeated(self) -> np.ndarray:
        """(triangles,) bool: has the same three vertices as an earlier triangle."""
        first = np.unique(np.sort(self.all_faces, axis=1), axis=0, return_index=True)[1]
        repeated = np.ones(len(self.all_faces), dtype=bool)
        repeated[first] = False
        return repeated

    @cached_property
    def kept(self) -> np.ndarray:
        """(faces,) indices of the triangles that are neither collapsed nor repeated."""
        return np.flatnonzero(~self.collapsed & ~self.repeated)

    @cached_property
    def faces(self) -> np.ndarray:
        """(faces, 3) int64 vertices of the kept triangles."""
        faces: np.ndarray = self.all_faces[self.kept]
        return faces

    @cached_property
    def topology(self) -> Topology:
        """Connectivity of the kept triangles."""
        return Topology(self.faces, len(self.source.vertices))

    @cached_property
    def flipped(self) -> tuple[np.ndarray, bool]:
        """Kept triangles to turn over so that neighbours agree, and whether that is possible."""
        return faces_to_flip(self.topology)

    @cached_property
    def piece_count(self) -> int:
        """Number of connected pieces, isolated vertices left out."""
        return len(np.unique(self.topology.piece_of_vertex[self.faces[:, 0]]))

    @cached_property
    def weld_target(self) -> np.ndarray:
        """(vertices,) vertex that each would be welded to, its own index where none."""
        return coincident_border_vertices(self.source.vertices, self.topology)

    @property
    def unwelded(self) -> np.ndarray:
        """Vertices that lie on another of the border."""
        return np.flatnonzero(self.weld_target != np.arange(len(self.weld_target)))

    @property
    def many_sided(self) -> int:
        """Number of polygons with more than three corners."""
        return sum(len(p) > 3 for p in self.source.polygons)

    @cached_property
    def extra_faces(self) -> np.ndarray:
        """Polygons to delete so that no edge has more than two faces: those of the smaller parts that meet there."""
        topology = self.topology
        counts, face_edges = topology.edge_face_counts, topology.face_edges
        manifold = counts[topology.face_edges] == 2
        count = len(self.faces)
        face = np.repeat(np.arange(count), 3)[manifold.reshape(-1)]
        node = count + face_edges[manifold]
        size = count + len(counts)
        graph = coo_matrix((np.ones(len(face), dtype=np.int8), (face, node)), shape=(size, size))
        part = connected_components(graph, directed=False)[1][:count]
        part_size = np.bincount(part)[part]
        extra: list[int] = []
        for edge in np.flatnonzero(counts > 2).tolist():
            there = np.flatnonzero((face_edges == edge).any(axis=1))
            extra += there[np.argsort(-part_size[there], kind="stable")][2:].tolist()
        return np.unique(self.polygon[self.kept[extra]]) if extra else np.zeros(0, dtype=np.int64)
