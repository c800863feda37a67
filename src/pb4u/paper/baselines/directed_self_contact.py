"""Edges of self-contact as the released ContourCraft has them: directed, one a face, also to where pins will be.

Two faces with the same nearest corner give two edges, none is made back, and vertices on an open contour are attracted
too (reference 6.1, 6.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from pb4u.network.graph.builder import FoundEdges
from pb4u.network.graph.incidence import incidence
from pb4u.network.graph.pins import SeenGarments
from pb4u.paper.baselines.enclosures import by_side
from pb4u.paper.baselines.self_contact_edges import ATTRACTION, REPULSION, as_points
from pb4u.paper.baselines.self_proximity import SelfProximity, facing_pairs, nearest_corners
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True)
class DirectedSelfEdges:
    """Rule for edges of self-contact of the released ContourCraft."""

    def finder(self, garments: PackedGarments, proximity: SelfProximity, radius: float) -> DirectedProximityEdges:
        """Finder of the edges of a pack.

        Args:
            garments: the pack.
            proximity: search for parts of one garment close to each other; unused here, since garments of a world touch
                each other too.
            radius: largest height over a face [m].
        """
        return DirectedProximityEdges(garments, radius)


class DirectedProximityEdges:
    """Directed edges from vertices to the nearest corner of the faces of their world onto which they project.

    Args:
        garments: the pack.
        radius: largest height over a face [m].
    """

    def __init__(self, garments: PackedGarments, radius: float) -> None:
        self._radius = radius
        self._proximity = SelfProximity(garments.surface_tree, by_side)

    def found(self, seen: SeenGarments) -> Mapping[str, FoundEdges]:
        """Repulsion and attraction edges.

        Args:
            seen: garments at the start of the step.
        """
        now, then = as_points(seen.positions), as_points(seen.targets) + as_points(seen.velocities)
        pinned, faces = seen.pinned.cpu().numpy()[:, 0], self._proximity.tree.faces
        sender, over, _ = facing_pairs(now, self._proximity.tree, self._radius)
        receiver, future = nearest_corners(now, faces, sender, over), np.zeros(len(sender), dtype=bool)
        if pinned.any():
            ahead, ahead_over, _ = facing_pairs(then, self._proximity.tree, self._radius)
            ahead, ahead_over = ahead[pinned[ahead]], ahead_over[pinned[ahead]]
            sender, over = np.concatenate([sender, ahead]), np.concatenate([over, ahead_over])
            receiver = np.concatenate([receiver, nearest_corners(then, faces, ahead, ahead_over)])
            future = np.concatenate([future, np.ones(len(ahead), dtype=bool)])
        free, attracted = self._proximity.enclosures(now).told(sender, over)
        edges = {}
        for kind, chosen in ((REPULSION, free & ~attracted), (ATTRACTION, free & attracted)):
            order = np.flatnonzero(chosen)
            order = order[np.argsort(receiver[order], kind="stable")]
            edges[kind] = self._directed(seen.positions, sender[order], receiver[order], future[order])
        return edges

    def _directed(
        self, positions: torch.Tensor, sender: np.ndarray, receiver: np.ndarray, future: np.ndarray
    ) -> FoundEdges:
        senders, receivers = (
            incidence(torch.from_numpy(rows).to(positions.device), len(positions)) for rows in (sender, receiver)
        )
        return FoundEdges(senders, receivers, torch.from_numpy(future).to(positions)[:, None])
