"""Contact of cloth with itself, as ContourCraft has it: edges (reference 6.1) and losses (reference 6.3)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from pb4u.geometry.proximity.intersection_contours import ContourFinder
from pb4u.geometry.proximity.self_proximity import SelfProximity
from pb4u.graph.builder import FoundEdges
from pb4u.graph.pins import SeenGarments
from pb4u.scene.packed import PackedGarments

REPULSION, ATTRACTION = "repulsion", "attraction"


class PackProximity:
    """Searches for places where each garment of a pack is close to itself; edges and losses share one.

    Args:
        garments: the pack.

    Attributes:
        garments: the pack.
        spans: rows of the vertices of each garment in the pack.
        finders: search of each garment, on vertices numbered within it.
    """

    def __init__(self, garments: PackedGarments) -> None:
        self.garments = garments
        self.spans = [slice(start, stop) for start, stop in pairwise(garments.vertex_offsets)]
        self.finders = [
            SelfProximity(
                garments.faces[garments.face_garment == garment].cpu().numpy() - span.start, span.stop - span.start
            )
            for garment, span in enumerate(self.spans)
        ]


class SelfProximityEdges:
    """Edges from vertices to the nearest corner of the faces that they stand over, garment by garment.

    Args:
        pack: the garments.
        radius: largest height over a face [m].
    """

    def __init__(self, pack: PackProximity, radius: float) -> None:
        self._pack, self._radius = pack, radius

    def found(self, seen: SeenGarments) -> Mapping[str, FoundEdges]:
        """Repulsion and attraction edges, each pair in both directions."""
        pairs = self.find(seen.positions)
        return {kind: FoundEdges.both_ways(edges, len(seen.positions)) for kind, edges in pairs.items()}

    def find(self, positions: Tensor) -> Mapping[str, Tensor]:
        """Undirected repulsion and attraction edges (edges, 2) int64 vertex indices of the pack, each pair once a kind.

        Args:
            positions: (vertices, 3) [m].
        """
        edges: dict[str, list[np.ndarray]] = {REPULSION: [], ATTRACTION: []}
        points = positions.detach().to("cpu", torch.float64).numpy()
        for finder, span in zip(self._pack.finders, self._pack.spans, strict=True):
            own = points[span]
            facing = finder.find(own, self._radius)
            corners = finder.faces[facing.faces]
            away = np.linalg.norm(own[corners] - own[facing.vertices][:, None], axis=2)
            nearest = np.take_along_axis(corners, away.argmin(axis=1)[:, None], axis=1)[:, 0]
            pairs = np.sort(np.column_stack([facing.vertices, nearest]), axis=1)
            for kind, chosen in ((REPULSION, ~facing.passed), (ATTRACTION, facing.passed)):
                edges[kind].append(np.unique(pairs[chosen], axis=0) + span.start)
        return {
            kind: torch.from_numpy(np.concatenate(parts).reshape(-1, 2)).to(positions.device)
            for kind, parts in edges.items()
        }


@dataclass(frozen=True)
class SymmetricSelfEdges:
    """Rule for edges of self-contact: each pair in both directions, once a kind."""

    def finder(self, pack: PackProximity, radius: float) -> SelfProximityEdges:
        """Finder of the edges of a pack.

        Args:
            pack: the garments.
            radius: largest height over a face [m].
        """
        return SelfProximityEdges(pack, radius)


@dataclass(frozen=True)
class Ramp:
    """A weight that rises linearly while a training goes on.

    Args:
        start: fraction of the training's budget up to which the weight is 0.
        stop: fraction from which on it is `most`.
        most: the full weight, in the unit of the loss that it weighs.
    """

    start: float
    stop: float
    most: float

    def at(self, progress: float) -> float:
        """Weight at a fraction `progress` of the budget, in the unit of `most`."""
        points = (self.start, self.stop)
        stage = bisect_right(points, progress)
        return (0.0, self.most * (progress - self.start) / max(self.stop - self.start, 1e-12), self.most)[stage]


@dataclass(frozen=True)
class Repulsion:
    """Sum over vertices and the faces they stand over of w A_i / A_ref max(eps - s d, 0)^3 [J].

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
    reference_area: float = 1.6e-4
    name = "repulsion"

    def energy(self, pack: PackProximity, garment: int, weight: float, before: Tensor, after: Tensor) -> Tensor:
        """Loss of one garment, a scalar [J], differentiable with respect to `after`.

        Args:
            pack: the garments.
            garment: index of the garment.
            weight: w at this point of the training [J/m^3].
            before: (vertices, 3) positions of the pack before the step [m].
            after: (vertices, 3) positions of the pack after it [m].
        """
        proximity, own = pack.finders[garment], pack.spans[garment]
        facing = proximity.find(before[own].detach().to("cpu", torch.float64).numpy(), self.reach)
        kept = ~facing.passed
        vertices, faces, side = (
            torch.from_numpy(values[kept]).to(after.device)
            for values in (
                facing.vertices + own.start,
                proximity.faces[facing.faces] + own.start,
                np.sign(facing.heights),
            )
        )
        a, b, c = (after[faces[:, corner]] for corner in range(3))
        normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-12)
        height = side.to(after) * ((after[vertices] - a) * normal).sum(dim=1)
        share = pack.garments.vertex_areas[vertices].to(after) / self.reference_area
        return (weight * share * (self.clearance - height).clamp_min(0.0) ** 3).sum()


