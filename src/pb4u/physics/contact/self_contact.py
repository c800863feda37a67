"""Cloth against cloth: what the solver and every other move of a garment know of it.

Two promises: no step of any kind carries one element of cloth through another, and none leaves two nearer than
`SMALLEST_GAP`. They hold from any positions that cross nowhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.collision_free import (
    free_shares,
    met_by_obstacles,
    past_obstacles,
    smallest_gap,
    through_obstacle,
)
from pb4u.collision.element_distance import crossing_shares, gather, nearest
from pb4u.collision.element_pairs import ElementPairs
from pb4u.collision.jit import as_float64, compiled
from pb4u.scene.packed import PackedGarments

if TYPE_CHECKING:
    from pb4u.physics.contact.obstacle import Obstacle

_SHARE_OF_REST = 0.5
"""Share of their distance at rest within which two elements of one garment feel each other: at rest none does."""

_PARALLEL = 1e-3
"""Squared sine of the angle between two edges from which on they feel each other in full: 1.8 degrees."""

_BODY_REACH = 5e-4
"""Distance [m] at which elements of cloth and of a body begin to feel each other; vertices do from 2 mm on."""

_PRESSED = 0.2
"""Share of the room between two elements below which they count as pressed no harder: nearer is a pinch, not a load."""


@dataclass(frozen=True, eq=False)
class ClothPairs:
    """Pairs of cloth elements that may touch, and what their contact is weighed by.

    Bodies are elements as well where there is an obstacle: their vertices follow those of the cloth.

    Args:
        pairs: vertex and face, and edge and edge.
        gaps: (pairs,) [m] smallest allowed distances.
        reaches: (pairs,) [m] distances below which they repel each other.
        areas: (pairs,) [m^2] of cloth represented by each pair.
        parallels: (pairs,) squared cross product [m^4] below which two edges count as parallel; 0 for the others.
        obstacle: the bodies, or None.
    """

    pairs: ElementPairs
    gaps: np.ndarray
    reaches: np.ndarray
    areas: np.ndarray
    parallels: np.ndarray
    obstacle: Obstacle | None = None

    @staticmethod
    def along(
        garments: PackedGarments,
        x: Tensor,
        moves: Tensor | None,
        before: Tensor,
        reach: float,
        known: ClothPairs | None = None,
        obstacle: Obstacle | None = None,
    ) -> ClothPairs:
        """All pairs that come within `reach` during the displacement `moves`.

        Args:
            garments: the garments with these elements.
            x: (vertices, 3) [m].
            moves: (vertices, 3) [m] linear displacements from these positions; None for none.
            before: (vertices, 3) [m] positions without crossings, at the start of the step.
            reach: distance [m].
            known: pairs of positions a little before these, or None.
            obstacle: the bodies, which move while the cloth does; None for none.
        """
        tree = garments.surface_tree if obstacle is None else obstacle.tree
        way = None if moves is None else as_float64(moves)
        points, began, areas = as_float64(x), as_float64(before), garments.vertex_areas.detach().cpu().numpy()
        if obstacle is not None:
            still = np.zeros_like(points) if way is None else way
            way = np.concatenate([still, obstacle.moves])
            points, began = (np.concatenate([of, obstacle.before]) for of in (points, began))
            areas = np.concatenate([areas, obstacle.areas])
        near = None if known is None else known.pairs
        among = None
        if garments.part_of is not None:
            among = np.zeros(len(points), dtype=bool)
            among[: len(x)] = ~garments.pinned.numpy()
        pairs = tree.pairs(points, reach, way, near, lasting=True, among=among, obstacle_reach=_BODY_REACH)
        if obstacle is not None and obstacle.passed.any():
            pairs = pairs.chosen(~through_obstacle(pairs.corners, tree.first_obstacle, obstacle.passed))
        law = _contact_law(
            points,
            began,
            pairs.corners,
            pairs.vertex_faces,
            pairs.rest_distance,
            tree.first_obstacle,
            areas,
            tree.rest,
            reach,
        )
        return ClothPairs(pairs, *law, obstacle)

    def joined(self, x: np.ndarray, *, before: bool = False) -> np.ndarray:
        """Cloth at `x` (vertices, 3) [m] and the bodies as one (vertices + body vertices, 3) [m].

        Args:
            x: (vertices, 3) float64 [m].
            before: whether to take the bodies at the start of the step, not at its end.
        """
        if self.obstacle is None:
            return x
        return np.concatenate([x, self.obstacle.before if before else self.obstacle.after])

    def sides(self, vertex_count: int) -> np.ndarray:
        """A vertex of the cloth (pairs, 2) int64 of each element; of an obstacle's, that of the other element.

        Args:
            vertex_count: number of vertices of the cloth.
        """
        return _sides(self.pairs.corners, vertex_count)

    def touching(self, x: Tensor) -> TouchingCloth | None:
        """The pairs that repel each other at `x` (vertices, 3) [m], or None; with bodies at the start of the step.

        Args:
            x: (vertices, 3) [m].
        """
        points = self.joined(as_float64(x), before=True)
        distances, weights, normals = self.pairs.nearest(points)
        rows = distances < self.reaches
        if not rows.any():
            return None
        corners, weights = self.pairs.corners[rows], weights[rows]
        areas = self.areas[rows] * crossing_shares(points, corners, self.parallels[rows])
        carried, sides = np.zeros((len(corners), 3)), _sides(corners, len(x))
        if self.obstacle is not None:
            moves = np.concatenate([np.zeros((len(x), 3)), self.obstacle.moves])
            carried = np.einsum("pk,pki->pi", weights, moves[corners])
            own = corners < len(x)
            corners, weights = np.where(own, corners, 0), np.where(own, weights, 0.0)
        return TouchingCloth(
            corners, weights, normals[rows], distances[rows], self.gaps[rows], self.reaches[rows], areas, carried, sides
        )


@compiled
def _contact_law(
    points: np.ndarray,
    began: np.ndarray,
    corners: np.ndarray,
    vertex_faces: int,
    rest_distances: np.ndarray,
    first_obstacle: int,
    areas: np.ndarray,
    rest: np.ndarray,
    reach: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gaps, reaches, areas and parallels (pairs,) of `ClothPairs` for the elements at `corners` (pairs, 4).

    Of `points` (vertices, 3) [m] where a move begins, those where the step `began`, and vertices of so large `areas`
    (vertices,) [m^2].
    """
    corner_points, weights, between = np.empty((4, 3)), np.empty(4), np.empty(3)
    count = len(corners)
    gaps, reaches, shares, parallels = np.empty(count), np.empty(count), np.empty(count), np.zeros(count)
    for pair in range(count):
        a, b, c, d = corners[pair, 0], corners[pair, 1], corners[pair, 2], corners[pair, 3]
        mixed, vertex_face = corners[pair].max() >= first_obstacle, pair < vertex_faces
        # What is near now, where the bodies are, says how near it may come; where the step began they were others.
        gather(points if mixed else began, corners[pair], corner_points)
        distance = nearest(corner_points, vertex_face, weights, between)
        gaps[pair] = smallest_gap(rest_distances[pair], distance, mixed)
        # An integral over the cloth is met once from the vertices of each side and once from the edges of each.
        if mixed:
            reaches[pair] = _BODY_REACH
            share = np.sqrt((0.5 * (areas[a] + areas[b])) * (0.5 * (areas[c] + areas[d])))
            shares[pair] = 0.25 * (areas[a] if vertex_face else share)
        else:
            reaches[pair] = max(min(reach, _SHARE_OF_REST * rest_distances[pair]), 2.0 * gaps[pair])
            shares[pair] = 0.25 * (0.25 * (areas[a] + areas[b] + areas[c] + areas[d]))
        if not vertex_face:
            one, other = 0.0, 0.0
            for axis in range(3):
                one += (rest[b, axis] - rest[a, axis]) ** 2
                other += (rest[d, axis] - rest[c, axis]) ** 2
            parallels[pair] = _PARALLEL * (one * other)
    return gaps, reaches, shares, parallels


