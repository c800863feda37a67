"""The bodies of worlds in one set of arrays, and where they are around a step.

`PackedColliders` never change; a `ColliderPose` holds the positions of the bodies at one instant, with what is queried
there.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.batched_surface import BatchedSurface, Groups, PosedBatch
from pb4u.collision.capacities import Capacities
from pb4u.collision.jit import as_float64
from pb4u.collision.nearest_points import Found
from pb4u.collision.nearest_surface import PosedSurface, TriangleSurface
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.collision.wide_tree import WideTree
from pb4u.geometry.topology import offsets

if TYPE_CHECKING:
    from pb4u.scene.packed import PackedGarments

Formed = TypeVar("Formed")


@dataclass(frozen=True, eq=False)
class PackedColliders:
    """Static quantities of the bodies of a pack, concatenated.

    Args:
        faces: (faces, 3) int64 into the packed vertices.
        contact: (vertices,) bool, False where contact is not answered.
        vertex_world: (vertices,) int64 world of each vertex, ascending.
        surfaces: the searchable surface of each world's bodies, regions left out of contact cut away and the holes
            closed: otherwise cloth crossed by a hand would enter the forearm through its open end. None for a world
            without a body that may be touched.
        capacities: fixed numbers of what searches find, where shapes may not wait for data; None elsewhere.
    """

    faces: Tensor
    contact: Tensor
    vertex_world: Tensor
    surfaces: tuple[TriangleSurface | None, ...]
    capacities: Capacities | None = None

    def surface_groups(self, worlds: int, positions: Tensor) -> BatchedSurface | None:
        """The surfaces of all worlds for searches in tensors; None where there is none.

        Args:
            worlds: number of worlds, including worlds without a body at the end.
            positions: (vertices, 3) [m] of the pose from which to form groups if there are none yet.
        """
        return self._formed(
            "surface_groups",
            lambda: BatchedSurface.of(
                (*self.surfaces, *[None] * (worlds - len(self.surfaces))),
                [rows.start for rows in self.world_vertices],
                self.searched_faces,
                positions,
            ),
        )

    def vertex_groups(self, positions: Tensor) -> Groups | None:
        """Vertices of each world that may be touched, in groups; None where a world has none.

        Args:
            positions: (vertices, 3) [m] of the pose from which to form groups if there are none yet.
        """
        if not all(len(rows) for rows in self.touchable):
            return None

        def of() -> Groups:
            places = positions.detach().cpu().numpy()
            rows = [vertices.cpu().numpy() for vertices in self.touchable]
            return Groups.of([vertices[WideTree.over(places[vertices]).order] for vertices in rows], positions.device)

        return self._formed("vertex_groups", of)

    def _formed(self, name: str, form: Callable[[], Formed]) -> Formed:
        cache: dict[str, Formed] = self._kept
        if name not in cache:
            cache[name] = form()
        return cache[name]

    @cached_property
    def _kept(self) -> dict[str, Any]:
        return {}

    @cached_property
    def whole_surfaces(self) -> tuple[TriangleSurface | None, ...]:
        """Searchable surface of each world's bodies, regions left out of contact included."""
        return _surfaces(self.faces, None, self.vertex_world, len(self.surfaces))

    @cached_property
    def world_vertices(self) -> tuple[slice, ...]:
        """Rows of the packed vertices of each world."""
        counts = torch.bincount(self.vertex_world, minlength=len(self.surfaces)).tolist()
        stops = np.cumsum(counts).tolist()
        return tuple(slice(stop - count, stop) for count, stop in zip(counts, stops, strict=True))

    @cached_property
    def world_faces(self) -> tuple[Tensor, ...]:
        """Indices (faces,) int64 of the packed faces of each world."""
        face_world = self.vertex_world[self.faces[:, 0]] if len(self.faces) else self.vertex_world[:0]
        return tuple(torch.nonzero(face_world == world)[:, 0] for world in range(len(self.surfaces)))

    @cached_property
    def contact_faces(self) -> Tensor:
        """Faces (faces, 3) int64 that contact is answered on: all packed faces, then the caps of each world."""
        caps = [self._caps(world) + rows.start for world, rows in enumerate(self.world_vertices)]
        return torch.cat([self.faces, *caps])

    @cached_property
    def searched_faces(self) -> tuple[np.ndarray, ...]:
        """Indices (faces,) int64 into `contact_faces` of what each world's surface searches, in its order."""
        searched, stop = [], len(self.faces)
        for world, (faces, surface) in enumerate(zip(self.world_faces, self.surfaces, strict=True)):
            start, stop = stop, stop + len(self._caps(world))
            called = np.concatenate([faces.cpu().numpy(), np.arange(start, stop)])
            searched.append(called[:0] if surface is None else called[surface.names])
        return tuple(searched)

    def _caps(self, world: int) -> Tensor:
        surface = self.surfaces[world]
        return self.faces[:0] if surface is None else torch.from_numpy(surface.caps).to(self.faces.device)

    @cached_property
    def touchable(self) -> tuple[Tensor, ...]:
        """Indices (vertices,) int64 of the packed vertices of each world that may be touched."""
        return tuple(
            torch.nonzero((self.vertex_world == world) & self.contact)[:, 0] for world in range(len(self.surfaces))
        )

    @cached_property
    def touched(self) -> tuple[np.ndarray, np.ndarray]:
        """Packed vertices (vertices,) int64 that searches find, and faces (faces, 3) int64 among them."""
        faces = self.contact_faces.cpu().numpy()[np.concatenate(self.searched_faces)]
        vertices, faces = np.unique(faces, return_inverse=True)
        return vertices, faces.reshape(-1, 3)

    @cached_property
    def trees(self) -> WeakKeyDictionary[PackedGarments, tuple[SurfaceTree, np.ndarray]]:
        """Searches among garments and these bodies, with areas (body vertices,) [m^2], by pack of garments."""
        return WeakKeyDictionary()

    def pose(self, positions: Tensor) -> ColliderPose:
        """Pose of the bodies with their vertices at `positions` (vertices, 3) [m].

        Args:
            positions: (vertices, 3) [m] of all bodies.
        """
        return ColliderPose(self, positions)

    def to(self, device: torch.device, capacities: Capacities | None = None) -> PackedColliders:
        """Copy with its arrays and derived data on `device`.

        Args:
            device: of the copy.
            capacities: of the copy.
        """
        pack = replace(
            self,
            faces=self.faces.to(device),
            contact=self.contact.to(device),
            vertex_world=self.vertex_world.to(device),
            capacities=capacities,
        )
        vars(pack)["world_vertices"] = self.world_vertices
        vars(pack)["searched_faces"] = self.searched_faces
        for name in ("world_faces", "contact_faces", "touchable"):
            vars(pack)[name] = _moved(getattr(self, name), device)
        vars(pack)["_kept"] = {name: _moved(value, device) for name, value in self._kept.items()}
        return pack