@dataclass(frozen=True)
class ContourLength:
    """Sum of w times the squared lengths of the segments in which the cloth intersects itself after the step [J].

    Only the places along the edges where they cross faces are differentiated; the ends of the edges are taken as fixed
    (reference 6.3).

    Args:
        weight: w [J/m^2].
    """

    weight: Ramp = field(default_factory=lambda: Ramp(45 / 56, 50 / 56, 1e7))
    name = "contours"

    def energy(self, pack: PackProximity, garment: int, weight: float, before: Tensor, after: Tensor) -> Tensor:
        """Loss of one garment, a scalar [J], differentiable with respect to `after`.

        Args:
            pack: the garments.
            garment: index of the garment.
            weight: w at this point of the training [J/m^2].
            before: (vertices, 3) positions of the pack before the step [m].
            after: (vertices, 3) positions of the pack after it [m].
        """
        return weight * squared_contour_length(pack.finders[garment].contours, after[pack.spans[garment]])


@dataclass(frozen=True, eq=False)
class SelfContactLoss:
    """A loss of self-contact, for the garments of one pack; see `FurtherLoss`.

    Args:
        loss: loss of one garment.
        pack: the garments.
    """

    loss: Repulsion | ContourLength
    pack: PackProximity

    @property
    def name(self) -> str:
        return self.loss.name

    def energies(self, before: Tensor, after: Tensor, progress: float) -> Tensor:
        weight, total = self.loss.weight.at(progress), after.new_zeros(len(self.pack.finders))
        if weight == 0.0:
            return total
        parts = [self.loss.energy(self.pack, g, weight, before, after) for g in range(len(total))]
        return total + torch.stack(parts).to(total)


def squared_contour_length(finder: ContourFinder, positions: Tensor) -> Tensor:
    """Sum of the squared lengths of all intersection segments, a float64 scalar [m^2].

    Differentiable as `ContourLength` says.

    Args:
        finder: finds the segments of one garment.
        positions: (vertices, 3) [m] of that garment.
    """
    positions = positions.to(torch.float64)
    contours = finder.find(positions.detach().cpu().numpy())
    edges, faces, segments = (
        torch.from_numpy(values).to(positions.device)
        for values in (contours.edges, finder.topology.faces[contours.faces], contours.segments)
    )
    p, q = positions[edges[:, 0]], positions[edges[:, 1]]
    a, b, c = (positions[faces[:, corner]] for corner in range(3))
    normal = torch.linalg.cross(b - a, c - a)
    above, below = ((p - a) * normal).sum(dim=1), ((q - a) * normal).sum(dim=1)
    points = p.detach() + (above / (above - below))[:, None] * (q - p).detach()
    ends = points[segments]
    return (ends[:, 1] - ends[:, 0]).square().sum()
