"""Closest points of many points on the surfaces of several worlds, in tensors alone: for accelerators.

Faces lie in groups, each in a ball. A point's distance to some corner of the group with the nearest middle bounds what
is sought; groups whose ball lies within that bound, then faces whose ball does, are tried. For 20,000 points and 27,000
faces that is 1/20 of all pairs looked at in one product of matrices, and some ten faces a point worked out exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.capacities import Capacities, found_rows
from pb4u.geometry.closest_point import closest_barycentric

if TYPE_CHECKING:
    from pb4u.collision.nearest_surface import TriangleSurface

GROUP = 32
"""Faces, or vertices, of a group."""

_ROUNDING = 1e-9
"""Squared distance [m^2], and distance [m], by which a bound is widened."""

_ON_EDGE = 1e-12
"""Barycentric coordinate up to which the closest point of a face lies on its edge, as in the compiled search."""


@dataclass(frozen=True, eq=False)
class Groups:
    """Items of each world in groups of neighbours; groups and worlds are filled up with repeated items.

    Args:
        items: (worlds, groups, `GROUP`) int64.
        filled: the same, bool, False where an item is repeated.
    """

    items: Tensor
    filled: Tensor

    @staticmethod
    def of(orders: Sequence[np.ndarray], device: torch.device) -> Groups:
        """Groups of items.

        Args:
            orders: items (items,) int64 of each world, at least one, neighbours one after the other.
            device: of the tensors.
        """
        count = -(-max(len(order) for order in orders) // GROUP) * GROUP
        items = np.stack([np.pad(order, (0, count - len(order)), mode="edge") for order in orders])
        filled = np.stack([np.arange(count) < len(order) for order in orders])
        shape = (len(orders), -1, GROUP)
        return Groups(*(torch.from_numpy(values.reshape(shape)).to(device) for values in (items, filled)))


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls that hold the groups at one pose.

    Args:
        centres: (worlds, groups, 3) [m].
        radii: (worlds, groups) [m].
    """

    centres: Tensor
    radii: Tensor

    @staticmethod
    def around(points: Tensor) -> Balls:
        """Balls around `points` (worlds, groups, points, 3) [m].

        Args:
            points: (worlds, groups, points, 3) [m].
        """
        centres = 0.5 * (points.amin(-2) + points.amax(-2))
        return Balls(centres, (points - centres[..., None, :]).norm(dim=-1).amax(-1))

    def within(self, points: Tensor, bounds: Tensor) -> Tensor:
        """Whether each ball (worlds, points, groups) comes within `bounds` (worlds, points) [m] of `points`.

        |c - x| <= r + b, squared: one product of matrices over six columns.

        Args:
            points: (worlds, points, 3) [m].
            bounds: (worlds, points) [m].
        """
        x, b, r, ones = points, bounds[..., None], self.radii[..., None], torch.ones_like
        own = torch.cat([-2.0 * x, -2.0 * b, ones(b), x.square().sum(-1, keepdim=True) - b * b], dim=-1)
        sums = self.centres.square().sum(-1, keepdim=True) - r * r
        return own @ torch.cat([self.centres, r, sums, ones(r)], dim=-1).mT <= _ROUNDING

    def nearest(self, points: Tensor) -> Tensor:
        """Group (worlds, points) int64 whose centre is nearest to each of `points` (worlds, points, 3) [m].

        Args:
            points: (worlds, points, 3) [m].
        """
        squares = self.centres.square().sum(-1)
        return torch.baddbmm(squares[:, None], points, self.centres.mT, alpha=-2.0).argmin(-1)


