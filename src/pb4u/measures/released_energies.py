"""The potential of the paper's tables: collision, friction and gravity as the family's released code measures them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.environment import STANDARD_GRAVITY
from pb4u.physics.contact.contact_set import ContactPlanes, ContactSet, no_planes
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.terms.energy_term import EnergyTerm, constant, dot, sum_by_garment
from pb4u.physics.terms.friction import SLIDING_DOWN, slip_across
from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import ColliderPose
from pb4u.scene.packed import PackedGarments


def released_potential() -> IncrementalPotential:
    """The potential of the paper's tables: every term, in its released form where it has one."""
    potential = IncrementalPotential(search=nearest_face_centres)
    for term in (ReleasedGravity(), ReleasedCollision(), ReleasedFriction()):
        potential = potential.with_term(term)
    return potential


class ReleasedGravity(EnergyTerm):
    """Minus the sum over vertices of m g . x' [J], with heights from the world's origin."""

    name = "gravity"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        energy = -garments.vertex_masses * (x @ constant(step.environment.gravity, x.dtype, x.device))
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)


@dataclass(frozen=True)
class ReleasedCollision(EnergyTerm):
    """The family's released collision, for tables: w max(eps - d_i, 0)^3 summed over vertices, without area or ground.

    d_i is the height over the plane, at t+1, of the face whose centre was nearest at t.

    Args:
        weight: w [J/m^3].
        clearance: eps, the distance below which it acts [m].
    """

    weight: float = 5e3
    clearance: float = 2e-3
    name = "collision"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments, planes, normal = step.garments, contacts.now, contacts.transported_normals
        if planes is None or step.bodies is None or normal is None:
            return x.new_zeros(garments.garment_count)
        centre = planes.transported(step.bodies.following).to(x)
        depth = (self.clearance - dot(x - centre, normal)).clamp_min(0.0)
        energy = torch.where(planes.touchable, self.weight * depth**3, 0.0)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)


@dataclass(frozen=True)
class ReleasedFriction(EnergyTerm):
    """The family's released friction, for tables: not smoothed, gates on squared distances, the third axis as up.

    Sum of mu m g c |s| over vertices whose nearest face centres before and after the step both lie within
    sqrt(3e-3) m, s projected off the mean of the two normals, c^2 = 1 - cos^2(s, +Z) + 1e-4.

    Args:
        coefficient: mu.
        squared_radius: square of the distance within which a vertex touches [m^2].
    """

    coefficient: float = 0.5
    squared_radius: float = 3e-3
    name = "friction"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments, now, following = step.garments, contacts.now, contacts.next
        if now is None or following is None or contacts.transported is None:
            return x.new_zeros(garments.garment_count)
        mean = now.normals + following.normals
        slip = slip_across(
            x, contacts.transported, mean / mean.norm(dim=1, keepdim=True).clamp_min(torch.finfo(x.dtype).tiny)
        )
        squared = dot(slip, slip)
        safe = squared.clamp_min(torch.finfo(x.dtype).tiny)
        length = torch.where(squared > 0, (safe * (1.0 + SLIDING_DOWN) - slip[:, 2] ** 2).clamp_min(0.0).sqrt(), 0.0)
        near = (now.distance**2 < self.squared_radius) & (following.distance**2 < self.squared_radius)
        limit = self.coefficient * STANDARD_GRAVITY * garments.vertex_masses
        energy = torch.where(near & now.touchable & following.touchable, limit * length, 0.0)
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)


def nearest_face_centres(pose: ColliderPose, garments: PackedGarments, x: Tensor) -> ContactPlanes:
    """Planes of the faces whose centres are nearest, with the distance to the centre: the HOOD family's convention.

    Args:
        pose: the bodies at one instant, regions left out of contact included.
        garments: pack whose vertices are queried.
        x: (vertices, 3) [m].
    """
    planes = no_planes(x)
    planes.barycentric.fill_(1.0 / 3.0)
    for world, (surface, rows) in enumerate(zip(pose.whole_surfaces, garments.world_vertices, strict=False)):
        if surface is None:
            continue
        face, distance = surface.nearest_face_centre(x[rows])
        corners = surface.vertices[torch.from_numpy(surface.surface.faces).to(surface.vertices.device)[face]]
        cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        planes.points[rows] = corners.mean(1).to(x)
        planes.normals[rows] = (cross / cross.norm(dim=1, keepdim=True).clamp_min(1e-300)).to(x)
        planes.distance[rows] = distance
        planes.touchable[rows] = True
        planes.triangle[rows] = pose.colliders.world_faces[world][face]
    return planes
