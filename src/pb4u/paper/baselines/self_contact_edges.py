"""Contact of cloth with itself, as ContourCraft has it: edges (reference 6.1) and losses (reference 6.3)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from pb4u.network.graph.builder import FoundEdges
from pb4u.network.graph.pins import SeenGarments
from pb4u.paper.baselines.enclosures import by_contour
from pb4u.paper.baselines.intersection_contours import ContourFinder
from pb4u.paper.baselines.self_proximity import SelfProximity, nearest_corners
from pb4u.physics.terms.collision import REFERENCE_AREA
from pb4u.scene.packed import PackedGarments

REPULSION, ATTRACTION = "repulsion", "attraction"


def own_proximity(garments: PackedGarments) -> SelfProximity:
    """Search for parts of each garment of a pack that are close to each other; edges and losses share it.

    Args:
        garments: the packed garments.
    """
    return SelfProximity(garments.surface_tree_of_each, by_contour)


class SelfProximityEdges:
    """Edges from vertices to the nearest corner of the faces of their own garment onto which they project.

    Args:
        proximity: search of the pack.
        radius: largest height over a face [m].
    """

    def __init__(self, proximity: SelfProximity, radius: float) -> None:
        self._proximity, self._radius = proximity, radius

    def found(self, seen: SeenGarments) -> Mapping[str, FoundEdges]:
        """Repulsion and attraction edges, each pair in both directions.

        Args:
            seen: the garments as the network gets them.
        """
        pairs = self.find(seen.positions)
        return {kind: FoundEdges.both_ways(edges, len(seen.positions)) for kind, edges in pairs.items()}

    def find(self, positions: Tensor) -> Mapping[str, Tensor]:
        """Undirected repulsion and attraction edges (edges, 2) int64 vertex indices of the pack, each pair once a kind.

        Args:
            positions: (vertices, 3) [m].
        """
        points = as_points(positions)
        facing = self._proximity.find(points, self._radius)
        nearest = nearest_corners(points, self._proximity.tree.faces, facing.vertices, facing.faces)
        pairs = np.sort(np.column_stack([facing.vertices, nearest]), axis=1)
        return {
            kind: torch.from_numpy(np.unique(pairs[chosen], axis=0)).to(positions.device)
            for kind, chosen in ((REPULSION, ~facing.passed), (ATTRACTION, facing.passed))
        }


def as_points(positions: Tensor) -> np.ndarray:
    """Positions (vertices, 3) [m] in the format of the searches.

    Args:
        positions: (vertices, 3) [m].
    """
    return positions.detach().to("cpu", torch.float64).numpy()


@dataclass(frozen=True)
class SymmetricSelfEdges:
    """Rule for edges of self-contact: each pair in both directions, once a kind."""

    def finder(self, garments: PackedGarments, proximity: SelfProximity, radius: float) -> SelfProximityEdges:
        """Finder of the edges of a pack.

        Args:
            garments: the pack.
            proximity: search for where each garment is close to itself.
            radius: largest height over a face [m].
        """
        return SelfProximityEdges(proximity, radius)


@dataclass(frozen=True)
class Ramp:
    """A weight that rises linearly while a training goes on.

    Args:
        start: fraction of the training's budget up to which the weight is 0.
        stop: fraction from which on the weight is `most`.
        most: the full weight, in the unit of the loss that it weighs.
    """

    start: float
    stop: float
    most: float

    def at(self, progress: float) -> float:
        """Weight at a fraction `progress` of the budget, in the unit of `most`.

        Args:
            progress: fraction of the budget that is spent, 0 to 1.
        """
        points = (self.start, self.stop)
        stage = bisect_right(points, progress)
        return (0.0, self.most * (progress - self.start) / max(self.stop - self.start, 1e-12), self.most)[stage]


@dataclass(frozen=True)
class Repulsion:
    """Sum over vertices and the faces onto which they project of w A_i / A_ref max(eps - s d, 0)^3 [J].

    d is the height over the face's plane after the step, s its sign before it, so that a vertex stays on its side. The
    vertex area A_i over `reference_area` makes it the same at every resolution, as our collisions are.

    Args:
        weight: w [J/m^3].
        clearance: eps [m].
        reach: height before the step up to which a pair counts [m].
        reference_area: A_ref [m^2].
    """

    weight: Ramp = field(default_factory=lambda: Ramp(30 / 56, 40 / 56, 2e6))
    clearance: float = 3e-3
    reach: float = 1e-2
    reference_area: float = REFERENCE_AREA
    name = "repulsion"

    def energies(
        self, garments: PackedGarments, proximity: SelfProximity, before: Tensor, after: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Energies over w [m^3] and garment (pairs,) int64 of all pairs, differentiable with respect to `after`.

        Args:
            garments: the pack.
            proximity: search for where each garment is close to itself.
            before: (vertices, 3) positions before the step [m].
            after: (vertices, 3) positions after the step [m].
        """
        facing = proximity.find(as_points(before), self.reach)
        outside = ~facing.passed
        vertices, faces, side = (
            torch.from_numpy(values[outside]).to(after.device)
            for values in (facing.vertices, proximity.tree.faces[facing.faces], np.sign(facing.heights))
        )
        a, b, c = (after[faces[:, corner]] for corner in range(3))
        normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-12)
        height = side.to(after) * ((after[vertices] - a) * normal).sum(dim=1)
        share = garments.vertex_areas[vertices].to(after) / self.reference_area
        return share * (self.clearance - height).clamp_min(0.0) ** 3, garments.vertex_garment[vertices]


