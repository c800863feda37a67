"""Garments in one set of arrays: what physics and networks compute on, beside the bodies of `scene.colliders`.

A *world* is what can touch: some garments and some bodies. Rows know their garment (a piece of clothing with its
material) and their world; worlds of different size, resolution and material batch together without touching.
`PackedGarments` never change.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.environment import STANDARD_GRAVITY
from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material, nearest_isotropic
from pb4u.geometry.topology import joined_indices, offsets
from pb4u.threads import to_device

_OF_FACES = ("faces", "inverse_rest_shape", "face_areas", "membrane", "stiffening", "damping", "face_garment")
_OF_HINGES = ("hinges", "hinge_areas", "hinge_damping", "bending", "hinge_garment")
_OF_EDGES = ("edges", "edge_lengths", "edge_garment")


@dataclass(frozen=True, eq=False)
class PackedGarments:
    """Static quantities of garments, concatenated. `dtype` is that of the floating arrays.

    Args:
        rest_positions: (vertices, 3) [m].
        faces: (faces, 3) int64 into the packed vertices.
        inverse_rest_shape: (faces, 2, 2) [1/m] inverse of the rest triangle's edge matrix, along the grain
            where the garment has one.
        face_areas: (faces,) rest areas [m^2].
        membrane: (faces, 4) moduli c11 (weft), c22 (warp), c12 and c33 [N/m] along the axes of the rest shape.
        stiffening: (faces, 2) stretch of a thread beyond which it stiffens [1], and the increase of its modulus for
            each unit of stretch [N/m].
        damping: (faces,) damping times [s].
        edges: (edges, 2) int64.
        edge_lengths: (edges,) rest lengths [m].
        hinges: (hinges, 4) int64 edge v0 v1, opposite v2, opposite v3.
        hinge_areas: (hinges,) both rest areas summed [m^2].
        hinge_damping: (hinges,) mean damping time of both faces [s].
        bending: (hinges,) coefficient [J].
        friction: (vertices,) coefficient of friction on skin and ground.
        vertex_masses: (vertices,) [kg].
        vertex_areas: (vertices,) [m^2].
        pinned: (vertices,) bool; False for pins on springs.
        pin_stiffness: (vertices,) [N/m] of the springs of pins on springs, 0 for other vertices.
        pinned_until: (vertices,) [s] time of their release.
        vertex_garment: (vertices,) int64 garment of each row, ascending.
        face_garment: (faces,) int64, likewise.
        hinge_garment: (hinges,) int64, likewise.
        edge_garment: (edges,) int64, likewise.
        vertex_offsets: first packed vertex of each garment, and the total.
        mean_edge_lengths: mean rest edge length of each garment [m].
        garments: the garments packed.
        worlds: world of each garment, ascending from 0.
        part_of: the garments that these are a part of, with the same vertices; None for whole garments.
    """

    rest_positions: Tensor
    faces: Tensor
    inverse_rest_shape: Tensor
    face_areas: Tensor
    membrane: Tensor
    stiffening: Tensor
    damping: Tensor
    edges: Tensor
    edge_lengths: Tensor
    hinges: Tensor
    hinge_areas: Tensor
    hinge_damping: Tensor
    bending: Tensor
    friction: Tensor
    vertex_masses: Tensor
    vertex_areas: Tensor
    pinned: Tensor
    pin_stiffness: Tensor
    pinned_until: Tensor
    vertex_garment: Tensor
    face_garment: Tensor
    hinge_garment: Tensor
    edge_garment: Tensor
    vertex_offsets: tuple[int, ...]
    mean_edge_lengths: tuple[float, ...]
    garments: tuple[Garment, ...]
    worlds: tuple[int, ...]
    part_of: PackedGarments | None = None

    @property
    def whole(self) -> PackedGarments:
        """The whole garments: by these is known what was found for their vertices."""
        return self if self.part_of is None else self.part_of

    def part(self, moving: Tensor) -> PackedGarments:
        """The elements that some vertices have a corner in; all other vertices are pinned.

        Args:
            moving: (vertices,) bool, vertices that go on to move.
        """
        faces, hinges, edges = (moving[corners].any(1) for corners in (self.faces, self.hinges, self.edges))
        rows = {
            **dict.fromkeys(_OF_FACES, faces),
            **dict.fromkeys(_OF_HINGES, hinges),
            **dict.fromkeys(_OF_EDGES, edges),
        }
        parts: dict[str, Any] = {name: getattr(self, name)[chosen] for name, chosen in rows.items()}
        return replace(self, **parts, pinned=self.pinned | ~moving, part_of=self.whole)

    @property
    def lame_mu(self) -> Tensor:
        """Second Lame parameter (faces,) [Pa] of the isotropic cloth that is nearest: what networks read.

        All cloth that networks are trained on has the same thickness, by which stiffness per length is divided here.
        """
        return nearest_isotropic(*self.membrane.unbind(1))[0] / Material.thickness

    @property
    def lame_lambda(self) -> Tensor:
        """First Lame parameter (faces,) [Pa] of the isotropic cloth that is nearest: what networks read."""
        return nearest_isotropic(*self.membrane.unbind(1))[1].clamp_min(0.0) / Material.thickness

    @cached_property
    def stiffens(self) -> bool:
        """Whether some cloth stiffens under stretch; known without reading from the device."""
        return any(material.stiffening_stiffness > 0.0 for material in self._materials)

    @cached_property
    def damps(self) -> bool:
        """Whether some cloth resists a change of its shape; known without asking the device."""
        return any(material.damping_time > 0.0 for material in self._materials)

    @property
    def _materials(self) -> Iterator[Material]:
        return (material for garment in self.garments for material in garment.materials or (garment.material,))

    @property
    def world_count(self) -> int:
        """Number of worlds."""
        return self.worlds[-1] + 1 if self.worlds else 0

    @cached_property
    def garment_world(self) -> Tensor:
        """World of each garment, (garments,) int64 index."""
        return to_device(torch.tensor(self.worlds, dtype=torch.int64), self.device)

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
        return to_device(torch.as_tensor(np.diff(self.vertex_offsets)), self.device)

    @cached_property
    def world_rows(self) -> tuple[Tensor, Tensor, Tensor]:
        """Rows of all worlds side by side; shorter worlds are padded with their last row.

        Vertex (worlds, rows) int64 of each row, whether it is not a repetition (worlds, rows) bool, and the row
        (vertices,) int64 of each vertex in the concatenated rows.
        """
        offsets = to_device(torch.as_tensor(self.world_offsets), self.device)
        rows = torch.arange(int(max(np.diff(self.world_offsets), default=0)), device=self.device)
        filled = rows < offsets.diff()[:, None]
        places = offsets[:-1, None] + torch.minimum(rows, offsets.diff()[:, None] - 1)
        row = torch.arange(self.vertex_count, device=self.device) - offsets[self.vertex_world]
        return places, filled, self.vertex_world * len(rows) + row

    @cached_property
    def world_weights(self) -> Tensor:
        """Weight (worlds,) [N] of the garments of each world: energy over it is the height that lifts them."""
        return STANDARD_GRAVITY * self.by_world(self.garment_masses)

    @cached_property
    def impulse_masses(self) -> np.ndarray:
        """Masses (vertices,) float64 [kg] of vertices for impulses; infinite for pinned ones."""
        return as_float64(torch.where(self.pinned, torch.inf, self.vertex_masses.clamp_min(1e-12)))

    @cached_property
    def vertex_edge_lengths(self) -> Tensor:
        """Mean rest edge length (vertices,) float64 [m] of the garment that each vertex is of."""
        lengths = torch.tensor(self.mean_edge_lengths, dtype=torch.float64, device=self.vertex_garment.device)
        return lengths[self.vertex_garment]

    @cached_property
    def world_offsets(self) -> tuple[int, ...]:
        """Number of the first vertex of each world in the pack, then the number of all vertices."""
        firsts = [self.vertex_offsets[self.worlds.index(world)] for world in range(self.world_count)]
        return (*firsts, self.vertex_count)

    @cached_property
    def world_vertices(self) -> tuple[slice, ...]:
        """Rows of the packed vertices of each world."""
        return tuple(slice(first, stop) for first, stop in pairwise(self.world_offsets))

    @cached_property
    def surface_tree(self) -> SurfaceTree:
        """Search for elements of the garments that come near each other, those that are no part of these as well."""
        return self._tree(self.worlds) if self.part_of is None else self.part_of.surface_tree

    @cached_property
    def surface_tree_of_each(self) -> SurfaceTree:
        """Search for elements that come near others of the same garment."""
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
        rows = enumerate(self.world_vertices)
        return tuple(TriangleSurface(faces[world == k] - span.start, span.stop - span.start) for k, span in rows)

    def by_world(self, values: Tensor) -> Tensor:
        """Sums (worlds,) of `values` over the garments of each world, in their unit.

        Args:
            values: (garments,) of any unit, such as [J].
        """
        if self.world_count == self.garment_count:
            return values
        return values.new_zeros(self.world_count).index_add(0, self.garment_world, values)

    def to(self, device: torch.device, dtype: torch.dtype | None = None) -> PackedGarments:
        """Copy with its arrays on `device`, floating-point ones in `dtype` if given.

        Args:
            device: where the arrays go.
            dtype: of floating-point arrays; None keeps theirs.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        tensors: dict[str, Any] = {
            name: value.to(device, dtype if value.is_floating_point() else None)
            for name, value in values.items()
            if isinstance(value, Tensor)
        }
        return replace(self, **tensors)

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


