"""Penetration clean-up: moves cloth off the skin where it dips into the body between its corners, or skin pierces it.

Energies and contact response look at vertices. On a body of radius R an edge of length L sags L^2 / (8 R) below its
ends: 1.5 mm for the 27 mm edges of a 2.5K T-shirt on a shoulder, more than the distance cloth keeps from the skin.
Between the middles that are looked at, a quarter of that is left: L^2 / (32 R), which is added to their clearance.
Where the body is rounder than R, or bends at a joint, its vertices still come through between the middles: these are
queried in turn, and the cloth that they pierce is lifted over them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.collision.nearest_points import Found
from pb4u.physics.contact.contact_set import MOTION_REACH, ContactPlanes, nearest_planes
from pb4u.physics.contact.obstacle import Obstacle
from pb4u.physics.contact.penetration_loops import cut_back, vertices_within
from pb4u.physics.contact.penetration_passes import Body, Cloth, lifted_off
from pb4u.physics.contact.self_contact import CollisionFree
from pb4u.physics.contact.skin_cover import SKIN_OVER_CLOTH
from pb4u.scene.colliders import ColliderPose
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State

_DEEPER = 1e-3
"""Depth [m] from which on a move counts as taking a vertex into the body: less is not seen, and undoing it bares
skin."""

_ROUNDS = 8
"""Times that vertices which a move takes into the body are put back before the move is given up: up to thrice in a
squat."""

_SMALLEST_RADIUS, _LARGEST_PUSH = 0.03, 5e-3
"""Smallest radius [m] of the body where cloth rests on it, and largest displacement [m] of a vertex in one pass."""


@dataclass(frozen=True)
class FaceClearance:
    """Moves cloth along the body's normal until its vertices, the middles of its edges and faces, and skin are clear.

    Velocities stay as they are. Pinned vertices do not move.

    Args:
        clearance: distance that the cloth keeps from the surface [m].
        passes: largest number of passes, since a lifted vertex also lifts its neighbours; clothes of 2,500 and 11,000
            triangles need two to six.
        most_stretch: largest ratio of an edge's length after the lift to its rest length. Straps over a shoulder
            and sleeves of 2,500 triangles over a raised elbow need 1.55 to 1.7; what asks for more has a limb through
            it, and is not covered by pulling.
    """

    clearance: float = 3e-4
    passes: int = 6
    most_stretch: float = 1.8

    def lift(self, garments: PackedGarments, state: State, pose: ColliderPose, cloth: CollisionFree | None) -> State:
        """State with its cloth moved out of the bodies.

        Args:
            garments: static quantities.
            state: to be cleaned.
            pose: the bodies at the state's frame.
            cloth: keeps the displacement free of collisions of cloth with cloth.
        """
        if not _touched(garments, pose):
            return state
        planes = nearest_planes(pose, garments, state.positions, MOTION_REACH)
        lifted = self._lifted(garments, pose, planes, state.positions, ~garments.pinned.numpy(), cover=True)
        if np.array_equal(lifted, as_float64(state.positions)):
            return state
        return replace(state, positions=self._without_harm(garments, pose, state.positions, lifted, planes, cloth))

    def pins_clear(self, garments: PackedGarments, pose: ColliderPose, x: Tensor) -> Tensor:
        """Positions (vertices, 3) [m] with pinned vertices, and elements between them, moved out of the bodies.

        A pin that would get deeper into another part of a body is not moved.

        Args:
            garments: static quantities.
            pose: the bodies.
            x: (vertices, 3) [m].
        """
        if not _touched(garments, pose):
            return x
        planes = nearest_planes(pose, garments, x, MOTION_REACH)
        lifted = self._lifted(garments, pose, planes, x, garments.pinned.numpy(), cover=False)
        deeper = self._taken_deeper(garments, pose, as_float64(x), lifted, planes)
        return torch.where(torch.from_numpy(deeper)[:, None], x, torch.from_numpy(lifted).to(x))

    def _lifted(
        self,
        garments: PackedGarments,
        pose: ColliderPose,
        planes: ContactPlanes,
        before: Tensor,
        movable: np.ndarray,
        *,
        cover: bool,
    ) -> np.ndarray:
        """Positions (vertices, 3) [m] with the `movable` (vertices,) moved off the body; `cover`: off skin that pierces
        them too.

        Without, only what lies between these alone is looked at.
        """
        x, lengths = as_float64(before), garments.vertex_edge_lengths.numpy()
        elements = np.arange(len(x))[:, None], garments.edges.numpy(), garments.faces.numpy()
        sag, limits = lengths**2 / (32.0 * _SMALLEST_RADIUS), (self.clearance, self.passes, _LARGEST_PUSH)
        for world in _touched(garments, pose):
            skin = _skin(pose, x, garments.world_vertices[world], world) if cover else (np.zeros((0, 3)),) * 2
            body, cloth = _body(pose, planes, world), _cloth(garments, x, world)
            x = lifted_off(x, movable, not cover, elements, sag, skin, body, cloth, limits)
        return x

    def _without_harm(
        self,
        garments: PackedGarments,
        pose: ColliderPose,
        before: Tensor,
        lifted: np.ndarray,
        planes: ContactPlanes,
        cloth: CollisionFree | None,
    ) -> Tensor:
        """Positions (vertices, 3) [m] between those `before` and those `lifted`.

        What the move would take into another part of the body, strain too far, or take through cloth stays where it
        was, or part of the way.
        """
        stood, edges = as_float64(before), garments.edges.numpy()
        longest = self.most_stretch * garments.edge_lengths.numpy()
        held = self._taken_deeper(garments, pose, stood, lifted, planes)
        obstacle = Obstacle.at(garments, pose, before) if cloth is not None and cloth.feels_bodies else None
        for _ in range(_ROUNDS):
            x = cut_back(stood, lifted, np.where(held, 0.0, 1.0), edges, longest)
            wanted, firm = torch.from_numpy(x).to(before), torch.from_numpy(held)
            # What lifted cloth pushes aside goes into the body as well: what is held back stays where it is.
            reached = wanted
            if cloth is not None:
                reached, _ = cloth.collision_free_move(garments, before, wanted, held=firm, obstacle=obstacle)
            # In a fold a part of the way may lead where the whole of it does not.
            deeper = self._taken_deeper(garments, pose, stood, as_float64(reached), planes)
            if not deeper.any():
                return reached
            held |= deeper
        return before

    def _taken_deeper(
        self,
        garments: PackedGarments,
        pose: ColliderPose,
        before: np.ndarray,
        after: np.ndarray,
        planes: ContactPlanes,
    ) -> np.ndarray:
        """Vertices (vertices,) bool that are deeper in the body after a lift (vertices, 3) [m] than before it."""
        taken = np.zeros(len(before), dtype=bool)
        moved = np.abs(after - before).max(axis=1) > self.clearance
        distances = as_float64(planes.distance)
        for world, surface in enumerate(pose.surfaces[: garments.world_count]):
            rows = np.flatnonzero(moved & (garments.vertex_world.numpy() == world))
            if surface is None or not len(rows):
                continue
            found = Found.nothing(len(rows), as_float64(planes.points)[rows])
            surface.update_closest(after[rows], found)
            deeper = found.distances < np.minimum(distances[rows], 0.0) - _DEEPER
            taken[rows[~found.beyond & deeper]] = True
        return taken


def _touched(garments: PackedGarments, pose: ColliderPose) -> list[int]:
    """Worlds whose bodies can be touched."""
    return [world for world, surface in enumerate(pose.surfaces[: garments.world_count]) if surface is not None]


def _skin(pose: ColliderPose, x: np.ndarray, own: slice, world: int) -> tuple[np.ndarray, np.ndarray]:
    """The body's vertices around the cloth of a world, rows `own` of `x` (vertices, 3) [m], and their unit normals."""
    cloth, surface = x[own], pose.surfaces[world]
    if surface is None or not len(cloth):
        return np.zeros((0, 3)), np.zeros((0, 3))
    low, high = cloth.min(axis=0) - SKIN_OVER_CLOTH, cloth.max(axis=0) + SKIN_OVER_CLOTH
    return vertices_within(as_float64(surface.vertices), surface.surface.region_faces, low, high)


def _body(pose: ColliderPose, planes: ContactPlanes, world: int) -> Body:
    """The body of a world; of what is out of reach no more is known than that."""
    surface = pose.surfaces[world]
    assert surface is not None
    distances = np.minimum(as_float64(planes.distance), MOTION_REACH)
    skin_faces = len(pose.colliders.world_faces[world])
    return Body(surface.searched, surface.surface.names, skin_faces, as_float64(planes.points), distances)


def _cloth(garments: PackedGarments, x: np.ndarray, world: int) -> Cloth:
    """The cloth of a world where its vertices are, rows of `x` (vertices, 3) [m]."""
    surface, rows = garments.surfaces[world], garments.world_vertices[world]
    tree = surface.tree(x[rows])
    parts = tree.order, tree.children, tree.bottoms, tree.levels
    return Cloth(surface.faces, surface.names, surface.fans, *parts, rows.start, rows.stop)
