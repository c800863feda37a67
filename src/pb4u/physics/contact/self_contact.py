"""Cloth against cloth: what the solver and every other move of a garment are told of it.

Two promises: no step of any kind carries one element of cloth through another, and none leaves two nearer than
`SMALLEST_GAP`. They hold from any positions that cross nowhere.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.collision_free import collision_free, free_shares, smallest_gaps
from pb4u.collision.element_distance import crossing_shares
from pb4u.collision.element_pairs import ElementPairs
from pb4u.collision.jit import as_float64
from pb4u.scene.packed import PackedGarments

_SHARE_OF_REST = 0.5
"""Share of their distance at rest within which two elements of one garment feel each other: at rest none does."""

_PARALLEL = 1e-3
"""Squared sine of the angle between two edges from which on they feel each other in full: 1.8 degrees."""


@dataclass(frozen=True, eq=False)
class ClothPairs:
    """Pairs of cloth elements that may touch, and what their contact is weighed by.

    Args:
        pairs: vertex and face, and edge and edge.
        gaps: (pairs,) [m] that they never come within.
        reaches: (pairs,) [m] at which they begin to feel each other.
        areas: (pairs,) [m^2] of cloth that each pair stands for.
        parallels: (pairs,) squared cross product [m^4] below which two edges count as parallel; 0 for the others.
    """

    pairs: ElementPairs
    gaps: np.ndarray
    reaches: np.ndarray
    areas: np.ndarray
    parallels: np.ndarray

    @staticmethod
    def along(
        garments: PackedGarments,
        x: Tensor,
        moves: Tensor | None,
        before: Tensor,
        reach: float,
        known: ClothPairs | None = None,
    ) -> ClothPairs:
        """All pairs that come within `reach` on the way along `moves`.

        Args:
            garments: whose elements they are.
            x: (vertices, 3) [m].
            moves: (vertices, 3) [m] from there, linear; None for none.
            before: (vertices, 3) [m] positions that cross nowhere, as the step began.
            reach: distance [m].
            known: pairs of positions a little before these, or None.
        """
        tree, way = garments.surface_tree, None if moves is None else as_float64(moves)
        pairs = tree.pairs(as_float64(x), reach, way, None if known is None else known.pairs, lasting=True)
        gaps = smallest_gaps(pairs, as_float64(before))
        reaches = np.maximum(np.minimum(reach, _SHARE_OF_REST * pairs.rest_distance), 2.0 * gaps)
        # An integral over the cloth is met once from the vertices of each side and once from the edges of each.
        areas = 0.25 * garments.vertex_areas.detach().cpu().numpy()[pairs.corners].mean(axis=1)
        ends = garments.surface_tree.rest[pairs.corners]
        lengths = ((ends[:, [1, 3]] - ends[:, [0, 2]]) ** 2).sum(axis=2)
        parallels = _PARALLEL * lengths.prod(axis=1)
        parallels[: pairs.vertex_faces] = 0.0
        return ClothPairs(pairs, gaps, reaches, areas, parallels)

    def touching(self, x: Tensor) -> TouchingCloth | None:
        """Those of the pairs that feel each other at `x` (vertices, 3) [m], or None."""
        distances, weights, normals = self.pairs.nearest(as_float64(x))
        rows = distances < self.reaches
        if not rows.any():
            return None
        corners = self.pairs.corners[rows]
        return TouchingCloth(
            corners,
            weights[rows],
            normals[rows],
            distances[rows],
            self.gaps[rows],
            self.reaches[rows],
            self.areas[rows] * crossing_shares(as_float64(x), corners, self.parallels[rows]),
        )


@dataclass(frozen=True, eq=False)
class TouchingCloth:
    """Pairs of cloth elements that feel each other at one instant.

    Args:
        corners: (pairs, 4) int64.
        weights: (pairs, 4) with which the corners sum to the vector between the nearest points.
        normals: (pairs, 3) unit vectors along it.
        distances: (pairs,) [m].
        gaps: (pairs,) [m] that they never come within.
        reaches: (pairs,) [m] at which they begin to feel each other.
        areas: (pairs,) [m^2] of cloth that each pair stands for, less of edges that are nearly parallel.
    """

    corners: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    distances: np.ndarray
    gaps: np.ndarray
    reaches: np.ndarray
    areas: np.ndarray


class SelfContact(ABC):
    """What keeps cloth from passing through cloth."""

    @abstractmethod
    def pairs(
        self,
        garments: PackedGarments,
        x: Tensor,
        moves: Tensor | None,
        before: Tensor,
        known: ClothPairs | None = None,
    ) -> ClothPairs | None:
        """Pairs that feel each other somewhere on the way along `moves`, as in `ClothPairs.along`; None for none."""

    @abstractmethod
    def free_start(self, garments: PackedGarments, x: Tensor) -> Tensor:
        """Positions (vertices, 3) [m] near `x` from which a simulation may begin, pinned vertices in their places.

        Args:
            garments: static quantities.
            x: (vertices, 3) [m].

        Raises InputError where what crosses cannot be untangled.
        """

    @abstractmethod
    def carried(
        self,
        garments: PackedGarments,
        before: Tensor,
        wanted: Tensor,
        cloth: ClothPairs | None = None,
        held: Tensor | None = None,
    ) -> Tensor:
        """Positions (vertices, 3) [m] near `wanted` that are reached without cloth passing through cloth.

        Gives back `wanted` itself where no cloth touches.

        Args:
            garments: static quantities.
            before: (vertices, 3) [m] that cross nowhere.
            wanted: (vertices, 3) [m].
            cloth: all pairs that may touch on the way, where they were looked up already.
            held: (vertices,) bool, of which none gives way to what meets it, as no pinned vertex does; None for none.
        """

    @abstractmethod
    def shares(self, garments: PackedGarments, cloth: ClothPairs | None, x: Tensor, moves: Tensor) -> Tensor:
        """Shares (worlds,) in [0, 1] of linear `moves` that each world may take.

        Args:
            garments: static quantities.
            cloth: all pairs that may touch on the way.
            x: (vertices, 3) [m] that cross nowhere.
            moves: (vertices, 3) [m].
        """


class NoSelfContact(SelfContact):
    """Cloth passes through cloth: the paper's physics."""

    def pairs(
        self,
        garments: PackedGarments,
        x: Tensor,
        moves: Tensor | None,
        before: Tensor,
        known: ClothPairs | None = None,
    ) -> ClothPairs | None:
        return None

    def free_start(self, garments: PackedGarments, x: Tensor) -> Tensor:
        return x

    def carried(
        self,
        garments: PackedGarments,
        before: Tensor,
        wanted: Tensor,
        cloth: ClothPairs | None = None,
        held: Tensor | None = None,
    ) -> Tensor:
        return wanted

    def shares(self, garments: PackedGarments, cloth: ClothPairs | None, x: Tensor, moves: Tensor) -> Tensor:
        return x.new_ones(garments.world_count)


