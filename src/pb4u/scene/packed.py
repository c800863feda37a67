"""Garments and the bodies they touch in one set of arrays: what physics and networks compute on.

A *world* is what can touch: some garments and some bodies. Rows know their garment (a piece of clothing with its
material) and their world; worlds of different size, resolution and material batch together without touching.
`PackedGarments` and `PackedColliders` never change; a `ColliderPose` holds the positions of the bodies at one instant.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.batched_surface import BatchedSurface, Groups, PosedBatch
from pb4u.collision.nearest_points import Found
from pb4u.collision.nearest_surface import PosedSurface, TriangleSurface
from pb4u.collision.rooms import Rooms
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.collision.wide_tree import WideTree
from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.geometry.triangle_mesh import laid_flat
from pb4u.scene.scene import STANDARD_GRAVITY
from pb4u.threads import sent

Formed = TypeVar("Formed")


@dataclass(frozen=True, eq=False)
class PackedGarments:
    """Static quantities of garments, concatenated. `dtype` is that of the floating arrays.

    Args:
        rest_positions: (vertices, 3) [m].
        faces: (faces, 3) int64 into the packed vertices.
        inverse_rest_shape: (faces, 2, 2) [1/m] inverse of the rest triangle's edge matrix in its own plane.
        face_areas: (faces,) rest areas [m^2].
        lame_mu: (faces,) [Pa].
        lame_lambda: (faces,) [Pa].
        thickness: (faces,) [m].
        edges: (edges, 2) int64.
        edge_lengths: (edges,) rest lengths [m].
        hinges: (hinges, 4) int64 edge v0 v1, opposite v2, opposite v3.
        hinge_areas: (hinges,) both rest areas summed [m^2].
        bending: (hinges,) coefficient [J].
        vertex_masses: (vertices,) [kg].
        vertex_areas: (vertices,) [m^2].
        pinned: (vertices,) bool.
        vertex_garment: (vertices,) int64 garment of each row, ascending.
        face_garment: (faces,) int64, likewise.
        hinge_garment: (hinges,) int64, likewise.
        edge_garment: (edges,) int64, likewise.
        vertex_offsets: first packed vertex of each garment, and the total.
        mean_edge_lengths: mean rest edge length of each garment [m].
        garments: the garments packed.
        worlds: world of each garment, ascending from 0.
    """

    rest_positions: Tensor
    faces: Tensor
    inverse_rest_shape: Tensor
    face_areas: Tensor
    lame_mu: Tensor
    lame_lambda: Tensor
    thickness: Tensor
    edges: Tensor
    edge_lengths: Tensor
    hinges: Tensor
    hinge_areas: Tensor
    bending: Tensor
    vertex_masses: Tensor
    vertex_areas: Tensor
    pinned: Tensor
    vertex_garment: Tensor
    face_garment: Tensor
    hinge_garment: Tensor
    edge_garment: Tensor
    vertex_offsets: tuple[int, ...]
    mean_edge_lengths: tuple[float, ...]
    garments: tuple[Garment, ...]
    worlds: tuple[int, ...]

    @property
    def world_count(self) -> int:
        """Number of worlds."""
        return self.worlds[-1] + 1 if self.worlds else 0

    @cached_property
    def garment_world(self) -> Tensor:
        """World of each garment, (garments,) int64 index."""
        return sent(torch.tensor(self.worlds, dtype=torch.int64), self.device)

    @cached_property
    def vertex_world(self) -> Tensor:
        """World of each vertex, (vertices,) int64 index."""
        return self.garment_world[self.vertex_garment]

    @cached_property
    def garment_masses(self) -> Tensor:
        """Mass (garments,) [kg] of each garment."""
        return self.vertex_masses.new_zeros(self.garment_count).index_add_(0, self.vertex_garment, self.vertex_masses)

    @cached_property
    def garment_vertices(self) -> Tensor:
        """Number of vertices of each garment, (garments,) int64."""
        return sent(torch.as_tensor(np.diff(self.vertex_offsets)), self.device)

    @cached_property
    def world_rows(self) -> tuple[Tensor, Tensor, Tensor]:
        """Rows of all worlds side by side, those of shorter ones filled up with their last.

        Vertex (worlds, rows) int64 of each row, whether it is no repetition (worlds, rows) bool, and the row
        (vertices,) int64 of each vertex among all of them one after the other.
        """
        offsets = sent(torch.as_tensor(self.world_offsets), self.device)
        rows = torch.arange(int(max(np.diff(self.world_offsets), default=0)), device=self.device)
        filled = rows < offsets.diff()[:, None]
        places = offsets[:-1, None] + torch.minimum(rows, offsets.diff()[:, None] - 1)
        own = torch.arange(self.vertex_count, device=self.device) - offsets[self.vertex_world]
        return places, filled, self.vertex_world * len(rows) + own

    @cached_property
    def world_weights(self) -> Tensor:
        """Weight (worlds,) [N] of the garments of each world: energy over it is the height that lifts them."""
        return STANDARD_GRAVITY * self.by_world(self.garment_masses)

    @cached_property
    def vertex_edge_lengths(self) -> Tensor:
        """Mean rest edge length (vertices,) float64 [m] of the garment that each vertex is of."""
        lengths = torch.tensor(self.mean_edge_lengths, dtype=torch.float64, device=self.vertex_garment.device)
        return lengths[self.vertex_garment]

    @cached_property
    def world_offsets(self) -> tuple[int, ...]:
        """First packed vertex of each world, and the total."""
        firsts = [self.vertex_offsets[self.worlds.index(world)] for world in range(self.world_count)]
        return (*firsts, self.vertex_count)

    @cached_property
    def surface_tree(self) -> SurfaceTree:
        """Search for elements of the garments that come near each other."""
        return self._tree(self.worlds)

    @cached_property
    def surface_tree_of_each(self) -> SurfaceTree:
        """The same where a garment comes near itself alone."""
        alone = tuple(range(self.garment_count))
        return self.surface_tree if alone == self.worlds else self._tree(alone)

    def _tree(self, worlds: tuple[int, ...]) -> SurfaceTree:
        rest, faces, edges, part = (
            values.cpu().numpy() for values in (self.rest_positions, self.faces, self.edges, self.vertex_garment)
        )
        return SurfaceTree(rest, faces, edges, part, worlds)

    @cached_property
    def surfaces(self) -> tuple[TriangleSurface, ...]:
        """The searchable surface of each world's garments; its vertices are counted from the first of the world."""
        faces, world = self.faces.cpu().numpy(), self.garment_world[self.face_garment].cpu().numpy()
        spans = pairwise(self.world_offsets)
        return tuple(TriangleSurface(faces[world == k] - a, b - a) for k, (a, b) in enumerate(spans))

    def by_world(self, values: Tensor) -> Tensor:
        """Sums (worlds,) of `values` over the garments of each world, in their unit.

        Args:
            values: (garments,) of any unit, such as [J].
        """
        if self.world_count == self.garment_count:
            return values
        return values.new_zeros(self.world_count).index_add(0, self.garment_world, values)

    def to(self, device: torch.device, dtype: torch.dtype | None = None) -> PackedGarments:
        """Copy with its arrays on `device`, the floating ones in `dtype` where given.

        Args:
            device: where the arrays go.
            dtype: of floating arrays; None keeps theirs.
        """
        own = {name: value for name, value in vars(self).items() if name in {entry.name for entry in fields(self)}}
        return PackedGarments(
            **{
                name: _moved(value, device, dtype) if isinstance(value, Tensor) else value
                for name, value in own.items()
            }
        )

    @property
    def garment_count(self) -> int:
        """Number of garments."""
        return len(self.garments)

    @property
    def vertex_count(self) -> int:
        """Number of vertices of all garments."""
        return self.vertex_offsets[-1]

    @property
    def dtype(self) -> torch.dtype:
        """Data type of the floating arrays."""
        return self.rest_positions.dtype

    @property
    def device(self) -> torch.device:
        """Device of the arrays."""
        return self.rest_positions.device