class ColliderPose:
    """The bodies of a pack at one instant; their search trees are built on first use, and cached.

    Args:
        colliders: static quantities of the bodies.
        positions: (vertices, 3) [m].

    Attributes:
        found: results of the last query for the vertices of a pack of garments, for reuse.
        passed: vertices of a pack of garments through which the bodies have passed, and the positions for which this
            was found.
    """

    def __init__(self, colliders: PackedColliders, positions: Tensor) -> None:
        self.colliders, self.positions = colliders, positions
        self.found: dict[PackedGarments, Found] = {}
        self.passed: dict[PackedGarments, tuple[Tensor, np.ndarray]] = {}
        self._batch: PosedBatch | None = None

    @cached_property
    def surfaces(self) -> tuple[PosedSurface | None, ...]:
        """Surface of each world's bodies, regions left out of contact cut away; None for a world without any."""
        return self._posed(self.colliders.surfaces)

    @cached_property
    def touched(self) -> np.ndarray:
        """Positions (vertices, 3) float64 [m] of the vertices that searches find."""
        return as_float64(self.positions)[self.colliders.touched[0]]

    def batch(self, worlds: int) -> PosedBatch | None:
        """The surfaces of the bodies of this many worlds, as tensors, to search for nearest points; None without any.

        Args:
            worlds: number of worlds.
        """
        if self._batch is None:
            groups = self.colliders.surface_groups(worlds, self.positions)
            self._batch = None if groups is None else PosedBatch(groups, self.positions.to(torch.float64))
        return self._batch

    def middles(self, worlds: int, dtype: torch.dtype) -> Tensor:
        """Mean vertex (worlds, 3) [m] of the bodies of each of so many worlds; 0 for a world without."""
        positions, owner = self.positions.to(dtype), self.colliders.vertex_world
        counts = positions.new_zeros(worlds).index_add(0, owner, torch.ones_like(positions[:, 0])).clamp_min(1.0)
        return positions.new_zeros((worlds, 3)).index_add(0, owner, positions) / counts[:, None]

    @cached_property
    def whole_surfaces(self) -> tuple[PosedSurface | None, ...]:
        """Surface of each world's bodies, regions left out of contact included; None for a world without any."""
        return self._posed(self.colliders.whole_surfaces)

    def apart(self) -> ColliderPose:
        """This pose for another thread: it shares built trees, but has its own query results."""
        other = copy.copy(self)
        other.found, other.passed = dict(self.found), dict(self.passed)
        return other

    def _posed(self, surfaces: tuple[TriangleSurface | None, ...]) -> tuple[PosedSurface | None, ...]:
        rows = self.colliders.world_vertices
        return tuple(
            None if surface is None else surface.at(self.positions[vertices])
            for surface, vertices in zip(surfaces, rows, strict=True)
        )


