"""What is done to cloth while it is simulated: a hand that pulls at it, and another wind."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pb4u.environment import Environment
from pb4u.errors import InputError
from pb4u.physics.time_step import Pull, TimeStep
from pb4u.scene.packed import PackedGarments

GRIP = 0.02
"""Distance [m] at rest within which fingers hold the cloth around a point; on a coarse mesh, its neighbours."""

_RING = 1.5
"""Mean edge lengths within which nearly all neighbours of a vertex lie, and few others."""

FIRMNESS = 250.0
"""Stiffness [N/m] of the springs of a hand, all together: the weight of a shirt draws it away by less than 1 cm."""

REACH = 0.12
"""How far [m] ahead of the cloth a hand draws: at most 30 N, as one pulls hard at what one wears."""


@dataclass(frozen=True, eq=False)
class Hand:
    """Cloth that a hand holds, and where it is drawn to.

    Args:
        vertices: (held,) int64; the first is the one that was taken hold of.
        place: (3,) [m] where the first is drawn to.
    """

    vertices: Tensor
    place: tuple[float, float, float]

    @staticmethod
    def at(garments: PackedGarments, positions: Tensor, point: tuple[float, float, float]) -> Hand:
        """A hand that takes hold of the cloth nearest to a point.

        Args:
            garments: the cloth.
            positions: (vertices, 3) [m] where it is.
            point: (3,) [m].

        Raises:
            InputError: the point is not finite.
        """
        nearest = int((positions - positions.new_tensor(finite(point))).norm(dim=1).argmin())
        rest = garments.rest_positions
        within = max(GRIP, _RING * float(garments.vertex_edge_lengths[nearest]))
        near = (rest - rest[nearest]).norm(dim=1) < within
        near &= garments.vertex_garment == garments.vertex_garment[nearest]
        near[nearest] = False
        rows = torch.nonzero(near)[:, 0]
        return Hand(torch.cat([rows.new_tensor([nearest]), rows]), finite(point))

    def pull(self, positions: Tensor) -> Pull:
        """Pull of the hand over a step: all vertices that it holds move alike, `REACH` at most.

        Args:
            positions: (vertices, 3) [m] at the start of the step.
        """
        places = positions[self.vertices]
        way = places.new_tensor(self.place) - places[0]
        way = way * (REACH / way.norm().clamp_min(REACH))
        return Pull(self.vertices, places + way, FIRMNESS / len(places))


@dataclass(frozen=True, eq=False)
class Touch:
    """A hand and a wind that act during a step; replaced as a whole, and read once a step.

    Args:
        hand: that holds the cloth, or None.
        environment: in place of the scene's, or None.
    """

    hand: Hand | None = None
    environment: Environment | None = None

    def on(self, step: TimeStep) -> TimeStep:
        """The step with the hand's pull and the wind.

        Args:
            step: the time step.
        """
        return replace(
            step,
            environment=self.environment or step.environment,
            pull=None if self.hand is None else self.hand.pull(step.state.positions),
        )


def finite(point: tuple[float, float, float]) -> tuple[float, float, float]:
    """A point [m], its coordinates as numbers.

    Args:
        point: (3,) [m].

    Raises:
        InputError: they are no finite numbers.
    """
    try:
        x, y, z = map(float, point)
    except (TypeError, ValueError):
        x = y = z = float("nan")
    if not all(abs(value) < 1e3 for value in (x, y, z)):
        raise InputError(f"The point to pull to must be within 1,000 m of the origin, not {point!r}.")
    return x, y, z