def _sides(corners: np.ndarray, vertex_count: int) -> np.ndarray:
    first, second = corners[:, 0], corners[:, 2]
    return np.column_stack(
        [np.where(first < vertex_count, first, second), np.where(second < vertex_count, second, first)]
    )


@dataclass(frozen=True, eq=False)
class TouchingCloth:
    """Pairs of cloth elements that repel each other at one instant.

    Args:
        corners: (pairs, 4) int64.
        weights: (pairs, 4) with which the corners sum to the vector between the nearest points.
        normals: (pairs, 3) unit vectors along it.
        distances: (pairs,) [m].
        gaps: (pairs,) [m] smallest allowed distances.
        reaches: (pairs,) [m] distances below which they repel each other.
        areas: (pairs,) [m^2] of cloth represented by each pair, less for edges that are nearly parallel.
        carried: (pairs, 3) [m] slip during the step caused by the motion of bodies alone.
        sides: (pairs, 2) int64 a vertex of each element, of bodies that of the other.
    """

    corners: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    distances: np.ndarray
    gaps: np.ndarray
    reaches: np.ndarray
    areas: np.ndarray
    carried: np.ndarray
    sides: np.ndarray

    @cached_property
    def pressures(self) -> np.ndarray:
        """Pressure (pairs,) of the barrier over its stiffness; minus its derivative by the share of the room."""
        s = np.clip((self.distances - self.gaps) / (self.reaches - self.gaps), _PRESSED, 1.0)
        return (1.0 - s) ** 2 / s - 2.0 * (1.0 - s) * np.log(s)