@dataclass(frozen=True, eq=False)
class ColliderFrame:
    """Poses of the bodies of a pack around one step.

    Args:
        previous: pose at frame t-1.
        now: pose at frame t.
        following: pose at frame t+1.
    """

    previous: ColliderPose
    now: ColliderPose
    following: ColliderPose

    @property
    def colliders(self) -> PackedColliders:
        """Static quantities of the bodies."""
        return self.now.colliders

    @property
    def empty(self) -> bool:
        """Whether there is no body at all."""
        return not len(self.colliders.faces)

    @cached_property
    def motion(self) -> Tensor:
        """Displacements (vertices, 3) [m] of the bodies over the step."""
        return self.following.positions - self.now.positions

    def between(self, start: float, end: float) -> ColliderFrame:
        """Poses around a part of the step, the bodies moving along straight lines.

        Args:
            start: fraction of the step at which the part begins.
            end: fraction at which it ends.
        """
        now = torch.lerp(self.now.positions, self.following.positions, start)
        following = torch.lerp(self.now.positions, self.following.positions, end)
        return ColliderFrame(*(self.colliders.pose(p) for p in (2.0 * now - following, now, following)))


def _moved(value: Any, device: torch.device) -> Any:
    """`value` on `device`: a tensor, a tuple or a record of them."""
    if isinstance(value, tuple):
        return tuple(_moved(part, device) for part in value)
    if isinstance(value, (BatchedSurface, Groups)):
        return replace(value, **{entry.name: _moved(getattr(value, entry.name), device) for entry in fields(value)})
    return value.to(device) if isinstance(value, Tensor) else value


def pack_colliders(
    faces: Sequence[Tensor],
    contact: Sequence[Tensor],
    worlds: Sequence[int],
    surfaces: Sequence[TriangleSurface | None] | None = None,
) -> PackedColliders:
    """Concatenate bodies; none where the lists are empty.

    Args:
        faces: (faces, 3) int64 vertex indices of each body, on one device.
        contact: (vertices,) bool flags of each body, False where contact is not answered.
        worlds: world of each body, ascending.
        surfaces: the searchable surface of each world's bodies, if already built.
    """
    if not faces:
        faces, contact, worlds = [torch.zeros((0, 3), dtype=torch.int64)], [torch.zeros(0, dtype=torch.bool)], [0]
    all_faces = torch.cat([part + start for part, start in zip(faces, offsets(contact), strict=False)])
    all_contact = torch.cat(list(contact))
    counts = torch.tensor([len(part) for part in contact], device=all_contact.device)
    owner = torch.tensor(list(worlds), device=all_contact.device).repeat_interleave(counts)
    if surfaces is None:
        surfaces = _surfaces(all_faces, all_contact, owner, max(worlds) + 1)
    return PackedColliders(all_faces, all_contact, owner, tuple(surfaces))


def _surfaces(
    faces: Tensor, contact: Tensor | None, vertex_world: Tensor, worlds: int
) -> tuple[TriangleSurface | None, ...]:
    """Each world's searchable surface, cut to `contact` (vertices,) where given."""
    all_faces, owner = faces.cpu().numpy(), vertex_world.cpu().numpy()
    surfaces: list[TriangleSurface | None] = []
    for world in range(worlds):
        vertices = np.flatnonzero(owner == world)
        region = np.ones(len(vertices), dtype=bool) if contact is None else contact.cpu().numpy()[vertices]
        if not region.any():
            surfaces.append(None)
            continue
        local_faces = all_faces[owner[all_faces[:, 0]] == world] - vertices[0]
        surfaces.append(TriangleSurface(local_faces, len(vertices), region, capped=True))
    return tuple(surfaces)