def _pin_stiffness(garment: Garment) -> np.ndarray:
    """Stiffness (vertices,) [N/m] of the springs of its pins, which share that of all."""
    if garment.springs is None:
        return np.zeros(len(garment.vertices))
    return garment.pinned * (garment.springs.stiffness / max(int(garment.pinned.sum()), 1))


def inverse_rest_shapes(corners: np.ndarray) -> np.ndarray:
    """Inverses (faces, 2, 2) [1/m] of the rest triangles' edge matrices, edges from corner 0 in columns.

    Args:
        corners: (faces, 3, 2) of the triangles at rest [m], along the grain where there is one.

    Raises:
        InputError: triangles are degenerate; they are named.
    """
    (b1, b2), (c1, c2) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    doubled = b1 * c2 - b2 * c1
    lengths = np.hypot(b1, b2), np.hypot(c1, c2)
    bad = np.flatnonzero(~(np.abs(doubled) > 1e-6 * lengths[0] * np.maximum(*lengths)))
    if len(bad):
        raise InputError(
            f"{len(bad)} rest triangle(s) have no area, the first faces {bad[:5].tolist()}; repair them with `pb4u "
            "check GARMENT.obj --fix OUT.obj`."
        )
    return np.stack([c2, -c1, -b2, b1], axis=1).reshape(-1, 2, 2) / doubled[:, None, None]