@dataclass(frozen=True, eq=False)
class PackedColliders:
    """Static quantities of the bodies of a pack, concatenated.

    Args:
        faces: (faces, 3) int64 into the packed vertices.
        contact: (vertices,) bool, False where contact is not answered.
        vertex_world: (vertices,) int64 world of each vertex, ascending.
        ground_height: height of the ground plane [m], or None.
        surfaces: the searchable surface of each world's bodies, regions left out of contact cut away and the holes
            closed: cloth that a hand went through would come into the forearm by its open end. None for a world without
            a body that may be touched.
        rooms: fixed numbers of what searches find, for devices on which shapes may not wait for data; None for none.
    """

    faces: Tensor
    contact: Tensor
    vertex_world: Tensor
    ground_height: float | None
    surfaces: tuple[TriangleSurface | None, ...]
    rooms: Rooms | None = None

    def surface_groups(self, worlds: int, positions: Tensor) -> BatchedSurface | None:
        """The surfaces of all worlds for searches in tensors; None where there is none.

        Args:
            worlds: number of worlds, those after the last with a body included.
            positions: (vertices, 3) [m] of the pose that forms groups, where they are not formed yet.
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
            positions: (vertices, 3) [m] of the pose that forms groups, where they are not formed yet.
        """
        if not all(len(rows) for rows in self.touchable):
            return None

        def of() -> Groups:
            places = positions.detach().cpu().numpy()
            rows = [own.cpu().numpy() for own in self.touchable]
            return Groups.of([own[WideTree.over(places[own]).order] for own in rows], positions.device)

        return self._formed("vertex_groups", of)

    def _formed(self, name: str, form: Callable[[], Formed]) -> Formed:
        kept: dict[str, Formed] = self._kept
        if name not in kept:
            kept[name] = form()
        return kept[name]

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
    def world_contact_faces(self) -> tuple[Tensor, ...]:
        """Indices (faces,) int64 into `contact_faces` of what the surface of each world calls its faces."""
        made, stop = [], len(self.faces)
        for world, own in enumerate(self.world_faces):
            start, stop = stop, stop + len(self._caps(world))
            made.append(torch.cat([own, torch.arange(start, stop, device=own.device)]))
        return tuple(made)

    @cached_property
    def searched_faces(self) -> tuple[np.ndarray, ...]:
        """The same of the faces that the surface of each world searches, in its order; none without a surface."""
        return tuple(
            names.cpu().numpy()[:0] if surface is None else names.cpu().numpy()[surface.names]
            for names, surface in zip(self.world_contact_faces, self.surfaces, strict=True)
        )

    def _caps(self, world: int) -> Tensor:
        surface = self.surfaces[world]
        return self.faces[:0] if surface is None else torch.from_numpy(surface.caps).to(self.faces.device)

    @cached_property
    def touchable(self) -> tuple[Tensor, ...]:
        """Indices (vertices,) int64 of the packed vertices of each world that may be touched."""
        return tuple(
            torch.nonzero((self.vertex_world == world) & self.contact)[:, 0] for world in range(len(self.surfaces))
        )

    def pose(self, positions: Tensor) -> ColliderPose:
        """Pose of the bodies with their vertices at `positions` (vertices, 3) [m].

        Args:
            positions: (vertices, 3) [m] of all bodies.
        """
        return ColliderPose(self, positions)

    def to(self, device: torch.device, rooms: Rooms | None = None) -> PackedColliders:
        """Copy with its arrays on `device`, and what is known of them.

        Args:
            device: of the copy.
            rooms: of the copy.
        """
        moved = replace(
            self,
            faces=self.faces.to(device),
            contact=self.contact.to(device),
            vertex_world=self.vertex_world.to(device),
            rooms=rooms,
        )
        vars(moved)["world_vertices"] = self.world_vertices
        vars(moved)["searched_faces"] = self.searched_faces
        for name in ("world_faces", "contact_faces", "touchable"):
            vars(moved)[name] = _moved(getattr(self, name), device)
        vars(moved)["_kept"] = {name: _moved(value, device) for name, value in self._kept.items()}
        return moved


