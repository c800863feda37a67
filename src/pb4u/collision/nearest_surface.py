"""Nearest points on a moving triangle surface, with sign: negative inside.

The nearest triangle is exact: a compiled search of a tree of boxes on the processor; certified candidates on other
devices, and where Numba is not installed. The sign comes from angle-weighted pseudo-normals (Baerentzen and Aanaes
2005), which are right at edges and corners too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import COMPILES
from pb4u.collision.nearest_points import Found, Searched, update_closest
from pb4u.collision.wide_tree import WideTree
from pb4u.errors import InputError
from pb4u.geometry.closest_point import closest_barycentric
from pb4u.geometry.topology import Topology
from pb4u.threads import parallel_map

# Faces with the nearest centres among which the nearest face is looked for; more are tried where it is not certain.
_CANDIDATES = 32
# Distances between points and faces worked out at a time, which bounds the memory.
_PAIRS_PER_CHUNK = 20_000_000

_POINTS_PER_PART = 2048
"""Points that one thread looks up at a time, in 3 ms: to wake another processor may take a quarter of one."""


@dataclass(frozen=True, eq=False)
class NearestPoints:
    """Nearest points of a surface to some points; tensors of the points' dtype and device, without gradient.

    Args:
        triangle: (points,) int64 face of the whole surface.
        barycentric: (points, 3) coordinates of the nearest point in that face.
        positions: (points, 3) nearest points [m].
        normals: (points, 3) unit direction in which the signed distance grows.
        signed_distance: (points,) [m], negative inside.
        beyond_border: (points,) bool, nearest to the border of an open surface or of its region, where inside has no
            meaning: the distance there is given as positive.
    """

    triangle: Tensor
    barycentric: Tensor
    positions: Tensor
    normals: Tensor
    signed_distance: Tensor
    beyond_border: Tensor


class TriangleSurface:
    """The unchanging part of a moving surface.

    Args:
        faces: (faces, 3) int64, counter-clockwise seen from outside.
        vertex_count: number of vertices.
        region: (vertices,) bool or None; faces with a vertex outside the region are left out.
        capped: closes the holes that this leaves, so that nothing is inside what it came into through one of them.

    Attributes:
        region_faces: (faces, 3) int64 those of the region.
        faces: (faces, 3) int64 those of the region, then the caps.
        caps: (caps, 3) int64 faces that close the holes; named in answers as if they followed all given faces.
        names: (faces,) int64 what answers call each of the `faces`.

    Raises:
        InputError: no face is left.
    """

    def __init__(
        self, faces: np.ndarray, vertex_count: int, region: np.ndarray | None = None, *, capped: bool = False
    ) -> None:
        faces = np.asarray(faces, dtype=np.int64)
        kept = np.arange(len(faces)) if region is None else np.flatnonzero(np.asarray(region)[faces].all(axis=1))
        if not len(kept):
            raise InputError("The body surface has no face that may be touched; its contact region is empty.")
        self.caps = _caps(faces, kept, vertex_count) if capped else faces[:0]
        self.region_faces = faces[kept]
        self.faces = np.concatenate([self.region_faces, self.caps])
        self.vertex_count = vertex_count
        self.names = np.concatenate([kept, len(faces) + np.arange(len(self.caps))])
        self._tree: WideTree | None = None

    @cached_property
    def topology(self) -> Topology:
        return Topology(self.faces, self.vertex_count)

    @cached_property
    def _tensors(self) -> dict[str, tuple[Tensor, Tensor, Tensor, Tensor, Tensor]]:
        return {}

    def _on(self, device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Faces, edge of each corner pair, border edges, border vertices and original face index on `device`."""
        key = str(device)
        if key not in self._tensors:
            mesh = self.topology
            arrays = (self.faces, mesh.face_edges.copy(), mesh.edge_face_counts == 1, mesh.border_vertices, self.names)
            self._tensors[key] = tuple(torch.from_numpy(a).to(device) for a in arrays)  # type: ignore[assignment]
        return self._tensors[key]

    @cached_property
    def fans(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Begin of the faces of each vertex (vertices + 1,), these faces, and which vertices are on a border."""
        around = np.argsort(self.faces.reshape(-1), kind="stable") // 3
        begins = np.searchsorted(np.sort(self.faces.reshape(-1)), np.arange(self.vertex_count + 1))
        return begins, around, self.topology.border_vertices

    @cached_property
    def closed(self) -> bool:
        """Whether it has no border."""
        return self.topology.is_closed

    def tree(self, vertices: np.ndarray) -> WideTree:
        """Tree over the faces, built at the first pose it is asked for: what is near on a body mostly stays near.

        Args:
            vertices: (vertices, 3) [m].
        """
        if self._tree is None:
            self._tree = WideTree.over(vertices[self.faces].mean(axis=1))
        return self._tree

    def at(self, vertices: Tensor | np.ndarray) -> PosedSurface:
        """This surface with its `vertices` (vertices, 3) [m] somewhere."""
        return PosedSurface(self, torch.as_tensor(vertices).detach())


def _caps(faces: np.ndarray, kept: np.ndarray, vertex_count: int) -> np.ndarray:
    """Fans (caps, 3) int64 over the holes that the faces left out of a surface make in it; its own border stays."""
    if len(kept) == len(faces):
        return faces[:0]
    border = Topology(faces, vertex_count).border_vertices
    fans = [faces[:0]]
    for loop in Topology(faces[kept], vertex_count).boundary_loops:
        if len(loop) > 2 and len(np.unique(loop)) == len(loop) and not border[loop].any():
            ring = loop[::-1]
            fans.append(np.column_stack([np.full(len(ring) - 2, ring[0]), ring[1:-1], ring[2:]]))
    return np.concatenate(fans)


class PosedSurface:
    """A surface at one instant, ready to be queried; the search tree is fitted to it on first use.

    Args:
        surface: the unchanging part.
        vertices: (vertices, 3) [m].

    Raises:
        InputError: the number of vertices is another than the surface has.
    """

    def __init__(self, surface: TriangleSurface, vertices: Tensor) -> None:
        if vertices.shape != (surface.vertex_count, 3):
            raise InputError(
                f"A surface of {surface.vertex_count} vertices was given positions {tuple(vertices.shape)}."
            )
        self.surface = surface
        self.vertices = vertices.to(torch.float64)

    @cached_property
    def _searched(self) -> Searched:
        vertices = np.ascontiguousarray(self.vertices.numpy())
        faces, tree = self.surface.faces, self.surface.tree(vertices)
        fitted = tree.fitted(vertices, faces)
        return Searched(vertices, faces, self.surface.fans, tree.order, tree.children, tree.bottoms, *fitted)

    @cached_property
    def _corners(self) -> tuple[Tensor, Tensor, Tensor]:
        faces = self.surface._on(self.vertices.device)[0]
        a, b, c = (self.vertices.index_select(0, faces[:, k]) for k in range(3))
        return a, b, c

    @cached_property
    def face_normals(self) -> Tensor:
        """Unit normals (kept faces, 3) float64 of the faces, 0 for a degenerate one."""
        a, b, c = self._corners
        cross = torch.linalg.cross(b - a, c - a)
        return cross / cross.norm(dim=1, keepdim=True).clamp_min(1e-300)

    @cached_property
    def _edge_normals(self) -> Tensor:
        face_edges = self.surface._on(self.vertices.device)[1]
        total = self.vertices.new_zeros((len(self.surface.topology.edges), 3))
        for k in range(3):
            total.index_add_(0, face_edges[:, k], self.face_normals)
        return total

    @cached_property
    def _vertex_normals(self) -> Tensor:
        faces = self.surface._on(self.vertices.device)[0]
        corners = self._corners
        total = torch.zeros_like(self.vertices)
        for k in range(3):
            u, v = corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]
            angle = torch.atan2(torch.linalg.cross(u, v).norm(dim=1), (u * v).sum(1))
            total.index_add_(0, faces[:, k], angle[:, None] * self.face_normals)
        return total

    def nearest(self, points: Tensor | np.ndarray) -> NearestPoints:
        """Exact nearest points of the surface; quickest for points that lie near the ones before and after them.

        Args:
            points: (points, 3) [m].

        Raises:
            InputError: one of them is not finite.
        """
        asked = torch.as_tensor(points).detach()
        queried = asked.to(self.vertices.device, torch.float64)
        if not bool(torch.isfinite(queried).all()):
            raise InputError("A position is not finite (NaN or infinite); look at the file or arrays of the garment.")
        if self.compiled:
            found = Found.nothing(len(queried))
            self.update_closest(queried.numpy(), found)
            _, original, barycentric, position, normal, distance, beyond = (torch.from_numpy(v) for v in found)
        else:
            triangle, barycentric, position, normal, distance, beyond = self._nearest_by_candidates(queried)
            original = self.surface._on(self.vertices.device)[4].index_select(0, triangle)

        def back(t: Tensor) -> Tensor:
            return t.to(asked.device, asked.dtype if asked.dtype.is_floating_point else torch.float64)

        return NearestPoints(
            triangle=original.to(asked.device),
            barycentric=back(barycentric),
            positions=back(position),
            normals=back(normal),
            signed_distance=back(distance),
            beyond_border=beyond.to(asked.device),
        )

    @property
    def compiled(self) -> bool:
        """Whether `update_closest` answers here."""
        return COMPILES and self.vertices.device.type == "cpu"

    def update_closest(
        self,
        points: np.ndarray,
        found: Found,
        within: float = np.inf,
        patience: float = 0.0,
        names: np.ndarray | None = None,
    ) -> int:
        """Bring what was found at this pose up to date; see `nearest_points.update_closest`.

        Args:
            points: (points, 3) [m].
            found: for the same points, wherever they were; changed.
            within: distance [m] from which on a point need only be known to be so far. An open surface has no use
                for it: by its border a point comes inside without passing through it.
            patience: way [m] that a point may have gone for its answer to stand.
            names: (faces,) int64 what to call the `faces` of the surface; `surface.names` by default.

        Returns:
            Number of points that were searched for.
        """
        searched, called = self._searched, self.surface.names if names is None else names
        asked = np.ascontiguousarray(points)
        far = within if self.surface.closed else np.inf
        starts = range(0, max(len(asked), 1), _POINTS_PER_PART)
        parts = [(asked[k : k + _POINTS_PER_PART], found.rows(k, k + _POINTS_PER_PART)) for k in starts]
        return sum(
            parallel_map(lambda part: update_closest(searched, called, part[0], far, patience, False, part[1]), parts)
        )

    def update_if_nearer(self, points: np.ndarray, found: Found, among: np.ndarray | None = None) -> None:
        """Bring up to date what was found where a face is nearer than that.

        Args:
            points: (points, 3) [m].
            found: for the same points; changed.
            among: (faces,) bool, the `faces` of the surface that may be; None for all.
        """
        searched = self._searched
        if among is not None:
            fitted = self.surface.tree(searched.vertices).fitted(searched.vertices, searched.faces, among)
            searched = searched._replace(corners=fitted[0], boxes=fitted[1])
        update_closest(searched, self.surface.names, np.ascontiguousarray(points), np.inf, -1.0, True, found)

    def _nearest_by_candidates(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
        """What `nearest_points` gives, by tensors alone."""
        triangle = self._nearest_triangle(points)
        a, b, c = (corner.index_select(0, triangle) for corner in self._corners)
        barycentric = closest_barycentric(points, a, b, c)
        position = barycentric[:, :1] * a + barycentric[:, 1:2] * b + barycentric[:, 2:] * c
        pseudo_normal, interior, beyond = self._feature(triangle, barycentric)
        offset = points - position
        length = offset.norm(dim=1)
        along = (offset * pseudo_normal).sum(1)
        sign = torch.where((along < 0) & ~beyond, -1.0, 1.0).to(torch.float64)
        usable = ~interior & (length > 1e-9)
        normal = torch.where(usable[:, None], offset * (sign / length.clamp_min(1e-300))[:, None], pseudo_normal)
        return triangle, barycentric, position, normal, sign * length, beyond

    def _feature(self, triangle: Tensor, barycentric: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Unit pseudo-normal of the nearest face, edge or vertex, whether it is a face, whether it is on the border."""
        faces, face_edges, border_edge, border_vertex, _ = self.surface._on(self.vertices.device)
        normal = self.face_normals.index_select(0, triangle)
        zero = barycentric <= 1e-12
        zeros = zero.sum(1)
        on_edge, on_vertex = zeros == 1, zeros == 2
        beyond = torch.zeros_like(on_edge)
        if bool(on_edge.any()):
            opposite = zero[on_edge].to(torch.int64).argmax(1)
            edge = face_edges[triangle[on_edge], (opposite + 1) % 3]
            normal[on_edge] = self._edge_normals[edge]
            beyond[on_edge] = border_edge[edge]
        if bool(on_vertex.any()):
            vertex = faces[triangle[on_vertex], (~zero[on_vertex]).to(torch.int64).argmax(1)]
            normal[on_vertex] = self._vertex_normals[vertex]
            beyond[on_vertex] = border_vertex[vertex]
        return normal / normal.norm(dim=1, keepdim=True).clamp_min(1e-300), zeros == 0, beyond

    def _nearest_triangle(self, points: Tensor) -> Tensor:
        """Nearest face among those with the nearest centres; every face where that cannot be certified."""
        a, b, c = self._corners
        centres = (a + b + c) / 3.0
        radius = torch.stack([(x - centres).norm(dim=1) for x in (a, b, c)]).amax()
        count = min(_CANDIDATES, len(centres))
        result = torch.empty(len(points), dtype=torch.int64, device=points.device)
        rows = max(1, _PAIRS_PER_CHUNK // len(centres))
        for start in range(0, len(points), rows):
            part = points[start : start + rows]
            distance, near = torch.cdist(part, centres).topk(count, dim=1, largest=False)
            best, bound = _closest_of(part, near, (a, b, c))
            unsure = (distance[:, -1] < bound + radius) & (count < len(centres))
            for row in torch.split(torch.nonzero(unsure).reshape(-1), max(1, rows // 16)):
                every = torch.arange(len(centres), device=points.device).expand(len(row), -1)
                best[row] = _closest_of(part[row], every, (a, b, c))[0]
            result[start : start + rows] = best
        return result

    def nearest_face_centre(self, points: Tensor | np.ndarray) -> tuple[Tensor, Tensor]:
        """Face with the nearest centre to each point: the HOOD family's convention.

        Args:
            points: (points, 3) [m].

        Returns:
            Face (points,) int64 and the distance to its centre (points,) [m].
        """
        asked = torch.as_tensor(points).detach()
        queried = asked.to(self.vertices.device, torch.float64)
        if self.vertices.device.type == "cpu":
            distance, face = self._centre_tree.query(queried.numpy())
            near = torch.from_numpy(np.asarray(face, dtype=np.int64)), torch.from_numpy(np.asarray(distance))
        else:
            a, b, c = self._corners
            rows = max(1, _PAIRS_PER_CHUNK // len(a))
            nearest = [torch.cdist(part, (a + b + c) / 3.0).min(dim=1) for part in torch.split(queried, rows)]
            near = torch.cat([n.indices for n in nearest]), torch.cat([n.values for n in nearest])
        original = self.surface._on(self.vertices.device)[4].index_select(0, near[0])
        return original.to(asked.device), near[1].to(asked.device, asked.dtype)

    @cached_property
    def _centre_tree(self) -> Any:
        from scipy.spatial import cKDTree

        a, b, c = self._corners
        return cKDTree(((a + b + c) / 3.0).numpy(), balanced_tree=False, compact_nodes=False)


def _closest_of(points: Tensor, faces: Tensor, corners: tuple[Tensor, Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """The closest of the candidate `faces` (points, candidates) to each point, and its distance [m]."""
    a, b, c = (corner[faces] for corner in corners)
    barycentric = closest_barycentric(points[:, None].expand_as(a), a, b, c)
    closest = barycentric[..., :1] * a + barycentric[..., 1:2] * b + barycentric[..., 2:] * c
    distance, column = (points[:, None] - closest).norm(dim=-1).min(dim=1)
    return faces.gather(1, column[:, None])[:, 0], distance
