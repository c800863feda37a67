"""The triangles of an author's mesh, and which of them a simulation cannot use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from pb4u.errors import InputError
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.topology import Topology, connected_labels, faces_to_flip
from pb4u.geometry.triangle_mesh import face_areas, face_cross_products
from pb4u.geometry.triangulation import triangulate

# A triangle lower than this share of its longest side has no usable area: its stretch divides by that area.
_FLATTEST = 1e-6
# Border vertices within this distance [m] are one seam: far below any edge, far above the rounding of a file.
_SAME_PLACE = 1e-4
# Border vertices in one place, on average, above which their pairs would fill the memory; in a soup of triangles six
# corners meet.
_MOST_COINCIDENT = 64
# Layers within this distance [m] are one shell or lining: a solidify modifier rarely adds more, and garments are worn
# farther from themselves. Of so many nearest faces one is across, not beside, where layers are meshed alike.
_LAYER_GAP, _LAYER_NEIGHBOURS = 8e-3, 12


@dataclass(frozen=True, eq=False)
class SourceSurface:
    """A source mesh cut into triangles, with its faults.

    Args:
        source: the author's mesh.
        corners: (triangles, 3) int64 into the concatenated polygon corners.
        polygon: (triangles,) int64 the polygon of each triangle.
    """

    source: PolygonMesh
    corners: np.ndarray
    polygon: np.ndarray

    @classmethod
    def of(cls, source: PolygonMesh) -> SourceSurface:
        """The triangles of `source`.

        Args:
            source: the author's mesh.
        """
        return cls(source, *triangulate(source.vertices, source.polygons))

    @cached_property
    def all_faces(self) -> np.ndarray:
        """Vertices (triangles, 3) int64 of every triangle."""
        return np.concatenate(self.source.polygons)[self.corners]

    @cached_property
    def collapsed(self) -> np.ndarray:
        """Mask (triangles,) bool of triangles with a vertex twice, or without area."""
        a, b, c = self.all_faces.T
        corners = self.source.vertices[self.all_faces]
        longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        flat: np.ndarray = 2.0 * face_areas(self.source.vertices, self.all_faces) <= _FLATTEST * longest**2
        return (a == b) | (b == c) | (c == a) | flat

    @cached_property
    def repeated(self) -> np.ndarray:
        """Mask (triangles,) bool of triangles with the same three vertices as an earlier one."""
        first = np.unique(np.sort(self.all_faces, axis=1), axis=0, return_index=True)[1]
        repeated = np.ones(len(self.all_faces), dtype=bool)
        repeated[first] = False
        return repeated

    @cached_property
    def kept(self) -> np.ndarray:
        """Indices (faces,) int64 of the triangles that are neither collapsed nor repeated."""
        return np.flatnonzero(~self.collapsed & ~self.repeated)

    @cached_property
    def faces(self) -> np.ndarray:
        """Vertices (faces, 3) int64 of the kept triangles."""
        return self.all_faces[self.kept]

    @cached_property
    def topology(self) -> Topology:
        """Connectivity of the kept triangles."""
        return Topology(self.faces, len(self.source.vertices))

    @cached_property
    def flipped(self) -> tuple[np.ndarray, bool]:
        """Mask (faces,) bool of kept triangles to turn over so that neighbours agree, and whether that is possible."""
        return faces_to_flip(self.topology)

    @property
    def turned_over(self) -> np.ndarray:
        """Indices (n,) int64 of polygons to turn over so that neighbours agree, each once however it was cut."""
        return np.unique(self.polygon[self.kept[self.flipped[0]]])

    @cached_property
    def piece_count(self) -> int:
        """Number of connected pieces, isolated vertices left out."""
        return len(np.unique(self.topology.piece_of_vertex[self.faces[:, 0]]))

    @cached_property
    def weld_target(self) -> np.ndarray:
        """Indices (vertices,) int64 of the vertices to weld to: for a border vertex the lowest coincident one, else
        itself.

        Vertices that share an edge are never joined, however short the edge is.

        Raises:
            InputError: too many vertices coincide for all their pairs to be tested.
        """
        vertices, topology = self.source.vertices, self.topology
        border = np.flatnonzero(topology.border_vertices)
        target = np.arange(len(vertices))
        if not len(border):
            return target
        tree = cKDTree(vertices[border])
        if (count := int(tree.count_neighbors(tree, _SAME_PLACE))) > _MOST_COINCIDENT * len(border):
            raise InputError(
                f"{len(border)} border vertices share their positions, {count // len(border)} vertices at each on "
                "average; "
                "merge vertices by distance in the program it comes from."
            )
        pairs = np.sort(border[tree.query_pairs(_SAME_PLACE, output_type="ndarray")], axis=1)
        pairs = pairs[~np.isin(pairs @ np.array([len(vertices), 1]), topology.edge_keys)]
        labels = connected_labels(len(vertices), *pairs.T)
        lowest = np.full(len(vertices), len(vertices))
        np.minimum.at(lowest, labels, target)
        return lowest[labels]

    @property
    def unwelded(self) -> np.ndarray:
        """Indices (n,) int64 of border vertices that coincide with another one."""
        return np.flatnonzero(self.weld_target != np.arange(len(self.weld_target)))

    @property
    def many_sided(self) -> int:
        """Number of polygons with more than three corners."""
        return sum(len(p) > 3 for p in self.source.polygons)

    @property
    def unsewn(self) -> np.ndarray:
        """Ends (lines, 2) int64 of the file's lines that join faces without being an edge of one: sewing threads."""
        lines = self.source.lines
        if lines is None or not len(lines):
            return np.zeros((0, 2), dtype=np.int64)
        keys = np.sort(lines, axis=1) @ np.array([len(self.source.vertices), 1])
        joining = np.isin(lines, self.faces).all(axis=1) & (lines[:, 0] != lines[:, 1])
        return lines[joining & ~np.isin(keys, self.topology.edge_keys)]

    @property
    def untextured(self) -> np.ndarray:
        """Indices (n,) int64 of polygons at one point of the UVs, where others have UVs."""
        if self.source.uvs is None or self.source.polygon_uvs is None:
            return np.zeros(0, dtype=np.int64)
        uvs = self.source.uvs
        return np.flatnonzero([not np.ptp(uvs[corners], axis=0).any() for corners in self.source.polygon_uvs])

    @cached_property
    def extra_faces(self) -> np.ndarray:
        """Indices (n,) int64 of polygons to delete so that no edge has more than two faces.

        They belong to the smaller parts at such an edge.
        """
        topology = self.topology
        counts, face_edges = topology.edge_face_counts, topology.face_edges
        manifold = counts[topology.face_edges] == 2
        count = len(self.faces)
        face = np.repeat(np.arange(count), 3)[manifold.reshape(-1)]
        node = count + face_edges[manifold]
        size = count + len(counts)
        part = connected_labels(size, face, node)[:count]
        part_size = np.bincount(part)[part]
        extra: list[int] = []
        for edge in np.flatnonzero(counts > 2).tolist():
            there = np.flatnonzero((face_edges == edge).any(axis=1))
            extra += there[np.argsort(-part_size[there], kind="stable")][2:].tolist()
        return np.unique(self.polygon[self.kept[extra]]) if extra else np.zeros(0, dtype=np.int64)

    @property
    def double(self) -> np.ndarray:
        """Mask (faces,) bool of faces close to another layer with the opposite normal: lining, or the back of a
        shell."""
        return self.opposite >= 0

    @cached_property
    def opposite(self) -> np.ndarray:
        """Face (faces,) int64 of the other layer across each face, the nearest one; -1 where the cloth has one
        layer."""
        corners = self.source.vertices[self.faces]
        centres = corners.mean(axis=1)
        normals = face_cross_products(self.source.vertices, self.faces)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        size = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
        near = cKDTree(centres).query(centres, k=min(_LAYER_NEIGHBOURS, len(centres)))[1].reshape(len(centres), -1)
        offset = centres[near] - centres[:, None]
        height = np.einsum("fkd,fd->fk", offset, normals)
        across = np.linalg.norm(offset - height[..., None] * normals[:, None], axis=2)
        opposed = np.einsum("fkd,fd->fk", normals[near], normals) < -0.8
        across[~(opposed & (np.abs(height) < _LAYER_GAP) & (across < size[:, None]))] = np.inf
        best = across.argmin(axis=1)
        rows = np.arange(len(centres))
        return np.where(np.isfinite(across[rows, best]), near[rows, best], -1)
