"""Skinning of garments: where the body alone would put every vertex, at the start, for pins and in every frame."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import torch
from torch import Tensor

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import PosedBody
from pb4u.body.skinning import SkinningWeights
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.garment.garment import Garment
from pb4u.garment.weight_cache import garment_weights
from pb4u.geometry.triangle_mesh import vertex_normals

# Frames placed at a time, which bounds the memory of a fine garment.
_FRAME_CHUNK = 32


class Placement(ABC):
    """Positions of a garment that follow from the moving body, without any physics."""

    @abstractmethod
    def positions(self, start: int, stop: int) -> Tensor:
        """Garment vertices of consecutive frames, as they follow the body without physics.

        Args:
            start: first frame.
            stop: frame after the last.

        Returns:
            (stop - start, vertices, 3) float32 [m].
        """


class SkinnedPlacement(Placement):
    """Linear blend skinning with weights borrowed from a body that has a skeleton.

    Args:
        garment: worn by the body in its rest pose.
        body: the posed body.
        weights: skinning weights of the garment's vertices; borrowed from the body when None.
        worn: (vertices, 3) of the garment on the resting body, over inner garments [m]; its rest shape when None.
    """

    def __init__(
        self,
        garment: Garment,
        body: PosedBody,
        weights: SkinningWeights | None = None,
        worn: np.ndarray | None = None,
    ) -> None:
        self.garment = garment
        self.body = body
        self.worn = garment.vertices if worn is None else worn
        self.weights = garment_weights(garment, body.body) if weights is None else weights

    def positions(self, start: int, stop: int) -> Tensor:
        """Garment vertices (stop - start, vertices, 3) float32 [m] skinned to the bones; see `Placement`.

        Args:
            start: first frame.
            stop: frame after the last.
        """
        return self.body.skin(self.worn, self.weights, start, stop)


class AttachedPlacement(Placement):
    """A garment attached to the surface of a body without a skeleton.

    Every vertex keeps its barycentric coordinates on the body triangle nearest to it in frame 0, and its offset from
    that point, which rotates with the surface. Frame 0 is exactly where the user put the garment.

    Args:
        garment: placed on the body of frame 0.
        body: any moving surface.
        worn: (vertices, 3) of the garment on that body, over inner garments [m]; its rest shape when None.
    """

    def __init__(self, garment: Garment, body: AnimatedBody, worn: np.ndarray | None = None) -> None:
        self.garment = garment
        self.body = body
        start = body.positions(0, 1)[0]
        self._faces = torch.from_numpy(body.faces)
        places = garment.vertices if worn is None else worn
        rest = torch.from_numpy(np.ascontiguousarray(places, dtype=np.float32))
        hit = TriangleSurface(body.faces, len(start), body.contact).at(start).nearest(rest)
        self._corners = self._faces[hit.triangle]
        self._barycentric = hit.barycentric.float()
        frames, anchors = self._surface_frames(start[None])
        self._offsets = ((rest - anchors[0])[:, None, :] @ frames[0])[:, 0]

    def positions(self, start: int, stop: int) -> Tensor:
        """Garment vertices (stop - start, vertices, 3) float32 [m] moved with the body surface; see `Placement`.

        Args:
            start: first frame.
            stop: frame after the last.
        """
        chunks = []
        for first in range(start, stop, _FRAME_CHUNK):
            frames, anchors = self._surface_frames(self.body.positions(first, min(first + _FRAME_CHUNK, stop)))
            chunks.append(anchors + (frames @ self._offsets[:, :, None])[..., 0])
        return torch.cat(chunks) if chunks else torch.zeros(0, len(self.garment.vertices), 3)

    def _surface_frames(self, vertices: Tensor) -> tuple[Tensor, Tensor]:
        """Orthonormal frames (frames, garment vertices, 3, 3), columns are axes, and anchor points of all vertices."""
        corners = vertices[:, self._corners]
        anchors = (self._barycentric[:, :, None] * corners).sum(dim=2)
        # Interpolated normals turn smoothly from one triangle to the next; face normals would crease the cloth.
        normals = (self._barycentric[:, :, None] * vertex_normals(vertices, self._faces)[:, self._corners]).sum(dim=2)
        normal = torch.nn.functional.normalize(normals, dim=-1)
        edge = corners[:, :, 1] - corners[:, :, 0]
        tangent = torch.nn.functional.normalize(edge - (edge * normal).sum(-1, keepdim=True) * normal, dim=-1)
        return torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], dim=-1), anchors


class PrescribedPlacement(Placement):
    """Where a cloth starts, and the paths of its pinned vertices.

    Args:
        frames: (frames, vertices, 3) [m]; later frames repeat the last one.
    """

    def __init__(self, frames: np.ndarray) -> None:
        self.frames = frames

    def positions(self, start: int, stop: int) -> Tensor:
        rows = np.clip(np.arange(start, stop), 0, len(self.frames) - 1)
        return torch.from_numpy(self.frames[rows].astype(np.float32))
