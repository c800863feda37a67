"""What a network sees of pinned vertices: where they are, or already where the body takes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class SeenGarments:
    """Positions and velocities from which features are computed.

    Args:
        positions: (vertices, 3) [m], for normals, body and found edges.
        edge_positions: (vertices, 3) [m], for edges of the mesh and of coarse levels.
        velocities: (vertices, 3) [m/step].
        targets: (vertices, 3) where pinned vertices will be after the step, and the others are now [m].
        pinned: (vertices, 1) bool.
    """

    positions: Tensor
    edge_positions: Tensor
    velocities: Tensor
    targets: Tensor
    pinned: Tensor


class PinRule(Protocol):
    """A rule for the positions and velocities of pinned vertices in the features."""

    def seen(self, positions: Tensor, velocities: Tensor, pinned: Tensor, targets: Tensor) -> SeenGarments:
        """Positions and velocities that the network reads at the start of a step.

        Args:
            positions: (vertices, 3) at the start of the step [m].
            velocities: (vertices, 3) [m/step].
            pinned: (vertices, 1) bool.
            targets: (vertices, 3) where pinned vertices will be after the step [m]; other rows are not read.
        """


@dataclass(frozen=True)
class PinsAtPresent:
    """Pinned vertices like all others: at their present position, with their present velocity."""

    def seen(self, positions: Tensor, velocities: Tensor, pinned: Tensor, targets: Tensor) -> SeenGarments:
        return SeenGarments(positions, positions, velocities, torch.where(pinned, targets, positions), pinned)


@dataclass(frozen=True)
class PinsAtTarget:
    """Pinned vertices where they will be after the step: the released networks but ContourCraft.

    Args:
        moving: whether they have the velocity towards this position (MeshGraphNet, HOOD of the paper) or none.
    """

    moving: bool = False

    def seen(self, positions: Tensor, velocities: Tensor, pinned: Tensor, targets: Tensor) -> SeenGarments:
        placed = torch.where(pinned, targets, positions)
        shown = torch.where(pinned, float(self.moving) * (targets - positions), velocities)
        return SeenGarments(placed, placed, shown, placed, pinned)


@dataclass(frozen=True)
class PinsAtTargetInEdges:
    """Pinned vertices at their positions after the step, but only in mesh and coarse edges: the released
    ContourCraft."""

    def seen(self, positions: Tensor, velocities: Tensor, pinned: Tensor, targets: Tensor) -> SeenGarments:
        placed = torch.where(pinned, targets, positions)
        return SeenGarments(positions, placed, velocities, placed, pinned)
