"""What ContourCraft minimises so that cloth keeps clear of itself, and gets out again (reference 6.3)."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from pb4u.baselines.intersection_contours import ContourFinder
from pb4u.baselines.self_proximity import garments_proximity
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True)
class Ramp:
    """A weight that rises linearly while a training goes on.

    Args:
        start, stop: fractions of the training's budget. most: weight from `stop` on; 0 before `start`.
    """

    start: float
    stop: float
    most: float

    def at(self, progress: float) -> float:
        """The weight at a fraction of the budget."""
        points = (self.start, self.stop)
        stage = bisect_right(points, progress)
        return (0.0, self.most * (progress - self.start) / max(self.stop - self.start, 1e-12), self.most)[stage]


@dataclass(frozen=True)
class Repulsion:
    """Sum over vertices and the faces they stand over of w A_i / A_ref max(eps - s d, 0)^3 [J].

    d is the height over the face's plane after the step, s its sign before it: who was outside stays outside. The
    vertex area A_i over `reference_area` makes it the same at every resolution, as our collisions are.

    Args:
        weight: w [J/m^3]. clearance: eps [m]. reach: height before the step up to which a pair counts [m].
        reference_area: A_ref [m^2].
    """

    weight: Ramp = field(default_factory=lambda: Ramp(30 / 56, 40 / 56, 2e6))
    clearance: float = 3e-3
    reach: float = 1e-2
    reference_area: float = 1.6e-4
    name = "repulsion"

    def energies(self, garments: PackedGarments, before: Tensor, after: Tensor, progress: float) -> Tensor:
        """(garments,) [J]; see `FurtherLoss`."""
        weight, total = self.weight.at(progress), _zeros(garments, after)
        if weight == 0.0:
            return total
        points = before.detach().to("cpu", torch.float64).numpy()
        parts = []
        for garment, proximity in enumerate(garments_proximity(garments, self.reach)):
            start, stop = garments.vertex_offsets[garment : garment + 2]
            facing = proximity.find(points[start:stop])
            kept = ~facing.attracted
            vertices, faces, side = (
                torch.from_numpy(values[kept]).to(after.device)
                for values in (facing.vertices + start, proximity.faces[facing.faces] + start, np.sign(facing.heights))
            )
            a, b, c = (after[faces[:, corner]] for corner in range(3))
            normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-12)
            height = side.to(after) * ((after[vertices] - a) * normal).sum(dim=1)
            share = garments.vertex_areas[vertices].to(after) / self.reference_area
            parts.append((weight * share * (self.clearance - height).clamp_min(0.0) ** 3).sum())
        return total + torch.stack(parts)


@dataclass(frozen=True)
class ContourLength:
    """w times the squared lengths of the segments in which the cloth meets itself after the step [J].

    Only the places along the edges where they cross faces are differentiated; the ends of the edges are taken as fixed
    (reference 6.3).

    Args:
        weight: w [J/m^2].
    """

    weight: Ramp = field(default_factory=lambda: Ramp(45 / 56, 50 / 56, 1e7))
    name = "contours"

    def energies(self, garments: PackedGarments, before: Tensor, after: Tensor, progress: float) -> Tensor:
        """(garments,) [J]; see `FurtherLoss`."""
        weight, total = self.weight.at(progress), _zeros(garments, after)
        if weight == 0.0:
            return total
        parts = []
        for garment, proximity in enumerate(garments_proximity(garments, 0.0)):
            start, stop = garments.vertex_offsets[garment : garment + 2]
            parts.append(weight * squared_contour_length(proximity.contours, after[start:stop]))
        return total + torch.stack(parts).to(total)


def squared_contour_length(finder: ContourFinder, positions: Tensor) -> Tensor:
    """Sum of the squared lengths [m^2] of all segments at `positions` (vertices, 3) [m], in float64.

    Differentiable as `ContourLength` says.
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


def _zeros(garments: PackedGarments, like: Tensor) -> Tensor:
    return like.new_zeros(garments.garment_count)
