"""World edges: from each garment vertex to the body vertices near it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec

import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.scene.packed import PackedColliders


@dataclass(frozen=True)
class WorldEdgeRule:
    """Rule for the body vertices that a garment vertex has edges to.

    Args:
        radius: largest distance [m] (paper: a threshold; reference 1.4: 3 cm).
        neighbours: number of the nearest that are taken; 1 in the released code, a large number for all within the
            radius, as in the paper.
        whole_body: whether body vertices left out of contact are searched as well, and edges to them dropped, as in the
            released code: what is nearest to one of them has no edge.

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

    def searched(self, colliders: PackedColliders) -> tuple[Tensor, ...]:
        """Indices (vertices,) int64 of the packed body vertices of each world that the nearest are sought among."""
        if not self.whole_body:
            return colliders.touchable
        rows = colliders.world_vertices
        return tuple(torch.arange(own.start, own.stop, device=colliders.contact.device) for own in rows)


@torch.no_grad()
def nearest_within(points: Tensor, targets: Tensor, rule: WorldEdgeRule) -> tuple[Tensor, Tensor]:
    """Indices (points, neighbours) int64 of the nearest targets of each point, and flags of those within the radius.

    Nearest first; absent ones are index 0. By a tree on the CPU, by all distances on an accelerator or without scipy.

    Args:
        points: (points, 3) [m]; one that is not finite is near nothing.
        targets: (targets, 3) [m], finite.
        rule: radius and number of neighbours.
    """
    if targets.shape[0] == 0:
        return _none(points, rule)
    if points.device.type == "cpu" and _has_scipy():
        return _nearest_by_tree(points, targets, rule)
    return _nearest_by_chunks(points, targets, rule)


@cache
def _has_scipy() -> bool:
    """Whether the tree is installed; machines that only train make do without."""
    return find_spec("scipy") is not None


def _none(points: Tensor, rule: WorldEdgeRule) -> tuple[Tensor, Tensor]:
    index = torch.zeros(len(points), rule.neighbours, dtype=torch.int64, device=points.device)
    return index, torch.zeros_like(index, dtype=torch.bool)


def _nearest_by_tree(points: Tensor, targets: Tensor, rule: WorldEdgeRule) -> tuple[Tensor, Tensor]:
    from scipy.spatial import cKDTree

    # The tree refuses what is not finite; 1e9 m is near nothing.
    cloud, queries = targets.numpy(), torch.where(torch.isfinite(points), points, 1e9).numpy()
    near = ((cloud >= queries.min(axis=0) - rule.radius) & (cloud <= queries.max(axis=0) + rule.radius)).all(axis=1)
    kept = near.nonzero()[0]
    wanted = list(range(1, rule.neighbours + 1))
    if len(kept) == 0:
        return _none(points, rule)
    tree = cKDTree(cloud[kept], balanced_tree=False, compact_nodes=False)
    _, index = tree.query(queries, k=wanted, distance_upper_bound=rule.radius)
    within = index < len(kept)
    index[~within] = 0
    return torch.from_numpy(kept[index]), torch.from_numpy(within)


def _nearest_by_chunks(points: Tensor, targets: Tensor, rule: WorldEdgeRule, rows: int = 4096) -> tuple[Tensor, Tensor]:
    # Rows at once: against 20,000 targets their distances take 330 MB in float32.
    wanted = min(rule.neighbours, targets.shape[0])
    indices, distances = [], []
    for start in range(0, points.shape[0], rows):
        block = points[start : start + rows]
        distance = torch.cdist(block, targets, compute_mode="donot_use_mm_for_euclid_dist")
        best, index = distance.topk(wanted, dim=1, largest=False)
        indices.append(index)
        distances.append(best)
    missing = (0, rule.neighbours - wanted)
    index = torch.nn.functional.pad(torch.cat(indices), missing)
    within = torch.nn.functional.pad(torch.cat(distances) <= rule.radius, missing)
    return torch.where(within, index, 0), within
