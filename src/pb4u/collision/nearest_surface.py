"""Nearest points on a moving triangle surface, with sign: negative inside.

The nearest triangle is exact: a compiled search of a tree of boxes on the processor; groups of faces in tensors
(`batched_surface`) on other devices. The sign comes from angle-weighted pseudo-normals (Baerentzen and Aanaes 2005),
which are right at edges and corners too.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.batched_surface import BatchedSurface, NearestPoints, PosedBatch
from pb4u.collision.nearest_points import Found, Searched, update_closest
from pb4u.collision.wide_tree import WideTree, fit
from pb4u.errors import InputError
from pb4u.geometry.topology import Topology
from pb4u.threads import parallel_map

# Distances between points and faces worked out at a time, which bounds the memory.
_PAIRS_PER_CHUNK = 20_000_000

_POINTS_PER_PART = 2048
"""Points that one thread looks up at a time, in 3 ms: to wake another processor may take a quarter of one."""


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
            raise InputError("The contact region of the body is empty: no face of its surface takes part in contact.")
        self.caps = _caps(faces, kept, vertex_count) if capped else faces[:0]
        self.region_faces = faces[kept]
        self.faces = np.concatenate([self.region_faces, self.caps])
        self.vertex_count = vertex_count
        self.names = np.concatenate([kept, len(faces) + np.arange(len(self.caps))])
        self._tree: WideTree | None = None
        self._batched: dict[str, BatchedSurface] = {}

    @cached_property
    def topology(self) -> Topology:
        return Topology(self.faces, self.vertex_count)

    def batched(self, vertices: Tensor) -> BatchedSurface:
        """This surface in tensors on the device of `vertices` (vertices, 3) [m]; the pose first given forms groups.

        Args:
            vertices: (vertices, 3) [m].
        """
        key = str(vertices.device)
        if key not in self._batched:
            made = BatchedSurface.of([self], [0], [self.names], vertices)
            assert made is not None
            self._batched[key] = made
        return self._batched[key]

    @cached_property
    def fans(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Begin of the faces of each vertex (vertices + 1,), these faces, and which vertices are on a border."""
        return *self.topology.vertex_faces, self.topology.border_vertices

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
        """This surface with its `vertices` (vertices, 3) [m] somewhere.

        Args:
            vertices: (vertices, 3) [m].
        """
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
    def searched(self) -> Searched:
        """The surface as compiled searches see it."""
        vertices = np.ascontiguousarray(self.vertices.numpy())
        faces, tree = self.surface.faces, self.surface.tree(vertices)
        fitted = fit(vertices, faces, tree.order, tree.levels)
        return Searched(vertices, faces, self.surface.fans, tree.order, tree.children, tree.bottoms, *fitted)

    @cached_property
    def batch(self) -> PosedBatch:
        """The same for searches in tensors."""
        return PosedBatch(self.surface.batched(self.vertices), self.vertices)

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
            raise InputError("A position is not finite (NaN or infinite); check the file or arrays of the garment.")
        if self.compiled:
            found = Found.nothing(len(queried))
            self.update_closest(queried.numpy(), found)
            near = NearestPoints(*map(torch.from_numpy, found[1:]))
        else:
            near = self.batch.closest(queried[None])
        dtype = asked.dtype if asked.dtype.is_floating_point else torch.float64
        return NearestPoints(
            *(value.to(asked.device, dtype if value.is_floating_point() else None) for value in vars(near).values())
        )

    @property
    def compiled(self) -> bool:
        """Whether `update_closest` answers here."""
        return self.vertices.device.type == "cpu"

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
        searched, called = self.searched, self.surface.names if names is None else names
        asked = np.ascontiguousarray(points)
        far = within if self.surface.closed else np.inf
        starts = range(0, max(len(asked), 1), _POINTS_PER_PART)
        parts = [(asked[k : k + _POINTS_PER_PART], found.rows(k, k + _POINTS_PER_PART)) for k in starts]
        return sum(
            parallel_map(lambda part: update_closest(searched, called, part[0], far, patience, False, part[1]), parts)
        )

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
            centres = self.batch.corners.mean(1)
            rows = max(1, _PAIRS_PER_CHUNK // len(centres))
            nearest = [torch.cdist(part, centres).min(dim=1) for part in torch.split(queried, rows)]
            near = torch.cat([n.indices for n in nearest]), torch.cat([n.values for n in nearest])
        original = self.batch.surface.names.index_select(0, near[0])
        return original.to(asked.device), near[1].to(asked.device, asked.dtype)

    @cached_property
    def _centre_tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.batch.corners.mean(1).numpy(), balanced_tree=False, compact_nodes=False)
