"""Keeps the body from showing through cloth: lifts cloth that dips into it between its corners, or that skin pierces.

Energies and contact response look at vertices. On a body of radius R an edge of length L sags L^2 / (8 R) below its
ends: 1.5 mm for the 27 mm edges of a 2.5K T-shirt on a shoulder, more than the distance cloth keeps from the skin.
Between the middles that are looked at, a quarter of that is left: L^2 / (32 R), which is added to their clearance.
Where the body is rounder than R, or bends at a joint, its vertices still come through between the middles: these are
looked up in turn, and the cloth that they pierce is lifted over them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pb4u.geometry.triangle_mesh import area_weighted_normals
from pb4u.physics.contact.planes import clearances, nearest_planes
from pb4u.physics.contact.self_contact import as_array
from pb4u.physics.contact.skin_cover import SKIN_OVER_CLOTH, SkinCover
from pb4u.scene.packed import ColliderPose, PackedGarments
from pb4u.scene.state import State


@dataclass(frozen=True)
class FaceClearance:
    """Moves cloth along the body's normal until its vertices, the middles of its edges and faces, and skin are clear.

    Velocities stay as they are. Pinned vertices do not move.

    Args:
        clearance: distance that the cloth keeps from the surface [m].
        smallest_radius: smallest radius of the body where cloth rests on it [m].
        largest_push: largest displacement of a vertex in one pass [m].
        passes: most passes, since a lifted vertex lifts what is beside it too; clothes of 2,500 and 11,000 triangles
            need two to six.
    """

    clearance: float = 3e-4
    smallest_radius: float = 0.03
    largest_push: float = 5e-3
    passes: int = 6

    def lift(self, garments: PackedGarments, state: State, pose: ColliderPose) -> State:
        """State with its cloth lifted out of the bodies.

        Args:
            garments: static quantities.
            state: to be lifted.
            pose: the bodies at the state's frame.
        """
        if not len(pose.colliders.faces):
            return state
        x = state.positions
        elements, skin = self._near(garments, pose, x), list(_skin(garments, pose, x))
        for _ in range(self.passes):
            lift = _Lift(x)
            elements = [self._lift_middles(lift, garments, pose, corners) for corners in elements]
            for world, places in enumerate(skin):
                skin[world] = self._cover(lift, garments, world, places)
            moves = lift.displacements(garments.pinned, self.largest_push)
            if not bool(moves.any()):
                break
            x = x + moves
        return replace(state, positions=x)

    def _near(self, garments: PackedGarments, pose: ColliderPose, x: Tensor) -> list[Tensor]:
        """Vertices, edges and faces (elements, corners) whose middle may be too near to the body."""
        distance = nearest_planes(pose, garments, x).distance
        vertices = torch.arange(len(x), device=x.device)[:, None]
        kept = []
        for corners in (vertices, garments.edges, garments.faces):
            at = x[corners]
            # A distance changes by no more than the way.
            least = (distance[corners] - (at - at.mean(1, keepdim=True)).norm(dim=2)).amax(1)
            kept.append(corners[least < self._wanted(garments, corners, x)])
        return kept

    def _wanted(self, garments: PackedGarments, corners: Tensor, x: Tensor) -> Tensor:
        """Distances (elements,) [m] that the middles of elements (elements, corners) keep from the body."""
        lengths = x.new_tensor(garments.mean_edge_lengths)
        sag = lengths.square() / (32.0 * self.smallest_radius) if corners.shape[1] > 1 else torch.zeros_like(lengths)
        return self.clearance + sag[garments.vertex_garment[corners[:, 0]]]

    def _lift_middles(self, lift: _Lift, garments: PackedGarments, pose: ColliderPose, corners: Tensor) -> Tensor:
        """Lift elements (elements, corners) whose middle is too near to the body, and give back those."""
        if not len(corners):
            return corners
        wanted, world = self._wanted(garments, corners, lift.x), garments.vertex_world[corners[:, 0]]
        distance, normals = clearances(pose, lift.x[corners].mean(1), world)
        low = distance < wanted
        shares = lift.x.new_full((int(low.sum()), corners.shape[1]), 1.0 / corners.shape[1])
        lift.add(corners[low], shares, (wanted - distance)[low], normals[low])
        return corners[low]

    def _cover(self, lift: _Lift, garments: PackedGarments, world: int, skin: _Skin) -> _Skin:
        """Lift the faces that skin shows through; the skin that has cloth of its own near it is given back."""
        if not len(skin.places):
            return skin
        first, stop = garments.world_offsets[world : world + 2]
        surface = garments.surfaces[world]
        cover = SkinCover.at(skin.places, skin.normals, surface.at(as_array(lift.x[first:stop])))
        low = cover.belongs & (cover.distances < SKIN_OVER_CLOTH) & (cover.heights < self.clearance)
        lift.add(
            torch.from_numpy(surface.faces[cover.faces[low]] + first).to(lift.x.device),
            torch.from_numpy(cover.barycentric[low]).to(lift.x),
            torch.from_numpy(self.clearance - cover.heights[low]).to(lift.x),
            torch.from_numpy(skin.normals[low]).to(lift.x),
        )
        near = cover.distances < SKIN_OVER_CLOTH
        return _Skin(skin.places[near], skin.normals[near])


class _Skin(NamedTuple):
    """Places (places, 3) on the skin of one world [m], and outward unit normals there."""

    places: np.ndarray
    normals: np.ndarray


def _skin(garments: PackedGarments, pose: ColliderPose, x: Tensor) -> Iterator[_Skin]:
    """The body's vertices around the cloth of each world that may be touched."""
    for world, surface in enumerate(pose.surfaces):
        first, stop = garments.world_offsets[world : world + 2]
        if surface is None or first == stop:
            yield _Skin(np.zeros((0, 3)), np.zeros((0, 3)))
            continue
        body, cloth = surface.vertices.numpy(force=True), as_array(x[first:stop])
        faces = surface.surface.region_faces
        low, high = cloth.min(axis=0) - SKIN_OVER_CLOTH, cloth.max(axis=0) + SKIN_OVER_CLOTH
        inside = ((body >= low) & (body <= high)).all(axis=1)
        # Their normals need the faces around them alone.
        faces = faces[inside[faces].any(axis=1)]
        used = np.zeros(len(body), dtype=bool)
        used[faces.ravel()] = True
        around = np.flatnonzero(used & inside)
        yield _Skin(body[around], area_weighted_normals(body, faces)[around])


