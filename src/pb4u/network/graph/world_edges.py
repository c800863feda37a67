"""World edges: from each garment vertex to the body vertices near it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.collision.batched_surface import GROUP, Balls, Groups
from pb4u.collision.capacities import Capacities, found_rows
from pb4u.collision.near_vertices import nearest_vertices
from pb4u.errors import InputError
from pb4u.scene.colliders import PackedColliders


@dataclass(frozen=True)
class WorldEdgeRule:
    """Rule for the body vertices that a garment vertex has edges to.

    Args:
        radius: largest distance [m] (paper: a threshold; reference 1.4: 3 cm).
        neighbours: number of nearest vertices to join; 1 in the released code, a large number for all within the
            radius, as in the paper.
        whole_body: whether body vertices left out of contact are searched as well and edges to them dropped, as in the
            released code: a vertex nearest to one of them then has no edge.

    Raises:
        InputError: a radius that is not above 0 and finite, or neighbours not from 1 to 64.
    """

    radius: float = 0.03
    neighbours: int = 1
    whole_body: bool = False

    def __post_init__(self) -> None:
        if not (0.0 < self.radius < float("inf")) or not 1 <= self.neighbours <= 64:
            raise InputError(
                f"World edges need a radius above 0 m and 1 to 64 neighbours, not {self.radius} m and "
                f"{self.neighbours}."
            )

    def pairs(self, points: Tensor, body: Tensor, colliders: PackedColliders, world: int) -> tuple[Tensor, Tensor]:
        """Garment vertex and body vertex, (pairs,) int64 each, that are joined in one world.

        Args:
            points: (points, 3) garment vertices of the world [m].
            body: (vertices, 3) of all bodies [m].
            colliders: static quantities of the bodies.
            world: number of the world.
        """
        block = colliders.world_vertices[world]
        all_rows = torch.arange(block.start, block.stop, device=points.device)
        searched = all_rows if self.whole_body else colliders.touchable[world]
        index, within = nearest_within(points, body[searched], self)
        rows = torch.arange(len(points), device=index.device).repeat_interleave(index.shape[1])
        return rows[within.reshape(-1)], searched[index[within]]

    def batched_pairs(
        self, points: Tensor, body: Tensor, groups: Groups, capacities: Capacities | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The same for all worlds at once, only with tensors: row of the points, body vertex, and whether the entry is
        used.

        Args:
            points: (worlds, points, 3) [m]; points that are not finite have no neighbours.
            body: (vertices, 3) of all bodies [m].
            groups: vertices of each world that may be touched.
            capacities: fixed array sizes; unused entries come last and point to row 0.
        """
        points, body, count = points.to(torch.float64), body.to(torch.float64), groups.items.shape[1]
        flat, balls = points.reshape(-1, 3), Balls.around(body[groups.items])
        reached = balls.within(points, torch.full_like(points[..., 0], self.radius))
        pairs, filled = found_rows(reached, "groups of body vertices", capacities)
        row = pairs // count
        group = row // points.shape[1] * count + pairs % count
        near, real = groups.items.flatten(0, 1)[group], groups.filled.flatten(0, 1)[group] & filled[:, None]
        squares = (body[near] - flat[row, None]).square().sum(-1)
        pairs, filled = found_rows((squares < self.radius**2) & real, "near body vertices", capacities)
        row, near, squares = row[pairs // GROUP], near.reshape(-1)[pairs], squares.reshape(-1)[pairs]
        # Nearest first within each point; those over go last.
        row = torch.where(filled, row, len(flat))
        order = torch.argsort(squares)
        order = order[torch.argsort(row[order], stable=True)]
        row, near = row[order], near[order]
        rank = torch.arange(len(row), device=row.device) - torch.searchsorted(row, row)
        places, filled = found_rows((rank < self.neighbours) & (row < len(flat)), "world edges", capacities)
        return row[places].clamp_max(len(flat) - 1), near[places], filled


@dataclass(frozen=True)
class NearestFaceRule:
    """Rule of the released ContourCraft: the nearest corner of the nearest face of the body.

    Args:
        radius: largest distance from the face [m].

    Raises:
        InputError: a radius that is not above 0 and finite.
    """

    radius: float = 0.03

    def __post_init__(self) -> None:
        WorldEdgeRule(self.radius)

    def pairs(self, points: Tensor, body: Tensor, colliders: PackedColliders, world: int) -> tuple[Tensor, Tensor]:
        """Garment vertex and body vertex, (pairs,) int64 each, that are joined in one world; see `WorldEdgeRule`.

        Args:
            points: (vertices, 3) [m] of the garments of the world.
            body: (body vertices, 3) [m].
            colliders: the packed bodies.
            world: number of the world.
        """
        surface, rows = colliders.whole_surfaces[world], torch.nonzero(torch.isfinite(points).all(dim=1))[:, 0]
        if surface is None or not len(rows):
            return rows[:0], rows[:0]
        nearest = surface.at(body[colliders.world_vertices[world]]).nearest(points[rows])
        within = (nearest.positions - points[rows]).norm(dim=1) <= self.radius
        rows, triangle = rows[within], nearest.triangle[within]
        corners = colliders.faces[colliders.world_faces[world]][triangle]
        away = (body[corners] - points[rows][:, None]).norm(dim=2)
        return rows, corners.gather(1, away.argmin(dim=1, keepdim=True))[:, 0]


@torch.no_grad()
def nearest_within(points: Tensor, targets: Tensor, rule: WorldEdgeRule) -> tuple[Tensor, Tensor]:
    """Indices (points, neighbours) int64 of the nearest targets of each point, and flags of those within the radius.

    Nearest first; absent ones are index 0. By a grid on the CPU, by all distances on an accelerator.

    Args:
        points: (points, 3) [m]; points that are not finite have no neighbours.
        targets: (targets, 3) [m], finite.
        rule: radius and number of neighbours.
    """
    if targets.shape[0] == 0:
        return _none(points, rule)
    return (_nearest_by_grid if points.device.type == "cpu" else _nearest_by_chunks)(points, targets, rule)


def _none(points: Tensor, rule: WorldEdgeRule) -> tuple[Tensor, Tensor]:
    index = torch.zeros(len(points), rule.neighbours, dtype=torch.int64, device=points.device)
    return index, torch.zeros_like(index, dtype=torch.bool)


def _nearest_by_grid(points: Tensor, targets: Tensor, rule: WorldEdgeRule) -> tuple[Tensor, Tensor]:
    index = torch.empty(len(points), rule.neighbours, dtype=torch.int64)
    nearest_vertices(points.contiguous().numpy(), targets.contiguous().numpy(), rule.radius, index.numpy())
    within = index >= 0
    return index.clamp_min_(0), within


def _nearest_by_chunks(points: Tensor, targets: Tensor, rule: WorldEdgeRule, rows: int = 4096) -> tuple[Tensor, Tensor]:
    # Rows at once: against 20,000 targets their distances take 330 MB in float32.
    neighbours = min(rule.neighbours, targets.shape[0])
    indices, distances = [], []
    for start in range(0, points.shape[0], rows):
        block = points[start : start + rows]
        distance = torch.cdist(block, targets, compute_mode="donot_use_mm_for_euclid_dist")
        best, index = distance.topk(neighbours, dim=1, largest=False)
        indices.append(index)
        distances.append(best)
    missing = (0, rule.neighbours - neighbours)
    index = torch.nn.functional.pad(torch.cat(indices), missing)
    within = torch.nn.functional.pad(torch.cat(distances) <= rule.radius, missing)
    return torch.where(within, index, 0), within
