"""Edges between cloth that comes near itself: repulsion, and attraction where it has passed through (reference 6.1)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from pb4u.geometry.proximity.self_proximity import SelfProximity
from pb4u.scene.packed import PackedGarments

REPULSION, ATTRACTION = "repulsion", "attraction"


def garments_proximity(garments: PackedGarments) -> list[SelfProximity]:
    """A finder for each garment of a pack, on vertices numbered within it."""
    offsets = garments.vertex_offsets
    return [
        SelfProximity(
            garments.faces[garments.face_garment == garment].cpu().numpy() - offsets[garment],
            offsets[garment + 1] - offsets[garment],
        )
        for garment in range(garments.garment_count)
    ]


class SelfProximityEdges:
    """Edges from vertices to the nearest corner of the faces that they stand over, garment by garment.

    Args:
        finders: of each garment of a pack.
        vertex_offsets: first packed vertex of each garment, and the total.
        radius: largest height over a face [m].
    """

    def __init__(self, finders: list[SelfProximity], vertex_offsets: tuple[int, ...], radius: float) -> None:
        self._finders, self._offsets, self._radius = finders, vertex_offsets, radius

    def find(self, positions: Tensor) -> Mapping[str, Tensor]:
        """Repulsion and attraction edges (edges, 2) int64 of the pack, each pair of vertices once a kind.

        Args:
            positions: (vertices, 3) [m].
        """
        edges: dict[str, list[np.ndarray]] = {REPULSION: [], ATTRACTION: []}
        points = positions.detach().to("cpu", torch.float64).numpy()
        for garment, finder in enumerate(self._finders):
            start, stop = self._offsets[garment : garment + 2]
            own = points[start:stop]
            facing = finder.find(own, self._radius)
            corners = finder.faces[facing.faces]
            away = np.linalg.norm(own[corners] - own[facing.vertices][:, None], axis=2)
            nearest = np.take_along_axis(corners, away.argmin(axis=1)[:, None], axis=1)[:, 0]
            pairs = np.sort(np.column_stack([facing.vertices, nearest]), axis=1)
            for kind, chosen in ((REPULSION, ~facing.passed), (ATTRACTION, facing.passed)):
                edges[kind].append(np.unique(pairs[chosen], axis=0) + start)
        return {
            kind: torch.from_numpy(np.concatenate(parts).reshape(-1, 2)).to(positions.device)
            for kind, parts in edges.items()
        }