def _mean_at_vertices(garment: Garment, values: np.ndarray) -> np.ndarray:
    """Means (vertices,) of `values` (faces,) over the faces around each vertex, by area; the largest where none is."""
    if garment.face_material is None:
        return np.full(len(garment.vertices), values[0])
    sums = garment.at_vertices(values * garment.face_areas)
    return np.where(garment.vertex_areas > 0, sums / np.maximum(garment.vertex_areas, 1e-30), values.max())


def pack(
    garments: Sequence[Garment],
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
    worlds: Sequence[int] | None = None,
) -> PackedGarments:
    """Concatenate garments.

    Args:
        garments: to pack, grouped by world.
        dtype: data type of floating arrays.
        device: device of the arrays.
        worlds: world of each garment, ascending from 0; each in its own world by default.

    Raises:
        InputError: a rest triangle is degenerate.
    """
    starts = offsets([g.vertices for g in garments])

    def real(parts: Sequence[np.ndarray]) -> Tensor:
        return torch.as_tensor(np.concatenate(parts), dtype=dtype, device=device)

    def index(parts: Sequence[np.ndarray]) -> Tensor:
        return torch.as_tensor(joined_indices(parts, starts), dtype=torch.int64, device=device)

    def owner(counts: Sequence[int]) -> Tensor:
        return torch.as_tensor(np.repeat(np.arange(len(garments)), counts), dtype=torch.int64, device=device)

    def per_face(name: str) -> Tensor:
        return real([g.of_faces(name) for g in garments])

    return PackedGarments(
        rest_positions=real([g.vertices for g in garments]),
        faces=index([g.faces for g in garments]),
        inverse_rest_shape=real([inverse_rest_shapes(g.rest_shape) for g in garments]),
        face_areas=real([g.face_areas for g in garments]),
        membrane=per_face("membrane"),
        stiffening=per_face("stiffening"),
        damping=per_face("damping_time"),
        edges=index([g.topology.edges for g in garments]),
        edge_lengths=real([g.edge_lengths for g in garments]),
        hinges=index([g.topology.hinges for g in garments]),
        hinge_areas=real([g.face_areas[g.topology.hinge_faces].sum(axis=1) for g in garments]),
        hinge_damping=real([g.of_faces("damping_time")[g.topology.hinge_faces].mean(axis=1) for g in garments]),
        bending=real([g.hinge_bending for g in garments]),
        friction=real([_mean_at_vertices(g, g.of_faces("friction")) for g in garments]),
        vertex_masses=real([g.vertex_masses for g in garments]),
        vertex_areas=real([g.vertex_areas for g in garments]),
        pinned=torch.as_tensor(np.concatenate([g.pinned & (g.springs is None) for g in garments]), device=device),
        pin_stiffness=real([_pin_stiffness(g) for g in garments]),
        pinned_until=real([np.full(len(g.vertices), g.springs.until if g.springs else np.inf) for g in garments]),
        vertex_garment=owner([len(g.vertices) for g in garments]),
        face_garment=owner([len(g.faces) for g in garments]),
        hinge_garment=owner([len(g.topology.hinges) for g in garments]),
        edge_garment=owner([len(g.topology.edges) for g in garments]),
        vertex_offsets=tuple(starts),
        mean_edge_lengths=tuple(g.mean_edge_length for g in garments),
        garments=tuple(garments),
        worlds=tuple(range(len(garments)) if worlds is None else worlds),
    )