class _Lift:
    """Displacements gathered over one pass.

    Args:
        x: (vertices, 3) [m] at its beginning.
    """

    def __init__(self, x: Tensor) -> None:
        self.x = x
        self._direction, self._size = torch.zeros_like(x), x.new_zeros(len(x))

    def add(self, corners: Tensor, shares: Tensor, heights: Tensor, normals: Tensor) -> None:
        """Lift points of the cloth, each by the least displacement of its corners.

        Args:
            corners: (points, corners) int64 vertices between which each point lies.
            shares: (points, corners) with which their positions sum to it.
            heights: (points,) [m] by which it has to be lifted.
            normals: (points, 3) unit directions.
        """
        moves = heights[:, None] * shares / shares.square().sum(1, keepdim=True)
        for corner, move in zip(corners.T, moves.T, strict=True):
            self._direction.index_add_(0, corner, move[:, None] * normals)
            self._size.scatter_reduce_(0, corner, move, "amax")

    def displacements(self, pinned: Tensor, largest: float) -> Tensor:
        """Displacements (vertices, 3) [m] by the largest lift of each vertex, along all of them summed.

        Args:
            pinned: (vertices,) bool, those that do not move.
            largest: length of the longest [m].
        """
        length = self._direction.norm(dim=1, keepdim=True).clamp_min(torch.finfo(self.x.dtype).tiny)
        size = self._size.clamp_max(largest)
        return torch.where(pinned[:, None], 0.0, size[:, None] * self._direction / length)
