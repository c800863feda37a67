"""Tangent planes of the body at the point nearest to each vertex, shared by the energies and the contact response."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.physics.contact.self_contact import ClothPairs, TouchingCloth
from pb4u.scene.packed import ColliderFrame, ColliderPose, PackedGarments


@dataclass(frozen=True, eq=False)
class ContactPlanes:
    """The body near each vertex as a plane; distance and gradient are exact at the vertex position used for the lookup.

    Args:
        points: (vertices, 3) nearest points of the body [m].
        normals: (vertices, 3) outward unit normals.
        distance: (vertices,) distance [m] of the position used for the lookup, signed for exact planes.
        touchable: (vertices,) bool, False where the vertex has no body or is nearest to a region left out of contact.
        triangle: (vertices,) int64 among the contact faces of the packed colliders.
        barycentric: (vertices, 3) of the point in that face.
    """

    points: Tensor
    normals: Tensor
    distance: Tensor
    touchable: Tensor
    triangle: Tensor
    barycentric: Tensor

    def signed_distance(self, x: Tensor) -> Tensor:
        """Height (vertices,) [m] of each vertex over its plane, negative inside the body.

        Args:
            x: (vertices, 3) [m].
        """
        return ((x - self.points) * self.normals).sum(-1)

    def where(self, rows: Tensor, otherwise: ContactPlanes) -> ContactPlanes:
        """These planes for the vertices of `rows` (vertices,) bool, those of `otherwise` for the rest."""
        return ContactPlanes(
            **{
                name: torch.where(rows.reshape(-1, *[1] * (value.dim() - 1)), value, getattr(otherwise, name))
                for name, value in vars(self).items()
            }
        )

    def transported(self, pose: ColliderPose) -> Tensor:
        """Positions (vertices, 3) [m] of the nearest points when the bodies take `pose`."""
        return self.interpolated(pose.positions, pose.colliders.contact_faces)

    def interpolated(self, values: Tensor, faces: Tensor) -> Tensor:
        """Values (vertices, 3) interpolated at the nearest points, in the unit of `values`.

        Args:
            values: (body vertices, 3) of any unit.
            faces: (body faces, 3) int64 contact faces of the packed colliders.
        """
        corners = values.to(self.barycentric.dtype)[faces[self.triangle]]
        return (self.barycentric[:, :, None] * corners).sum(1)

    def transported_normals(self, pose: ColliderPose) -> Tensor:
        """Dimensionless unit normals (vertices, 3) of the faces of the nearest points when the bodies take `pose`."""
        corners = pose.positions.to(self.normals.dtype)[pose.colliders.contact_faces[self.triangle]]
        cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return cross / cross.norm(dim=1, keepdim=True).clamp_min(torch.finfo(cross.dtype).tiny)


@dataclass(frozen=True, eq=False)
class ContactSet:
    """Contacts of one time step, as the energies see them.

    The solver looks up contacts at frame t once a step, and those at t+1 anew for vertices that moved.

    Args:
        now: for each vertex at frame t, the plane of the body that it may slide on, or None.
        next: for each vertex at frame t+1, the plane of the body that it may enter, or None.
        opposite: a second plane for vertices caught between two parts of the body, or None.
        transported: (vertices, 3) [m] positions of the vertices if the body carried them over the step, or None.
        transported_normals: (vertices, 3) the body's unit normals there at t+1, or None.
        cloth: pairs of cloth elements that may feel each other at t+1, or None.
        cloth_now: those that do at frame t, or None.
    """

    now: ContactPlanes | None = None
    next: ContactPlanes | None = None
    opposite: ContactPlanes | None = None
    transported: Tensor | None = None
    transported_normals: Tensor | None = None
    cloth: ClothPairs | None = None
    cloth_now: TouchingCloth | None = None

    @staticmethod
    def at_start(garments: PackedGarments, bodies: ColliderFrame | None, x: Tensor, search: PlaneSearch) -> ContactSet:
        """Contacts known at the start of a step; every finder is called here.

        Args:
            garments: whose vertices they are.
            bodies: around the step, or None.
            x: (vertices, 3) [m] at frame t.
            search: finds the planes of the bodies at frame t.
        """
        if bodies is None:
            return ContactSet()
        now = search(bodies.now, garments, x.detach())
        motion = now.interpolated(bodies.motion, bodies.colliders.contact_faces)
        normals = now.transported_normals(bodies.following)
        return ContactSet(now=now, transported=x + motion.to(x), transported_normals=normals.to(x))


PlaneSearch = Callable[[ColliderPose, PackedGarments, Tensor], ContactPlanes]
"""Finds the plane of each vertex; called with the pose of the bodies, the garments and positions (vertices, 3) [m]."""


def nearest_planes(
    pose: ColliderPose,
    garments: PackedGarments,
    x: Tensor,
    among: Tensor | None = None,
    otherwise: ContactPlanes | None = None,
) -> ContactPlanes:
    """Planes through the exact nearest points of the bodies of each vertex's world.

    Args:
        pose: the bodies at one instant.
        garments: pack whose vertices are looked up.
        x: (vertices, 3) [m].
        among: (vertices,) bool, the vertices to look up; the rest keep the planes of `otherwise`.
        otherwise: planes looked up before.
    """
    planes = _blank(x) if otherwise is None else _copy(otherwise)
    for world, surface in enumerate(pose.surfaces):
        rows = _rows(garments, world, among, x.device)
        if surface is None or not len(rows):
            continue
        nearest = surface.nearest(x.detach()[rows])
        planes.points[rows] = nearest.positions
        planes.normals[rows] = nearest.normals
        planes.distance[rows] = nearest.signed_distance
        planes.touchable[rows] = ~nearest.beyond_border
        planes.triangle[rows] = pose.colliders.world_contact_faces[world][nearest.triangle]
        planes.barycentric[rows] = nearest.barycentric
    return planes


def nearest_face_centres(pose: ColliderPose, garments: PackedGarments, x: Tensor) -> ContactPlanes:
    """Planes of the faces whose centres are nearest, with the distance to the centre: the HOOD family's convention.

    Args:
        pose: the bodies at one instant, regions left out of contact included.
        garments: pack whose vertices are looked up.
        x: (vertices, 3) [m].
    """
    planes = _blank(x)
    planes.barycentric.fill_(1.0 / 3.0)
    for world, surface in enumerate(pose.whole_surfaces):
        if surface is None:
            continue
        rows = _rows(garments, world, None, x.device)
        face, distance = surface.nearest_face_centre(x[rows])
        corners = surface.vertices[torch.from_numpy(surface.surface.faces).to(surface.vertices.device)[face]]
        cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        planes.points[rows] = corners.mean(1).to(x)
        planes.normals[rows] = (cross / cross.norm(dim=1, keepdim=True).clamp_min(1e-300)).to(x)
        planes.distance[rows] = distance
        planes.touchable[rows] = True
        planes.triangle[rows] = pose.colliders.world_faces[world][face]
    return planes


def clearances(pose: ColliderPose, points: Tensor, world: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distance (points,) [m] to the bodies, and outward unit normals (points, 3).

    Where there is no body, or only a region left out of contact or the cap of one, the distance is infinite.

    Args:
        pose: the bodies at one instant.
        points: (points, 3) [m].
        world: (points,) int64 index of the world of each.
    """
    distance, normals = points.new_full((len(points),), torch.inf), torch.zeros_like(points)
    for number, surface in enumerate(pose.surfaces):
        rows = torch.nonzero(world == number)[:, 0]
        if surface is None or not len(rows):
            continue
        nearest = surface.nearest(points[rows])
        no_skin = nearest.beyond_border | (nearest.triangle >= len(pose.colliders.world_faces[number]))
        distance[rows] = torch.where(no_skin, torch.inf, nearest.signed_distance)
        normals[rows] = nearest.normals
    return distance, normals


def _rows(garments: PackedGarments, world: int, among: Tensor | None, device: torch.device) -> Tensor:
    first, stop = garments.world_offsets[world : world + 2]
    rows = torch.arange(first, stop, device=device)
    return rows if among is None else rows[among[rows]]


def _blank(x: Tensor) -> ContactPlanes:
    normals = torch.zeros_like(x, requires_grad=False)
    return ContactPlanes(
        points=x.detach().clone(),
        normals=normals,
        distance=torch.full_like(x[:, 0], torch.inf, requires_grad=False),
        touchable=torch.zeros(len(x), dtype=torch.bool, device=x.device),
        triangle=torch.zeros(len(x), dtype=torch.int64, device=x.device),
        barycentric=torch.zeros_like(x, requires_grad=False),
    )


def _copy(planes: ContactPlanes) -> ContactPlanes:
    return ContactPlanes(**{name: value.clone() for name, value in vars(planes).items()})