@dataclass(frozen=True, eq=False)
class BatchedSurface:
    """Surfaces of several worlds, whose vertices are packed one after the other.

    Args:
        faces: (faces, 3) int64 packed vertices.
        face_edges: (faces, 3) int64 packed edges, the first between corners 0 and 1.
        names: (faces,) int64 what answers call each face.
        border_edges: (edges,) bool.
        border_vertices: (vertices,) bool.
        groups: of faces.
        present: (worlds,) bool, whether a world has a surface; the others have one of another world.
    """

    faces: Tensor
    face_edges: Tensor
    names: Tensor
    border_edges: Tensor
    border_vertices: Tensor
    groups: Groups
    present: Tensor

    @staticmethod
    def of(
        surfaces: Sequence[TriangleSurface | None],
        starts: Sequence[int],
        names: Sequence[np.ndarray],
        vertices: Tensor,
    ) -> BatchedSurface | None:
        """Surfaces in the order of their worlds; None where there is none at all.

        Args:
            surfaces: of each world, or None.
            starts: first packed vertex of each world.
            names: what answers call the faces of each surface, (faces,) int64.
            vertices: (vertices, 3) [m] of all worlds at some pose; what is near there goes into one group.
        """
        present = [world for world, surface in enumerate(surfaces) if surface is not None]
        if not present:
            return None
        places = vertices.detach().to("cpu", torch.float64).numpy()
        faces, edges, called, borders, orders = [], [], [], [], {}
        face_count = edge_count = 0
        border_vertices = np.zeros(len(places), dtype=bool)
        for world in present:
            surface, start = surfaces[world], starts[world]
            assert surface is not None
            mesh, rows = surface.topology, slice(start, start + surface.vertex_count)
            orders[world] = surface.tree(places[rows]).order + face_count
            faces.append(surface.faces + start)
            edges.append(mesh.face_edges + edge_count)
            called.append(names[world])
            borders.append(mesh.edge_face_counts == 1)
            border_vertices[rows] = mesh.border_vertices
            face_count, edge_count = face_count + len(surface.faces), edge_count + len(mesh.edges)
        arrays = (*map(np.concatenate, (faces, edges, called, borders)), border_vertices)
        device = vertices.device
        tensors = (torch.from_numpy(array).to(device) for array in arrays)
        groups = Groups.of([orders.get(world, orders[present[0]]) for world in range(len(surfaces))], device)
        has_one = torch.tensor([surface is not None for surface in surfaces], device=device)
        corners, sides, answers, border_edges, on_border = tensors
        return BatchedSurface(corners, sides, answers, border_edges, on_border, groups, has_one)


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


