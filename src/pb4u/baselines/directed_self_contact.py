"""Edges of self-contact as the released ContourCraft has them: directed, one a face, also to where pins will be.

Two faces with the same nearest corner give two edges, none is made back, and vertices on an open contour are attracted
too (reference 6.1, 6.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from pb4u.baselines.self_contact import ATTRACTION, REPULSION, PackProximity
from pb4u.geometry.proximity.intersection_contours import ContourFinder
from pb4u.geometry.proximity.self_proximity import facing_pairs
from pb4u.graph.builder import FoundEdges
from pb4u.graph.incidence import incidence
from pb4u.graph.pins import SeenGarments
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True)
class DirectedSelfEdges:
    """Rule for edges of self-contact of the released ContourCraft."""

    def finder(self, pack: PackProximity, radius: float) -> DirectedProximityEdges:
        """Finder of the edges of a pack.

        Args:
            pack: the garments.
            radius: largest height over a face [m].
        """
        return DirectedProximityEdges(pack.garments, radius)


class DirectedProximityEdges:
    """Directed edges from vertices to the nearest corner of the faces that they stand over, world by world.

    Args:
        garments: the pack.
        radius: largest height over a face [m].
    """

    def __init__(self, garments: PackedGarments, radius: float) -> None:
        self._radius = radius
        self._count = garments.vertex_count
        faces = garments.faces.cpu().numpy()
        world = garments.vertex_world.cpu().numpy()[faces[:, 0]] if len(faces) else faces[:, 0]
        self._worlds = [
            _World(start, stop, faces[world == number] - start)
            for number, (start, stop) in enumerate(pairwise(garments.world_offsets))
        ]

    def found(self, seen: SeenGarments) -> Mapping[str, FoundEdges]:
        """Repulsion and attraction edges.

        Args:
            seen: garments at the start of the step.
        """
        positions, velocities, targets = (
            values.detach().to("cpu", torch.float64).numpy()
            for values in (seen.positions, seen.velocities, seen.targets)
        )
        pinned = seen.pinned.cpu().numpy()[:, 0]
        parts = [world.edges(positions, targets + velocities, pinned, self._radius) for world in self._worlds]
        rows = {
            name: np.concatenate([part[name] for part in parts]) for name in ("sender", "receiver", "future", "kind")
        }
        device = seen.positions.device
        return {
            kind: self._directed(rows, rows["kind"] == attracted, device, seen.positions.dtype)
            for kind, attracted in ((REPULSION, False), (ATTRACTION, True))
        }

    def _directed(
        self, rows: Mapping[str, np.ndarray], chosen: np.ndarray, device: torch.device, dtype: torch.dtype
    ) -> FoundEdges:
        order = np.flatnonzero(chosen)
        order = order[np.argsort(rows["receiver"][order], kind="stable")]
        sender, receiver = (torch.from_numpy(rows[name][order]).to(device) for name in ("sender", "receiver"))
        future = torch.from_numpy(rows["future"][order]).to(device, dtype)[:, None]
        return FoundEdges(incidence(sender, self._count), incidence(receiver, self._count), future)


class _World:
    """The cloth of one world, which can touch itself."""

    def __init__(self, start: int, stop: int, faces: np.ndarray) -> None:
        self.rows, self.faces = slice(start, stop), faces
        self.contours = ContourFinder(faces, stop - start)

    def edges(
        self, positions: np.ndarray, future: np.ndarray, pinned: np.ndarray, radius: float
    ) -> dict[str, np.ndarray]:
        now, then, held = positions[self.rows], future[self.rows], pinned[self.rows]
        vertex, face, _ = facing_pairs(now, self.faces, radius)
        ahead, ahead_face = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        if held.any():
            ahead, ahead_face, _ = facing_pairs(then, self.faces, radius)
            ahead, ahead_face = ahead[held[ahead]], ahead_face[held[ahead]]
        sender, over = np.concatenate([vertex, ahead]), np.concatenate([face, ahead_face])
        receiver = np.concatenate([self._corner(now, vertex, face), self._corner(then, ahead, ahead_face)])
        kept, attracted = self._kinds(now, sender, over)
        return {
            "sender": sender[kept] + self.rows.start,
            "receiver": receiver[kept] + self.rows.start,
            "future": np.repeat([False, True], [len(vertex), len(ahead)])[kept],
            "kind": attracted[kept],
        }

    def _corner(self, positions: np.ndarray, vertex: np.ndarray, face: np.ndarray) -> np.ndarray:
        """The corner of each face that is nearest to its vertex."""
        corners = self.faces[face]
        away = np.linalg.norm(positions[corners] - positions[vertex][:, None], axis=2)
        nearest: np.ndarray = np.take_along_axis(corners, away.argmin(axis=1)[:, None], axis=1)[:, 0]
        return nearest

    def _kinds(self, now: np.ndarray, vertex: np.ndarray, face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which pairs are kept, and which of them attract, (pairs,) bool each."""
        contours = self.contours.find(now)
        enclosed = contours.enclosed.getnnz(axis=1)[vertex] > 0
        matching = contours.enclosed[vertex].multiply(contours.touched[face]).getnnz(axis=1) > 0
        return ~enclosed | matching, enclosed
