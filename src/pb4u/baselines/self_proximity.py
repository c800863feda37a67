"""Cloth that comes near itself: vertices over faces, which push each other away or, passed through, pull back.

As in ContourCraft (reference 6.1, 6.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from pb4u.baselines.intersection_contours import ContourFinder, Contours
from pb4u.baselines.near_pairs import near_pairs
from pb4u.baselines.triangle_frames import TriangleFrames
from pb4u.scene.packed import PackedGarments

REPULSION, ATTRACTION = "repulsion", "attraction"
_made: WeakKeyDictionary[PackedGarments, dict[float, list[SelfProximity]]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Facing:
    """Vertices that stand over faces they are no corner of.

    Args:
        vertices, faces: (pairs,) int64.
        heights: (pairs,) [m] over the face's plane, positive outside.
        attracted: (pairs,) bool, whether the vertex has passed through and is pulled back.
    """

    vertices: np.ndarray
    faces: np.ndarray
    heights: np.ndarray
    attracted: np.ndarray


def facing_pairs(vertices: np.ndarray, faces: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertex, face and height (pairs,) of all pairs whose foot is in the face and whose height is within `radius` [m].

    Faces that have the vertex as a corner are left out, and so is what is not finite.
    """
    finite = np.isfinite(vertices).all(axis=1)
    vertices = np.where(finite[:, None], vertices, 0.0).astype(np.float64)
    frames = TriangleFrames.of(vertices, faces)
    usable, usable_faces = np.flatnonzero(finite), np.flatnonzero(finite[faces].all(axis=1))
    reach = np.hypot(radius, frames.radii[usable_faces])
    found = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
    for v, f in near_pairs(vertices[usable], np.full(len(usable), 1e-9), frames.centres[usable_faces], reach):
        vertex, face = usable[v], usable_faces[f]
        kept = np.flatnonzero(frames.contains_foot(face, vertices[vertex]))
        vertex, face = vertex[kept], face[kept]
        height = frames.heights(face, vertices[vertex])
        strange = (faces[face] != vertex[:, None]).all(axis=1) & (np.abs(height) <= radius)
        found.append((vertex[strange], face[strange], height[strange]))
    vertex, face, height = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.lexsort((face, vertex))
    return vertex[order], face[order], height[order]


class SelfProximity:
    """What comes near what on one garment.

    Args:
        faces: (faces, 3) int64. vertex_count: number of vertices. radius: largest height [m].
    """

    def __init__(self, faces: np.ndarray, vertex_count: int, radius: float) -> None:
        self.faces, self.radius = faces, radius
        self.contours = ContourFinder(faces, vertex_count)

    def find(self, vertices: np.ndarray) -> Facing:
        """Pairs at `vertices` (vertices, 3) [m].

        A vertex that a contour encloses is attracted to the faces of that contour; its other pairs are left out.
        """
        vertex, face, height = facing_pairs(vertices, self.faces, self.radius)
        contours: Contours = self.contours.find(vertices)
        passed = contours.enclosed.getnnz(axis=1)[vertex] > 0
        matching = contours.enclosed[vertex].multiply(contours.touched[face]).getnnz(axis=1) > 0
        kept = ~passed | matching
        return Facing(vertex[kept], face[kept], height[kept], passed[kept])


class SelfProximityEdges:
    """Edges from vertices to the nearest corner of the faces that they stand over, garment by garment.

    Args:
        garments: whose vertices they join. radius: largest height [m].
    """

    def __init__(self, garments: PackedGarments, radius: float) -> None:
        self._offsets = garments.vertex_offsets
        self._garments = garments_proximity(garments, radius)

    def find(self, positions: Tensor) -> Mapping[str, Tensor]:
        """Repulsion and attraction edges (edges, 2) int64 of the pack, each pair of vertices once a kind."""
        found: dict[str, list[np.ndarray]] = {REPULSION: [], ATTRACTION: []}
        points = positions.detach().to("cpu", torch.float64).numpy()
        for garment, proximity in enumerate(self._garments):
            start, stop = self._offsets[garment : garment + 2]
            own = points[start:stop]
            facing = proximity.find(own)
            corners = proximity.faces[facing.faces]
            away = np.linalg.norm(own[corners] - own[facing.vertices][:, None], axis=2)
            nearest = np.take_along_axis(corners, away.argmin(axis=1)[:, None], axis=1)[:, 0]
            pairs = np.sort(np.column_stack([facing.vertices, nearest]), axis=1)
            for kind, chosen in ((REPULSION, ~facing.attracted), (ATTRACTION, facing.attracted)):
                found[kind].append(np.unique(pairs[chosen], axis=0) + start)
        return {
            kind: torch.from_numpy(np.concatenate(parts).reshape(-1, 2)).to(positions.device)
            for kind, parts in found.items()
        }


def garments_proximity(garments: PackedGarments, radius: float) -> list[SelfProximity]:
    """A finder for each garment of a pack, numbered within it; made once a pack."""
    made = _made.setdefault(garments, {})
    if radius not in made:
        made[radius] = _garments_proximity(garments, radius)
    return made[radius]


def _garments_proximity(garments: PackedGarments, radius: float) -> list[SelfProximity]:
    offsets = garments.vertex_offsets
    return [
        SelfProximity(
            garments.faces[garments.face_garment == garment].cpu().numpy() - offsets[garment],
            offsets[garment + 1] - offsets[garment],
            radius,
        )
        for garment in range(garments.garment_count)
    ]