class ColliderPose:
    """The bodies of a pack at one instant; their search trees are built on first use, and kept with it.

    Args:
        colliders: static quantities of the bodies.
        positions: (vertices, 3) [m].

    Attributes:
        found: what was last queried here for the vertices of a pack of garments, which may serve again.
        passed: through what of a pack of garments the bodies were found to be, and at which positions of these.
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

    def batch(self, worlds: int) -> PosedBatch | None:
        """The surfaces of so many worlds for searches in tensors; None where there is none.

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
        """This pose for another thread: it shares what is built, and keeps to itself what is queried there."""
        other = copy.copy(self)
        other.found, other.passed = dict(self.found), dict(self.passed)
        return other

    def _posed(self, surfaces: tuple[TriangleSurface | None, ...]) -> tuple[PosedSurface | None, ...]:
        rows = self.colliders.world_vertices
        return tuple(
            None if surface is None else surface.at(self.positions[own])
            for surface, own in zip(surfaces, rows, strict=True)
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
    def ground_height(self) -> float | None:
        """Height of the ground plane [m], or None."""
        return self.colliders.ground_height

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


def _moved(value: Any, device: torch.device, dtype: torch.dtype | None = None) -> Any:
    """`value` on `device`: a tensor, floating ones in `dtype` where given, a tuple or a record of them."""
    if isinstance(value, tuple):
        return tuple(_moved(part, device) for part in value)
    if isinstance(value, (BatchedSurface, Groups)):
        return replace(value, **{entry.name: _moved(getattr(value, entry.name), device) for entry in fields(value)})
    if not isinstance(value, Tensor):
        return value
    return value.to(device, dtype if value.is_floating_point() else None)


def pack_colliders(
    faces: Sequence[Tensor],
    contact: Sequence[Tensor],
    worlds: Sequence[int],
    ground_height: float | None = 0.0,
    surfaces: Sequence[TriangleSurface | None] | None = None,
    rooms: Rooms | None = None,
) -> PackedColliders:
    """Concatenate bodies.

    Args:
        faces: (faces, 3) int64 vertex indices of each body, on one device.
        contact: (vertices,) bool flags of each body, False where contact is not answered.
        worlds: world of each body, ascending.
        ground_height: height of the ground plane [m], or None.
        surfaces: the searchable surface of each world's bodies, where they are already made.
        rooms: fixed numbers of what searches find, or None.
    """
    offsets = np.concatenate([[0], np.cumsum([len(part) for part in contact])]).tolist()
    all_faces = torch.cat([part + offset for part, offset in zip(faces, offsets, strict=False)])
    all_contact = torch.cat(list(contact))
    counts = torch.tensor([len(part) for part in contact], device=all_contact.device)
    owner = torch.tensor(list(worlds), device=all_contact.device).repeat_interleave(counts)
    if surfaces is None:
        surfaces = _surfaces(all_faces, all_contact, owner, max(worlds) + 1)
    return PackedColliders(all_faces, all_contact, owner, ground_height, tuple(surfaces), rooms)


def _surfaces(
    faces: Tensor, contact: Tensor | None, vertex_world: Tensor, worlds: int
) -> tuple[TriangleSurface | None, ...]:
    """Each world's searchable surface, cut to `contact` (vertices,) where given."""
    all_faces, owner = faces.cpu().numpy(), vertex_world.cpu().numpy()
    made: list[TriangleSurface | None] = []
    for world in range(worlds):
        vertices = np.flatnonzero(owner == world)
        region = np.ones(len(vertices), dtype=bool) if contact is None else contact.cpu().numpy()[vertices]
        if not region.any():
            made.append(None)
            continue
        own = all_faces[owner[all_faces[:, 0]] == world] - vertices[0]
        made.append(TriangleSurface(own, len(vertices), region, capped=True))
    return tuple(made)


def inverse_rest_shapes(corners: np.ndarray) -> np.ndarray:
    """Inverses (faces, 2, 2) [1/m] of [x1 x2; 0 y2], the rest triangle's edges from corner 0 in its own plane.

    Args:
        corners: (faces, 3, 3) of the triangles at rest [m].

    Raises:
        InputError: triangles are degenerate; they are named.
    """
    flat = laid_flat(corners)
    x1, x2, y2 = flat[:, 1, 0], flat[:, 2, 0], flat[:, 2, 1]
    longest = np.maximum(x1, np.linalg.norm(corners[:, 2] - corners[:, 0], axis=1))
    bad = np.flatnonzero(~(x1 > 0) | ~(y2 > 1e-6 * longest))
    if len(bad):
        raise InputError(
            f"{len(bad)} rest triangle(s) have no area, first faces {bad[:5].tolist()}; "
            "mend them with `pb4u check GARMENT.obj --fix OUT.obj`."
        )
    inverse = np.zeros((len(corners), 2, 2))
    inverse[:, 0, 0] = 1.0 / x1
    inverse[:, 0, 1] = -x2 / (x1 * y2)
    inverse[:, 1, 1] = 1.0 / y2
    return inverse


def pack(
    garments: Sequence[Garment],
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
    worlds: Sequence[int] | None = None,
) -> PackedGarments:
    """Concatenate garments.

    Args:
        garments: to pack, those of a world one after the other.
        dtype: data type of floating arrays.
        device: device of the arrays.
        worlds: world of each garment, ascending from 0; each alone in its own by default.

    Raises:
        InputError: a rest triangle is degenerate.
    """
    offsets = np.concatenate([[0], np.cumsum([len(g.vertices) for g in garments])]).astype(int)

    def real(parts: Sequence[np.ndarray]) -> Tensor:
        return torch.as_tensor(np.concatenate(parts), dtype=dtype, device=device)

    def index(parts: Sequence[np.ndarray]) -> Tensor:
        shifted = [np.asarray(p) + o for p, o in zip(parts, offsets[:-1], strict=True)]
        return torch.as_tensor(np.concatenate(shifted), dtype=torch.int64, device=device)

    def owner(counts: Sequence[int]) -> Tensor:
        return torch.as_tensor(np.repeat(np.arange(len(garments)), counts), dtype=torch.int64, device=device)

    def per_face(name: str) -> Tensor:
        return real([np.full(len(g.faces), getattr(g.material, name)) for g in garments])

    return PackedGarments(
        rest_positions=real([g.vertices for g in garments]),
        faces=index([g.faces for g in garments]),
        inverse_rest_shape=real([inverse_rest_shapes(g.rest_corners) for g in garments]),
        face_areas=real([g.face_areas for g in garments]),
        lame_mu=per_face("lame_mu"),
        lame_lambda=per_face("lame_lambda"),
        thickness=per_face("thickness"),
        edges=index([g.topology.edges for g in garments]),
        edge_lengths=real([g.edge_lengths for g in garments]),
        hinges=index([g.topology.hinges for g in garments]),
        hinge_areas=real([g.face_areas[g.topology.hinge_faces].sum(axis=1) for g in garments]),
        bending=real([np.full(len(g.topology.hinges), g.material.bending) for g in garments]),
        vertex_masses=real([g.vertex_masses for g in garments]),
        vertex_areas=real([g.vertex_areas for g in garments]),
        pinned=torch.as_tensor(np.concatenate([g.pinned for g in garments]), device=device),
        vertex_garment=owner([len(g.vertices) for g in garments]),
        face_garment=owner([len(g.faces) for g in garments]),
        hinge_garment=owner([len(g.topology.hinges) for g in garments]),
        edge_garment=owner([len(g.topology.edges) for g in garments]),
        vertex_offsets=tuple(offsets.tolist()),
        mean_edge_lengths=tuple(g.mean_edge_length for g in garments),
        garments=tuple(garments),
        worlds=tuple(range(len(garments)) if worlds is None else worlds),
    )
