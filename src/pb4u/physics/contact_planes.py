"""Which point of the body each garment vertex is closest to, as planes that energies and contact response share."""

from __future__ import annotations

import atexit
import hashlib
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.geometry.nearest_surface import PosedSurface, TriangleSurface
from pb4u.scene.packed import ColliderFrame, PackedGarments

_POSES_KEPT = 3
_SURFACES_KEPT = 16
_BODIES_KEPT = 8


@dataclass(frozen=True, eq=False)
class ContactPlanes:
    """The body near each vertex, linearised: the signed distance and its gradient are exact where it was found.

    Args:
        points: (vertices, 3) nearest points of the body [m].
        normals: (vertices, 3) outward unit normals.
        distance: (vertices,) distance at which the correspondence was found [m], signed for exact planes.
        touchable: (vertices,) bool, False where the vertex has no body or is nearest to a region left out of contact.
        triangle: (vertices,) int64 face of the packed colliders.
        barycentric: (vertices, 3) of the point in that face.
    """

    points: Tensor
    normals: Tensor
    distance: Tensor
    touchable: Tensor
    triangle: Tensor
    barycentric: Tensor

    def signed_distance(self, x: Tensor) -> Tensor:
        """(vertices,) height [m] of `x` (vertices, 3) over its plane."""
        return ((x - self.points) * self.normals).sum(-1)

    def carried(self, collider_vertices: Tensor, faces: Tensor) -> Tensor:
        """(vertices, 3) where the nearest points are when the colliders' vertices are `collider_vertices` [m]."""
        corners = collider_vertices.to(self.barycentric.dtype)[faces[self.triangle]]
        return (self.barycentric[:, :, None] * corners).sum(1)

    def carried_normals(self, collider_vertices: Tensor, faces: Tensor) -> Tensor:
        """(vertices, 3) unit normals of the corresponding faces when the colliders are at `collider_vertices` [m]."""
        corners = collider_vertices.to(self.normals.dtype)[faces[self.triangle]]
        cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return cross / cross.norm(dim=1, keepdim=True).clamp_min(torch.finfo(cross.dtype).tiny)


class ColliderSurfaces:
    """The colliders of a pack as searchable surfaces; built once, posed each frame."""

    def __init__(self, garments: PackedGarments, collider: ColliderFrame, whole: bool = False) -> None:
        self._offsets, self.whole = garments.vertex_offsets, whole
        self._posed: list[tuple[Tensor, PosedColliders]] = []
        self._faces, self._contact, self._owner = collider.faces, collider.contact, collider.vertex_garment
        faces, owner = collider.faces.cpu().numpy(), collider.vertex_garment.cpu().numpy()
        contact = np.ones(len(owner), dtype=bool) if whole else collider.contact.cpu().numpy()
        face_owner = owner[faces[:, 0]]
        self.parts: list[tuple[TriangleSurface, slice, Tensor] | None] = []
        for g in range(garments.garment_count):
            vertices = np.flatnonzero(owner == g)
            if not len(vertices) or not contact[vertices].any():
                self.parts.append(None)
                continue
            first, stop = int(vertices[0]), int(vertices[-1]) + 1
            own_faces = np.flatnonzero(face_owner == g)
            surface = _triangle_surface(faces[own_faces] - first, contact[first:stop])
            self.parts.append((surface, slice(first, stop), torch.from_numpy(own_faces).to(collider.faces.device)))

    def fits(self, garments: PackedGarments, collider: ColliderFrame, whole: bool) -> bool:
        """Whether these surfaces are those of `collider`."""
        return (
            self._offsets == garments.vertex_offsets
            and self.whole == whole
            and _same(self._faces, collider.faces)
            and _same(self._contact, collider.contact)
            and _same(self._owner, collider.vertex_garment)
        )

    def at(self, vertices: Tensor) -> PosedColliders:
        """The surfaces with the packed collider `vertices` (vertices, 3) [m]; the last few poses are kept."""
        for known, posed in self._posed:
            if known.shape == vertices.shape and known.device == vertices.device and torch.equal(known, vertices):
                return posed
        surfaces = [None if p is None else p[0].at(vertices[p[1]]) for p in self.parts]
        posed = PosedColliders(surfaces, [None if p is None else p[2] for p in self.parts], self._offsets)
        self._posed = [(vertices, posed), *self._posed[: _POSES_KEPT - 1]]
        return posed


_triangle_surfaces: dict[bytes, TriangleSurface] = {}


