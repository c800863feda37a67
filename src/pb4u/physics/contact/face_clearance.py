"""Keeps the body from showing through coarse cloth: lifts edges and faces that dip into it between their corners.

Energies and contact response look at vertices. On a body of radius R an edge of length L sags L^2 / (8 R) below its
ends: 1.5 mm for the 27 mm edges of a 2.5K T-shirt on a shoulder, more than the distance cloth keeps from the skin.
Between the middles that are looked at, a quarter of that is left: L^2 / (32 R), which is added to their clearance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pb4u.physics.contact.planes import clearances, nearest_planes
from pb4u.scene.packed import ColliderPose, PackedGarments
from pb4u.scene.state import State


@dataclass(frozen=True)
class FaceClearance:
    """Moves the corners of a dipping edge or face along the body's normal until its middle is clear.

    Velocities stay as they are. Pinned vertices do not move.

    Args:
        clearance: distance that the cloth keeps from the surface [m].
        smallest_radius: smallest radius of the body where cloth rests on it [m].
        largest_push: largest displacement of a vertex in one pass [m].
        passes: number of passes, since a lifted vertex lifts the middles of its neighbours too.
    """

    clearance: float = 3e-4
    smallest_radius: float = 0.03
    largest_push: float = 5e-3
    passes: int = 2

    def lift(self, garments: PackedGarments, state: State, pose: ColliderPose) -> State:
        """State with its edges and faces lifted out of the bodies.

        Args:
            garments: static quantities.
            state: to be lifted.
            pose: the bodies at the state's frame.
        """
        if not len(pose.colliders.faces):
            return state
        x = state.positions
        elements = self._near(garments, pose, x)
        for _ in range(self.passes):
            if not any(len(corners) for corners in elements):
                break
            push, elements = self._pushes(garments, pose, x, elements)
            x = x + push
        return replace(state, positions=x)

    def _near(self, garments: PackedGarments, pose: ColliderPose, x: Tensor) -> list[Tensor]:
        """Edges and faces with a corner nearer to the body than they are long."""
        planes = nearest_planes(pose, garments, x)
        reach = x.new_tensor(garments.mean_edge_lengths)[garments.vertex_garment]
        close = planes.touchable & (planes.distance < reach)
        return [corners[close[corners].any(1)] for corners in (garments.edges, garments.faces)]

    def _pushes(
        self, garments: PackedGarments, pose: ColliderPose, x: Tensor, elements: list[Tensor]
    ) -> tuple[Tensor, list[Tensor]]:
        """Displacement of every vertex (vertices, 3) [m], and the elements that needed one."""
        wanted = self.clearance + x.new_tensor(garments.mean_edge_lengths).square() / (32.0 * self.smallest_radius)
        direction, depth, dipping = torch.zeros_like(x), x.new_zeros(len(x)), []
        for corners in elements:
            garment = garments.vertex_garment[corners[:, 0]]
            distance, normals = clearances(pose, x[corners].mean(1), garments.garment_world[garment])
            below = (wanted[garment] - distance).clamp(0.0, self.largest_push)
            rows = below > 0
            dipping.append(corners[rows])
            for corner in corners[rows].T:
                direction.index_add_(0, corner, below[rows, None] * normals[rows])
                depth.scatter_reduce_(0, corner, below[rows], "amax")
        unit = direction / direction.norm(dim=1, keepdim=True).clamp_min(torch.finfo(x.dtype).tiny)
        return torch.where(garments.pinned[:, None], 0.0, depth[:, None] * unit), dipping