@dataclass(frozen=True)
class CollisionFree:
    """Cloth stays apart from cloth, within a garment and between the garments of a world.

    Args:
        reach: distance [m] below which elements repel each other.
        feels_bodies: whether cloth stays apart from bodies too, except where they leave it no room.
        pressed_by_bodies: whether their faces and edges press it.
    """

    reach: float = 2e-3
    feels_bodies: bool = False
    pressed_by_bodies: bool = False

    def pairs(
        self,
        garments: PackedGarments,
        x: Tensor,
        moves: Tensor | None,
        before: Tensor,
        known: ClothPairs | None = None,
        obstacle: Obstacle | None = None,
    ) -> ClothPairs:
        """Pairs that repel each other somewhere along the displacement `moves`, as in `ClothPairs.along`.

        Args:
            garments: the packed garments.
            x: (vertices, 3) [m].
            moves: (vertices, 3) [m] displacements; None where nothing moves.
            before: (vertices, 3) [m] at the start of the step.
            known: pairs found earlier, if any.
            obstacle: the moving bodies; None without.
        """
        return ClothPairs.along(garments, x, moves, before, self.reach, known, obstacle)

    def collision_free_move(
        self,
        garments: PackedGarments,
        before: Tensor,
        wanted: Tensor,
        cloth: ClothPairs | None = None,
        held: Tensor | None = None,
        obstacle: Obstacle | None = None,
        apart: bool = False,
    ) -> tuple[Tensor, Obstacle | None]:
        """Positions (vertices, 3) [m] near `wanted` that cloth reaches without passing through cloth or a body.

        Returns `wanted` itself if no cloth touches, and the obstacle at the end of the step, ignoring contacts for
        which it leaves no room.

        Args:
            garments: static quantities.
            before: (vertices, 3) [m] that cross nowhere.
            wanted: (vertices, 3) [m].
            cloth: all pairs that may touch during the move, if they were found before.
            held: (vertices,) bool, vertices that collisions do not move, like pinned ones; None for none.
            obstacle: the bodies, which move while the cloth does; None for none.
            apart: whether cloth is known to reach `wanted` from `before` without touching cloth: then only cloth that
                the bodies deflect is tested for this again.
        """
        masses = garments.impulse_masses
        if held is not None:
            masses = np.where(held.numpy(), np.inf, masses)
        begun, asked = as_float64(before), as_float64(wanted)
        known = None if cloth is None else (cloth.pairs, cloth.gaps)
        if obstacle is None:
            result = past_obstacles(garments.surface_tree, begun, asked, masses, known)[0]
            return wanted if result is asked else torch.from_numpy(result).to(wanted), None
        begun, whole = np.concatenate([begun, obstacle.before]), np.concatenate([asked, obstacle.after])
        if apart:
            known = met_by_obstacles(obstacle.tree, begun, whole, obstacle.passed)
        masses = np.concatenate([masses, np.full(len(obstacle.areas), np.inf)])
        result, passed = past_obstacles(obstacle.tree, begun, whole, masses, known, obstacle.passed)
        reached = wanted if result is whole else torch.from_numpy(result[: len(asked)].copy()).to(wanted)
        return reached, obstacle.standing(passed)

    def shares(self, garments: PackedGarments, cloth: ClothPairs | None, x: Tensor, moves: Tensor) -> Tensor:
        """Shares (worlds,) in [0, 1] of the linear displacements `moves` that each world can make without collision.

        Args:
            garments: static quantities.
            cloth: all pairs that may touch during the move.
            x: (vertices, 3) [m] that cross nowhere.
            moves: (vertices, 3) [m].
        """
        result = x.new_ones(garments.world_count)
        if cloth is None or not len(cloth.pairs):
            return result
        way = as_float64(moves)
        if cloth.obstacle is not None:
            way = np.concatenate([way, cloth.obstacle.moves])
        free = torch.from_numpy(free_shares(cloth.pairs, cloth.gaps, cloth.joined(as_float64(x), before=True), way))
        world = garments.vertex_world[torch.from_numpy(cloth.sides(len(x))[:, 0])]
        return result.scatter_reduce(0, world, free.to(x), "amin")