def _triangle_surface(faces: np.ndarray, contact: np.ndarray) -> TriangleSurface:
    """The surface of one body; kept, because the same bodies return with other garments, batch after batch."""
    key = hashlib.blake2b(contact.tobytes() + np.ascontiguousarray(faces).tobytes()).digest()
    if key not in _triangle_surfaces:
        while len(_triangle_surfaces) >= _BODIES_KEPT:
            del _triangle_surfaces[next(iter(_triangle_surfaces))]
        _triangle_surfaces[key] = TriangleSurface(faces, len(contact), contact)
    return _triangle_surfaces[key]


_surfaces_kept: list[ColliderSurfaces] = []
# Search trees that outlive the interpreter's end make their library complain.
atexit.register(_surfaces_kept.clear)


def collider_surfaces(garments: PackedGarments, collider: ColliderFrame, whole: bool = False) -> ColliderSurfaces:
    """The searchable surfaces of `collider`, with regions left out of contact or `whole`; those last used are kept."""
    fitting = (known for known in _surfaces_kept if known.fits(garments, collider, whole))
    surfaces = next(fitting, None)
    if surfaces is None:
        surfaces = ColliderSurfaces(garments, collider, whole)
    else:
        _surfaces_kept.remove(surfaces)
    _surfaces_kept.insert(0, surfaces)
    del _surfaces_kept[_SURFACES_KEPT:]
    return surfaces


class PosedColliders:
    """The colliders of a pack at one instant."""

    def __init__(
        self, surfaces: list[PosedSurface | None], face_ids: list[Tensor | None], offsets: tuple[int, ...]
    ) -> None:
        self._surfaces, self._face_ids, self._offsets = surfaces, face_ids, offsets

    def nearest(self, x: Tensor, among: Tensor | None = None, otherwise: ContactPlanes | None = None) -> ContactPlanes:
        """Planes through the exact nearest points to `x` (vertices, 3) [m].

        Args:
            x: garment vertices.
            among: (vertices,) bool, the vertices to query; the rest keep the planes of `otherwise`.
            otherwise: planes found before.
        """
        planes = _blank(x) if otherwise is None else _copy(otherwise)
        for g, (surface, face_ids) in enumerate(zip(self._surfaces, self._face_ids, strict=True)):
            if surface is None or face_ids is None:
                continue
            rows = _rows(self._offsets, g, among, x.device)
            if not len(rows):
                continue
            found = surface.nearest(x[rows])
            planes.points[rows] = found.positions
            planes.normals[rows] = found.normals
            planes.distance[rows] = found.signed_distance
            planes.touchable[rows] = ~found.beyond_border
            planes.triangle[rows] = face_ids[found.triangle]
            planes.barycentric[rows] = found.barycentric
        return planes

    def clearance(self, points: Tensor, garment: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distance (points,) [m] and outward normal (points, 3) of points on given garments (points,).

        Where there is no body, or only a region left out of contact, the distance is infinite.
        """
        distance, normals = points.new_full((len(points),), torch.inf), torch.zeros_like(points)
        for g, surface in enumerate(self._surfaces):
            rows = torch.nonzero(garment == g)[:, 0]
            if surface is None or not len(rows):
                continue
            found = surface.nearest(points[rows])
            distance[rows] = torch.where(found.beyond_border, torch.inf, found.signed_distance)
            normals[rows] = found.normals
        return distance, normals

    def nearest_face_centres(self, x: Tensor) -> ContactPlanes:
        """Planes of the faces whose centres are nearest, with the distance to the centre: the family's convention."""
        planes = _blank(x)
        planes.barycentric.fill_(1.0 / 3.0)
        for g, (surface, face_ids) in enumerate(zip(self._surfaces, self._face_ids, strict=True)):
            if surface is None or face_ids is None:
                continue
            rows = _rows(self._offsets, g, None, x.device)
            face, distance = surface.nearest_face_centre(x[rows])
            corners = surface.vertices[torch.from_numpy(surface.surface.faces).to(surface.vertices.device)[face]]
            cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            planes.points[rows] = corners.mean(1).to(x)
            planes.normals[rows] = (cross / cross.norm(dim=1, keepdim=True).clamp_min(1e-300)).to(x)
            planes.distance[rows] = distance
            planes.touchable[rows] = True
            planes.triangle[rows] = face_ids[face]
        return planes


def _same(a: Tensor, b: Tensor) -> bool:
    return a is b or (a.shape == b.shape and a.device == b.device and torch.equal(a, b))


def _rows(offsets: tuple[int, ...], garment: int, among: Tensor | None, device: torch.device) -> Tensor:
    rows = torch.arange(offsets[garment], offsets[garment + 1], device=device)
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
