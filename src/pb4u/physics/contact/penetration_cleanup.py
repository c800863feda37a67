"""Penetration clean-up: moves cloth off the skin where it dips into the body between its corners, or skin pierces it.

Energies and contact response look at vertices. On a body of radius R an edge of length L sags L^2 / (8 R) below its
ends: 1.5 mm for the 27 mm edges of a 2.5K T-shirt on a shoulder, more than the distance cloth keeps from the skin.
Between the middles that are looked at, a quarter of that is left: L^2 / (32 R), which is added to their clearance.
Where the body is rounder than R, or bends at a joint, its vertices still come through between the middles: these are
queried in turn, and the cloth that they pierce is lifted over them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.collision.nearest_points import Found
from pb4u.collision.nearest_surface import PosedSurface
from pb4u.collision.surface_elements import any_corner
from pb4u.physics.contact.contact_set import MOTION_REACH, ContactPlanes, nearest_planes
from pb4u.physics.contact.obstacle import Obstacle
from pb4u.physics.contact.penetration_loops import (
    add_lifts,
    carry_found,
    cut_back,
    may_be_near,
    move_vertices,
    vertices_within,
)
from pb4u.physics.contact.self_contact import CollisionFree
from pb4u.physics.contact.skin_cover import SKIN_OVER_CLOTH, SkinCover
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
        passes: most passes, since a lifted vertex lifts what is beside it too; clothes of 2,500 and 11,000 triangles
            need two to six.
        most_stretch: length over the length at rest up to which an edge is stretched by it. Straps over a shoulder
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
            cloth: keeps the move from taking cloth through cloth.
        """
        if not _touched(garments, pose):
            return state
        planes = nearest_planes(pose, garments, state.positions, MOTION_REACH)
        lifted = self._lifted(garments, pose, planes, state.positions, ~garments.pinned.numpy(), cover=True)
        return replace(state, positions=self._without_harm(garments, pose, state.positions, lifted, planes, cloth))

    def pins_clear(self, garments: PackedGarments, pose: ColliderPose, x: Tensor) -> Tensor:
        """Positions (vertices, 3) [m] with pinned vertices, and what lies between them, moved out of the bodies.

        A pin that this would take deeper into another part of a body stays where it is.

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
        x, worlds = as_float64(before).copy(), _touched(garments, pose)
        elements = [part for world in worlds for part in self._near(garments, pose, planes, x, world)]
        skin: list[_Skin] = []
        if cover:
            skin = [_skin(pose.surfaces[world], x, garments.world_vertices[world]) for world in worlds]
        else:
            elements = [part.chosen(movable[part.corners].all(axis=1)) for part in elements]
        lift = _Lift(np.zeros_like(x), np.zeros(len(x)))
        for _ in range(self.passes):
            moved, lift = lift.size, _Lift(np.zeros_like(x), np.zeros(len(x)))
            elements = [self._lift_middles(lift, x, part) for part in elements]
            for place, (world, places) in enumerate(zip(worlds, skin, strict=False)):
                skin[place] = self._cover(lift, garments, x, moved, world, places)
            if not move_vertices(x, *lift, movable, _LARGEST_PUSH):
                break
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

    def _near(
        self, garments: PackedGarments, pose: ColliderPose, planes: ContactPlanes, x: np.ndarray, world: int
    ) -> Iterator[_Middles]:
        """Vertices, edges and faces of a world whose middle may be too near to its body."""
        surface, points = pose.surfaces[world], as_float64(planes.points)
        if surface is None:
            return
        # Of what is out of reach no more is known than that.
        distances = np.minimum(as_float64(planes.distance), MOTION_REACH)
        of_world = garments.vertex_world.numpy() == world
        lengths = garments.vertex_edge_lengths.numpy()
        vertices = np.arange(len(x))[:, None]
        for corners in (vertices, garments.edges.numpy(), garments.faces.numpy()):
            sag = lengths**2 / (32.0 * _SMALLEST_RADIUS) if corners.shape[1] > 1 else 0.0
            wanted = np.where(of_world, self.clearance + sag, -np.inf)
            kept = corners[may_be_near(x, corners, distances, wanted)]
            # What is nearest to a corner bounds what is nearest to the middle.
            near = Found.nothing(len(kept), points[kept[:, 0]])
            yield _Middles(surface, len(pose.colliders.world_faces[world]), kept, wanted[kept[:, 0]], near)

    def _lift_middles(self, lift: _Lift, x: np.ndarray, middles: _Middles) -> _Middles:
        """Lift elements whose middle is too near to the body, and give back those."""
        if not len(middles.corners):
            return middles
        found = middles.found
        middles.surface.update_closest(x[middles.corners].mean(axis=1), found)
        # Where a region is left out of contact there is no skin, nor is the cap of one.
        skin = ~found.beyond & (found.triangle < middles.skin_faces)
        low = skin & (found.distances < middles.wanted)
        kept = middles.chosen(low)
        shares = np.full(kept.corners.shape, 1.0 / kept.corners.shape[1])
        add_lifts(*lift, kept.corners, shares, kept.wanted - kept.found.distances, kept.found.normals)
        return kept

    def _cover(
        self, lift: _Lift, garments: PackedGarments, x: np.ndarray, moved: np.ndarray, world: int, skin: _Skin
    ) -> _Skin:
        """Lift the faces that skin shows through; the skin that has cloth of its own near it is given back.

        Cloth is searched for again where it `moved` (vertices,) [m] since the pass before.
        """
        if not len(skin.places):
            return skin
        rows = garments.world_vertices[world]
        cloth, found = garments.surfaces[world].at(x[rows].copy()), skin.found
        faces = cloth.surface.faces
        went = any_corner(faces, moved[rows] > 0.0)
        if not skin.new:
            # Where the nearest cloth went bounds what is nearest now.
            carry_found(found, went, x[rows], faces)
            cloth.update_closest(skin.places, found)
        cloth.update_if_nearer(skin.places, found, None if skin.new else went)
        near = np.abs(found.distances) < SKIN_OVER_CLOTH
        cover = SkinCover.of(found, skin.places, skin.normals, cloth)
        low = cover.belongs & near & (cover.heights < self.clearance)
        heights = self.clearance - cover.heights[low]
        add_lifts(*lift, faces[found.triangle[low]] + rows.start, found.barycentric[low], heights, skin.normals[low])
        if near.all():
            return skin._replace(new=False)
        return _Skin(skin.places[near], skin.normals[near], found.among(near), new=False)


class _Middles(NamedTuple):
    """Elements of the cloth of one world whose middles may be too near to its body.

    Args:
        surface: of the body.
        skin_faces: number of its faces that are skin; those after them are caps.
        corners: (elements, corners) int64.
        wanted: (elements,) [m] distance that each keeps.
        found: of the body, for each middle.
    """

    surface: PosedSurface
    skin_faces: int
    corners: np.ndarray
    wanted: np.ndarray
    found: Found

    def chosen(self, rows: np.ndarray) -> _Middles:
        """Those of `rows` (elements,) bool."""
        return self._replace(corners=self.corners[rows], wanted=self.wanted[rows], found=self.found.among(rows))


class _Skin(NamedTuple):
    """Places on the skin of one world.

    Args:
        places: (places, 3) [m].
        normals: (places, 3) outward unit normals.
        found: of the cloth, for each place.
        new: whether that is a place at the end of their reach yet, and no cloth.
    """

    places: np.ndarray
    normals: np.ndarray
    found: Found
    new: bool = True


class _Lift(NamedTuple):
    """Displacements gathered over one pass.

    Args:
        direction: (vertices, 3) [m] all lifts of a vertex summed.
        size: (vertices,) [m] the largest of them.
    """

    direction: np.ndarray
    size: np.ndarray


def _touched(garments: PackedGarments, pose: ColliderPose) -> list[int]:
    """Worlds whose bodies can be touched."""
    return [world for world, surface in enumerate(pose.surfaces[: garments.world_count]) if surface is not None]


def _skin(surface: PosedSurface | None, x: np.ndarray, own: slice) -> _Skin:
    """The body's vertices around the cloth of a world, rows `own` of `x` (vertices, 3) [m], that may be touched."""
    cloth = x[own]
    if surface is None or not len(cloth):
        return _Skin(np.zeros((0, 3)), np.zeros((0, 3)), Found.nothing(0))
    low, high = cloth.min(axis=0) - SKIN_OVER_CLOTH, cloth.max(axis=0) + SKIN_OVER_CLOTH
    places, normals = vertices_within(as_float64(surface.vertices), surface.surface.region_faces, low, high)
    return _Skin(places, normals, Found.nothing(len(places), places + SKIN_OVER_CLOTH * normals))