@dataclass(frozen=True)
class CollisionFree(SelfContact):
    """Cloth stays apart from cloth, within a garment and between the garments of a world.

    Args:
        reach: distance [m] at which elements begin to feel each other.
    """

    reach: float = 2e-3

    def pairs(
        self,
        garments: PackedGarments,
        x: Tensor,
        moves: Tensor | None,
        before: Tensor,
        known: ClothPairs | None = None,
    ) -> ClothPairs | None:
        return ClothPairs.along(garments, x, moves, before, self.reach, known)

    def free_start(self, garments: PackedGarments, x: Tensor) -> Tensor:
        # Needs what a machine that only trains may lack.
        from pb4u.garment.tangles import untangled_start

        positions, freed = as_float64(x), []
        for world, (first, stop) in enumerate(pairwise(garments.world_offsets)):
            worn = [g for g, its in zip(garments.garments, garments.worlds, strict=True) if its == world]
            freed.append(untangled_start(worn, positions[first:stop]))
        return torch.from_numpy(np.concatenate(freed)).to(x)

    def carried(
        self,
        garments: PackedGarments,
        before: Tensor,
        wanted: Tensor,
        cloth: ClothPairs | None = None,
        held: Tensor | None = None,
    ) -> Tensor:
        firm = garments.pinned if held is None else garments.pinned | held
        masses = torch.where(firm, torch.inf, garments.vertex_masses.clamp_min(1e-12))
        asked, known = as_float64(wanted), None if cloth is None else (cloth.pairs, cloth.gaps)
        result = collision_free(garments.surface_tree, as_float64(before), asked, as_float64(masses), known)
        return wanted if result is asked else torch.from_numpy(result).to(wanted)

    def shares(self, garments: PackedGarments, cloth: ClothPairs | None, x: Tensor, moves: Tensor) -> Tensor:
        result = x.new_ones(garments.world_count)
        if cloth is None or not len(cloth.pairs):
            return result
        free = torch.from_numpy(free_shares(cloth.pairs, cloth.gaps, as_float64(x), as_float64(moves)))
        world = garments.vertex_world[torch.from_numpy(cloth.pairs.corners[:, 0])]
        return result.scatter_reduce(0, world, free.to(x), "amin")