@dataclass(frozen=True)
class ContourLength:
    """Sum of w times the squared lengths of the segments in which the cloth intersects itself after the step [J].

    Only the positions of the crossings along the edges are differentiated; the ends of the edges are fixed (reference
    6.3).

    Args:
        weight: w [J/m^2].
    """

    weight: Ramp = field(default_factory=lambda: Ramp(45 / 56, 50 / 56, 1e7))
    name = "contours"

    def energies(
        self, garments: PackedGarments, proximity: SelfProximity, before: Tensor, after: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Energies over w [m^2] and garment (segments,) int64 of all segments, differentiable with respect to `after`.

        Args:
            garments: the pack.
            proximity: search for where each garment is close to itself.
            before: (vertices, 3) positions before the step [m].
            after: (vertices, 3) positions after the step [m].
        """
        squares, vertices = squared_segment_lengths(proximity.contours, after)
        return squares, garments.vertex_garment[vertices]


@dataclass(frozen=True, eq=False)
class SelfContactLoss:
    """A loss of self-contact, for the garments of one pack; see `FurtherLoss`.

    Args:
        loss: the term to sum over each garment.
        garments: the pack.
        proximity: search for where each garment is close to itself.
    """

    loss: Repulsion | ContourLength
    garments: PackedGarments
    proximity: SelfProximity

    @property
    def name(self) -> str:
        return self.loss.name

    def energies(self, before: Tensor, after: Tensor, progress: float) -> Tensor:
        weight, total = self.loss.weight.at(progress), after.new_zeros(self.garments.garment_count)
        if weight == 0.0:
            return total
        parts, garment = self.loss.energies(self.garments, self.proximity, before, after)
        return total.index_add(0, garment, (weight * parts).to(total))


def squared_segment_lengths(finder: ContourFinder, positions: Tensor) -> tuple[Tensor, Tensor]:
    """Squared lengths (segments,) float64 [m^2] of all intersection segments, and a vertex (segments,) int64 of each.

    Differentiable as `ContourLength` says.

    Args:
        finder: finds the segments.
        positions: (vertices, 3) [m].
    """
    positions = positions.to(torch.float64)
    contours, topology = finder.find(as_points(positions)), finder.topology
    edges, faces, segments = (
        torch.from_numpy(values).to(positions.device)
        for values in (topology.edges[contours.edges], topology.faces[contours.faces], contours.segments)
    )
    p, q = positions[edges[:, 0]], positions[edges[:, 1]]
    a, b, c = (positions[faces[:, corner]] for corner in range(3))
    normal = torch.linalg.cross(b - a, c - a)
    above, below = ((p - a) * normal).sum(dim=1), ((q - a) * normal).sum(dim=1)
    points = p.detach() + (above / (above - below))[:, None] * (q - p).detach()
    ends = points[segments]
    return (ends[:, 1] - ends[:, 0]).square().sum(dim=1), edges[segments[:, 0], 0]
