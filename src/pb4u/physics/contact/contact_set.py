"""Tangent planes of the body at the point nearest to each vertex, shared by the energies and the contact response."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64, compiled, compiled_with_fused_products
from pb4u.collision.lengths import length
from pb4u.collision.nearest_points import Found
from pb4u.physics.contact.self_contact import ClothPairs, TouchingCloth
from pb4u.scene.colliders import ColliderFrame, ColliderPose
from pb4u.scene.packed import PackedGarments

if TYPE_CHECKING:
    from pb4u.physics.contact.obstacle import Obstacle


_TINY = float(np.finfo(np.float64).tiny)
"""Length below which a normal is not one: that of a face without area."""


@dataclass(frozen=True, eq=False)
class ContactPlanes:
    """The body near each vertex as a plane; distance and gradient are exact at the vertex position used for the lookup.

    Args:
        points: (vertices, 3) nearest points of the body [m].
        normals: (vertices, 3) outward unit normals.
        distance: (vertices,) distance [m] at the position of the lookup, signed for exact planes; for a vertex out of
            reach this may be an earlier position.
        touchable: (vertices,) bool, False where the vertex has no body or is nearest to a region left out of contact.
        triangle: (vertices,) int64 among the contact faces of the packed colliders.
        barycentric: (vertices, 3) of the point in that face.
        looped: whether compiled loops transport them, with the same bits as torch: true for planes of a compiled
            float64 search.
    """

    points: Tensor
    normals: Tensor
    distance: Tensor
    touchable: Tensor
    triangle: Tensor
    barycentric: Tensor
    looped: bool = False

    def signed_distance(self, x: Tensor) -> Tensor:
        """Height (vertices,) [m] of each vertex over its plane, negative inside the body.

        Args:
            x: (vertices, 3) [m].
        """
        return ((x - self.points) * self.normals).sum(-1)

    def raised(self, heights: Tensor) -> ContactPlanes:
        """These planes raised by `heights` (vertices,) [m] along their normals.

        Args:
            heights: (vertices,) [m].
        """
        return replace(self, points=self.points + heights[:, None] * self.normals, distance=self.distance - heights)

    def where(self, rows: Tensor, otherwise: ContactPlanes) -> ContactPlanes:
        """These planes for the vertices of `rows` (vertices,) bool, and the planes of `otherwise` for the rest.

        Args:
            rows: (vertices,) bool.
            otherwise: planes for the other vertices.
        """
        chosen: dict[str, Any] = {
            name: torch.where(rows.reshape(-1, *[1] * (value.dim() - 1)), value, getattr(otherwise, name))
            for name, value in vars(self).items()
            if isinstance(value, Tensor)
        }
        return ContactPlanes(**chosen)

    def transported(self, pose: ColliderPose) -> Tensor:
        """Positions (vertices, 3) [m] of the nearest points when the bodies are at `pose`.

        Args:
            pose: pose of the bodies.
        """
        return self.interpolated(pose.positions, pose.colliders.contact_faces)

    def interpolated(self, values: Tensor, faces: Tensor) -> Tensor:
        """Values (vertices, 3) interpolated at the nearest points, in the unit of `values`.

        Args:
            values: (body vertices, 3) of any unit.
            faces: (body faces, 3) int64 contact faces of the packed colliders.
        """
        if self.looped and _is_plain(values):
            found = _interpolated(self.barycentric.numpy(), self.triangle.numpy(), values.numpy(), faces.numpy())
            return torch.from_numpy(found)
        corners = values.to(self.barycentric.dtype)[faces[self.triangle]]
        return (self.barycentric[:, :, None] * corners).sum(1)

    def transported_normals(self, pose: ColliderPose) -> Tensor:
        """Dimensionless unit normals (vertices, 3) of the faces of the nearest points when the bodies are at `pose`.

        Args:
            pose: pose of the bodies.
        """
        faces = pose.colliders.contact_faces
        if self.looped and _is_plain(pose.positions):
            return torch.from_numpy(_face_normals(self.triangle.numpy(), pose.positions.numpy(), faces.numpy()))
        corners = pose.positions.to(self.normals.dtype)[faces[self.triangle]]
        cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return cross / cross.norm(dim=1, keepdim=True).clamp_min(torch.finfo(cross.dtype).tiny)


def _is_plain(values: Tensor) -> bool:
    """Whether loops can read float64 `values`: neither autograd nor another transform of torch follows them."""
    followed = values.requires_grad or torch._C._are_functorch_transforms_active()
    return values.dtype == torch.float64 and not followed


@compiled
def _interpolated(barycentric: np.ndarray, triangles: np.ndarray, values: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Values (n, 3) at `barycentric` (n, 3) places of some `triangles` (n,) of the `faces`."""
    found = np.empty(barycentric.shape)
    for row in range(len(found)):
        a, b, c = faces[triangles[row]]
        u, v, w = barycentric[row]
        for axis in range(3):
            found[row, axis] = u * values[a, axis] + v * values[b, axis] + w * values[c, axis]
    return found


