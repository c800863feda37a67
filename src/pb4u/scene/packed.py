"""Several garments, and the bodies they touch, in one set of arrays: what physics and networks compute on.

Everything here is static during a simulation except `ColliderFrame`, which is made anew each step. Garment g of a pack
touches collider g only, so scenes of different size, resolution and material batch together without touching.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.garment.garment import Garment


@dataclass(frozen=True, eq=False)
class PackedGarments:
    """Static quantities of garments, concatenated. `dtype` is that of the floating arrays.

    Args:
        rest_positions: (vertices, 3) [m].
        faces: (faces, 3) int64 into the packed vertices.
        inverse_rest_shape: (faces, 2, 2) [1/m] inverse of the rest triangle's edge matrix in its own plane.
        face_areas: (faces,) rest areas [m^2].
        lame_mu: (faces,) [Pa]. lame_lambda: (faces,) [Pa]. thickness: (faces,) [m].
        edges: (edges, 2) int64. edge_lengths: (edges,) rest lengths [m].
        hinges: (hinges, 4) int64 edge v0 v1, opposite v2, opposite v3.
        hinge_areas: (hinges,) both rest areas summed [m^2].
        bending: (hinges,) coefficient [J].
        vertex_masses: (vertices,) [kg]. vertex_areas: (vertices,) [m^2]. pinned: (vertices,) bool.
        vertex_garment, face_garment, hinge_garment, edge_garment: garment index of each row, int64, ascending.
        vertex_offsets: first packed vertex of each garment, and the total.
        mean_edge_lengths: mean rest edge length of each garment [m].
        garments: the garments packed.
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

    @property
    def garment_count(self) -> int:
        return len(self.garments)

    @property
    def vertex_count(self) -> int:
        return self.vertex_offsets[-1]

    @property
    def dtype(self) -> torch.dtype:
        return self.rest_positions.dtype

    @property
    def device(self) -> torch.device:
        return self.rest_positions.device


@dataclass(frozen=True, eq=False)
class ColliderFrame:
    """Where the colliders of a pack are around one step, concatenated.

    Args:
        previous, now, following: (vertices, 3) [m] at frames t-1, t, t+1.
        faces: (faces, 3) int64 into the packed vertices.
        contact: (vertices,) bool, False where contact is not answered.
        vertex_garment: (vertices,) int64 index of the garment that touches this collider.
        ground_height: height of the ground plane [m], or None.
    """

    previous: Tensor
    now: Tensor
    following: Tensor
    faces: Tensor
    contact: Tensor
    vertex_garment: Tensor
    ground_height: float | None = 0.0


def inverse_rest_shapes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(faces, 2, 2) [1/m] inverse of [x1 x2; 0 y2], the rest triangle's edges from corner 0 in its own plane.

    Raises InputError naming the degenerate triangles.
    """
    e1 = vertices[faces[:, 1]] - vertices[faces[:, 0]]
    e2 = vertices[faces[:, 2]] - vertices[faces[:, 0]]
    x1 = np.linalg.norm(e1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        x2 = np.einsum("ij,ij->i", e1, e2) / x1
        y2 = np.linalg.norm(np.cross(e1, e2), axis=1) / x1
    longest = np.maximum(x1, np.linalg.norm(e2, axis=1))
    bad = np.flatnonzero(~(x1 > 0) | ~(y2 > 1e-6 * longest))
    if len(bad):
        raise InputError(
            f"{len(bad)} rest triangle(s) have no area, first faces {bad[:5].tolist()}; "
            "mend them with `pb4u check GARMENT.obj --fix OUT.obj`."
        )
    inverse = np.zeros((len(faces), 2, 2))
    inverse[:, 0, 0] = 1.0 / x1
    inverse[:, 0, 1] = -x2 / (x1 * y2)
    inverse[:, 1, 1] = 1.0 / y2
    return inverse


def pack(
    garments: Sequence[Garment], dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> PackedGarments:
    """Concatenate `garments`. Raises InputError when a rest triangle is degenerate."""
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
        inverse_rest_shape=real([inverse_rest_shapes(g.vertices, g.faces) for g in garments]),
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
    )