class PosedBatch:
    """Surfaces at one instant.

    Args:
        surface: the unchanging part.
        vertices: (vertices, 3) float64 [m].
    """

    def __init__(self, surface: BatchedSurface, vertices: Tensor) -> None:
        self.surface, self.vertices = surface, vertices

    @cached_property
    def corners(self) -> Tensor:
        """(faces, 3, 3) [m]."""
        return self.vertices[self.surface.faces]

    @cached_property
    def _groups(self) -> tuple[Balls, Tensor, Tensor]:
        """Balls of the groups, and centres (faces, 3) and radii (faces,) [m] of those of faces."""
        items, corners = self.surface.groups.items, self.corners
        faces = Balls.around(corners)
        return Balls.around(corners[items].flatten(2, 3)), faces.centres, faces.radii

    @cached_property
    def face_normals(self) -> Tensor:
        """Unit normals (faces, 3), 0 for a face without area."""
        a, b, c = self.corners.unbind(1)
        return _unit(torch.linalg.cross(b - a, c - a))

    @cached_property
    def _pseudo_normals(self) -> tuple[Tensor, Tensor]:
        """Unit pseudo-normals of edges (edges, 3) and of vertices (vertices, 3) (Baerentzen and Aanaes 2005)."""
        surface, normals, corners = self.surface, self.face_normals, self.corners
        thrice = normals[:, None].expand(-1, 3, -1)
        edges = normals.new_zeros(len(surface.border_edges), 3)
        edges = edges.index_add(0, surface.face_edges.reshape(-1), thrice.reshape(-1, 3))
        u, v = corners.roll(-1, 1) - corners, corners.roll(-2, 1) - corners
        angles = torch.atan2(torch.linalg.cross(u, v).norm(dim=-1, keepdim=True), (u * v).sum(-1, keepdim=True))
        vertices = torch.zeros_like(self.vertices)
        vertices = vertices.index_add(0, surface.faces.reshape(-1), (angles * thrice).reshape(-1, 3))
        return _unit(edges), _unit(vertices)

    def closest(self, points: Tensor, capacities: Capacities | None = None) -> NearestPoints:
        """Exact closest points of the surface of each world; one that is not finite has one that means nothing.

        Args:
            points: (worlds, points, 3) float64 [m].
            capacities: fixed numbers of groups and of faces that are looked at.
        """
        flat = points.reshape(-1, 3)
        face, barycentric, position = self._closest_faces(points, flat, capacities)
        normal, interior, beyond = self._feature(face, barycentric)
        offset = flat - position
        length, along = offset.norm(dim=1), (offset * normal).sum(1)
        sign = torch.where((along < 0.0) & ~beyond, -1.0, 1.0).to(length)
        usable = ~interior & (length > 1e-9)
        normal = torch.where(usable[:, None], offset * (sign / length.clamp_min(1e-300))[:, None], normal)
        absent = ~self.surface.present.repeat_interleave(points.shape[1], output_size=len(flat))
        distance = torch.where(absent, torch.inf, sign * length)
        return NearestPoints(self.surface.names[face], barycentric, position, normal, distance, beyond | absent)

    def _closest_faces(
        self, points: Tensor, flat: Tensor, capacities: Capacities | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Closest face (points,) of each point, the barycentric coordinates (points, 3) in it, and the position [m]."""
        balls, centres, radii = self._groups
        items, count = self.surface.groups.items, balls.radii.shape[1]
        worlds = torch.arange(len(points), device=points.device)[:, None]
        tried = self.corners[:, 0][items[worlds, balls.nearest(points)]]
        bounds = (tried - points[:, :, None]).norm(dim=-1).amin(-1)

        pairs, filled = found_rows(balls.within(points, bounds), "groups of faces", capacities)
        row = pairs // count
        face = items.flatten(0, 1)[row // points.shape[1] * count + pairs % count]
        bound, start = bounds.reshape(-1), flat[row]
        near = (centres[face] - start[:, None]).norm(dim=-1) - radii[face] <= bound[row, None] + _ROUNDING
        pairs, filled = found_rows(near & filled[:, None], "faces", capacities)
        row, face = row[pairs // GROUP], face.reshape(-1)[pairs]

        start = flat[row]
        a, b, c = self.corners[face].unbind(1)
        barycentric = closest_barycentric(start, a, b, c)
        position = barycentric[:, :1] * a + barycentric[:, 1:2] * b + barycentric[:, 2:] * c
        distance = torch.where(filled, (start - position).square().sum(1), torch.inf)
        least = distance.new_full((len(flat),), torch.inf).scatter_reduce(0, row, distance, "amin")
        # Of equally near faces the first in the order of the groups.
        number = torch.arange(len(row), device=row.device)
        last = len(row) - 1
        first = torch.where(filled & (distance <= least[row]), number, last)
        chosen = torch.full_like(flat[:, 0], last, dtype=torch.int64).scatter_reduce(0, row, first, "amin")
        return face[chosen], barycentric[chosen], position[chosen]

    def _feature(self, face: Tensor, barycentric: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Pseudo-normal of the closest face, edge or vertex, whether it is a face, and whether it is on the border."""
        surface, (edge_normals, vertex_normals) = self.surface, self._pseudo_normals
        zero = barycentric <= _ON_EDGE
        zeros = zero.sum(1)
        interior, on_edge = zeros == 0, zeros == 1
        edge = surface.face_edges[face, (zero.to(torch.int64).argmax(1) + 1) % 3]
        vertex = surface.faces[face, barycentric.argmax(1)]
        normal = torch.where(on_edge[:, None], edge_normals[edge], vertex_normals[vertex])
        normal = torch.where(interior[:, None], self.face_normals[face], normal)
        beyond = torch.where(on_edge, surface.border_edges[edge], surface.border_vertices[vertex]) & ~interior
        return normal, interior, beyond


def _unit(vectors: Tensor) -> Tensor:
    return vectors / vectors.norm(dim=-1, keepdim=True).clamp_min(1e-300)