@compiled_with_fused_products
def _face_normals(triangles: np.ndarray, positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (n, 3) of some `triangles` (n,) of the `faces`; rounded as torch rounds them."""
    normals = np.empty((len(triangles), 3))
    for row in range(len(normals)):
        a, b, c = faces[triangles[row]]
        for axis in range(3):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            ui, uj = positions[b, i] - positions[a, i], positions[b, j] - positions[a, j]
            vi, vj = positions[c, i] - positions[a, i], positions[c, j] - positions[a, j]
            normals[row, axis] = ui * vj - uj * vi
        long = max(length(normals[row, 0], normals[row, 1], normals[row, 2]), _TINY)
        for axis in range(3):
            normals[row, axis] /= long
    return normals


@dataclass(frozen=True, eq=False)
class ContactSet:
    """Contacts of one time step, as used by the energies.

    The solver looks up contacts at frame t once a step, and those at t+1 again for vertices that moved.

    Args:
        now: for each vertex at frame t, the plane of the body that it may slide on, or None.
        next: for each vertex at frame t+1, the plane of the body that it may enter, or None.
        opposite: a second plane for vertices caught between two parts of the body, or None.
        transported: (vertices, 3) [m] positions of the vertices if they moved with the body during the step, or None.
        transported_normals: (vertices, 3) the body's unit normals there at t+1, or None.
        cloth: pairs of cloth elements that may feel each other at t+1, or None.
        cloth_now: pairs of cloth elements that touch at frame t, or None.
        obstacle: the bodies at t+1 as cloth may not pass through them, or None.
        raised: heights (vertices,) [m] that the planes are raised by for the cloth between vertices, or None.
    """

    now: ContactPlanes | None = None
    next: ContactPlanes | None = None
    opposite: ContactPlanes | None = None
    transported: Tensor | None = None
    transported_normals: Tensor | None = None
    cloth: ClothPairs | None = None
    cloth_now: TouchingCloth | None = None
    obstacle: Obstacle | None = None
    raised: Tensor | None = None

    def raised_by(self, heights: Tensor | None) -> ContactSet:
        """These contacts with the planes that vertices may slide on raised; the same without heights or planes.

        Args:
            heights: (vertices,) [m].
        """
        if heights is None or self.now is None:
            return self
        return replace(self, now=self.now.raised(heights), raised=heights)

    @staticmethod
    def at_start(garments: PackedGarments, bodies: ColliderFrame | None, x: Tensor, search: PlaneSearch) -> ContactSet:
        """Contacts known at the start of a step; every finder is called here.

        Args:
            garments: the garments with these vertices.
            bodies: around the step, or None.
            x: (vertices, 3) [m] at frame t.
            search: finds the planes of the bodies at frame t.
        """
        if bodies is None:
            return ContactSet()
        now = search(bodies.now, garments, x.detach())
        _lead(bodies.following, garments, now)
        motion = now.interpolated(bodies.motion, bodies.colliders.contact_faces)
        normals = now.transported_normals(bodies.following)
        return ContactSet(now=now, transported=x + motion.to(x), transported_normals=normals.to(x))


PlaneSearch = Callable[[ColliderPose, PackedGarments, Tensor], ContactPlanes]
"""Finds the plane of each vertex; called with the pose of the bodies, the garments and positions (vertices, 3) [m]."""

CONTACT_REACH = 0.01
"""Distance [m] from the body from which on the plane of a vertex concerns no energy: five times where that begins."""

MOTION_REACH = 0.05
"""Distance [m] from the body from which on its motion over a step does not concern a vertex."""

UNMOVED = 1e-9
"""Way [m] up to which a vertex counts as unmoved since it was queried: sums in another order end so far apart."""


def nearest_planes(
    pose: ColliderPose,
    garments: PackedGarments,
    x: Tensor,
    within: float = CONTACT_REACH,
    patience: float = UNMOVED,
) -> ContactPlanes:
    """Planes through the exact nearest points of the bodies of each vertex's world.

    A vertex keeps its earlier plane of this pose if it did not move, or is certainly still out of reach: its distance
    changes by at most its displacement. The first closest-point query at a pose is exact for all.

    Args:
        pose: the bodies at one instant.
        garments: pack whose vertices are queried.
        x: (vertices, 3) [m].
        within: distance [m] beyond which the exact distance of a vertex does not matter.
        patience: largest displacement [m] of a vertex since its query.
    """
    if _compiled(pose):
        _, *nearest = _renewed(pose, garments, x, within, patience)
        return _planes(map(torch.from_numpy, nearest), x, looped=x.dtype == torch.float64)
    batch = pose.batch(garments.world_count)
    if batch is None:
        return no_planes(x)
    places, _, rows = garments.world_rows
    near = batch.closest(x.detach().to(torch.float64)[places], pose.colliders.capacities)
    return _planes((values[rows] for values in vars(near).values()), x)


def _planes(nearest: Iterable[Tensor], x: Tensor, looped: bool = False) -> ContactPlanes:
    """The planes of the `nearest` points, six values in the order of `NearestPoints`, in the data type of `x`."""
    triangle, barycentric, positions, normals, distances, beyond = nearest
    return ContactPlanes(
        points=positions.to(x),
        normals=normals.to(x),
        distance=distances.to(x),
        touchable=~beyond,
        triangle=triangle,
        barycentric=barycentric.to(x),
        looped=looped,
    )


def _compiled(pose: ColliderPose) -> bool:
    return pose.colliders.capacities is None and all(surface is None or surface.compiled for surface in pose.surfaces)


def _renewed(pose: ColliderPose, garments: PackedGarments, x: Tensor, within: float, patience: float) -> Found:
    """What was found at the pose, brought up to date for `x`; the same object where nothing had to be searched for."""
    points, known, searched = as_float64(x), pose.found.get(garments.whole), 0
    found = Found.nothing(len(points)) if known is None else known.copy()
    for world, rows in enumerate(garments.world_vertices):
        part, surface = found.rows(rows.start, rows.stop), pose.surfaces[world] if world < len(pose.surfaces) else None
        if surface is not None:
            names = pose.colliders.searched_faces[world]
            searched += surface.update_closest(points[rows], part, within, patience, names)
        elif known is None:
            part.positions[:] = points[rows]
    if known is None or searched:
        pose.found[garments.whole] = known = found
    return known


def _lead(pose: ColliderPose, garments: PackedGarments, planes: ContactPlanes) -> None:
    """Bound the first search at a pose: by where the points of `planes`, those of a pose before it, go."""
    if _compiled(pose) and garments.whole not in pose.found:
        points = as_float64(planes.transported(pose))
        pose.found[garments.whole] = Found.nothing(len(points), points)


def no_planes(x: Tensor) -> ContactPlanes:
    """Planes that nothing touches, for each of the vertices `x` (vertices, 3) [m].

    Args:
        x: (vertices, 3) [m].
    """
    normals = torch.zeros_like(x, requires_grad=False)
    return ContactPlanes(
        points=x.detach().clone(),
        normals=normals,
        distance=torch.full_like(x[:, 0], torch.inf, requires_grad=False),
        touchable=torch.zeros(len(x), dtype=torch.bool, device=x.device),
        triangle=torch.zeros(len(x), dtype=torch.int64, device=x.device),
        barycentric=torch.zeros_like(x, requires_grad=False),
    )
