"""Sums and longest moves over the vertices of each world, by which a line search decides."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import compiled
from pb4u.collision.lengths import length
from pb4u.scene.packed import PackedGarments


def factors(moves: Tensor, size: float, garments: PackedGarments) -> Tensor:
    """Factors (worlds,) that scale the `moves` (vertices, 3) [m] of each world so that the longest is `size` [m].

    0 for a world whose longest move is below 1e-12 of the longest of all worlds: that is rounding.

    Args:
        moves: (vertices, 3) float64 [m].
        size: [m].
        garments: the garments with these vertices.
    """
    largest = torch.from_numpy(_longest(moves.numpy(), np.asarray(garments.world_offsets)))
    return torch.where(largest > 1e-12 * largest.max(), torch.full_like(largest, size) / largest, 0.0)


def each_vertex(values: Tensor, garments: PackedGarments) -> Tensor:
    """For each vertex (vertices, 1) the entry of `values` (worlds,) of its world; for one world (1, 1).

    Args:
        values: (worlds,) of any unit.
        garments: the garments with these vertices.
    """
    return values[:, None] if len(values) == 1 else values[garments.vertex_world, None]


def sums(values: Tensor, garments: PackedGarments) -> Tensor:
    """Sums (worlds,) of `values` (vertices, 3) over the vertices of each world, in their unit.

    Args:
        values: (vertices, 3) of any unit.
        garments: the garments with these vertices.
    """
    return torch.stack([values[rows].sum() for rows in garments.world_vertices])


@compiled
def _longest(moves: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Length (worlds,) [m] of the longest of the `moves` (vertices, 3) [m] from one of the `offsets` to the next."""
    longest = np.zeros(len(offsets) - 1)
    for world in range(len(longest)):
        for row in range(offsets[world], offsets[world + 1]):
            longest[world] = max(longest[world], length(moves[row, 0], moves[row, 1], moves[row, 2]))
    return longest


@compiled
def norm(forces: np.ndarray, masses: np.ndarray) -> float:
    """Norm of `forces` (vertices, 3) weighed by the inverse `masses` (vertices,), those without mass left out.

    Args:
        forces: (vertices, 3) of any unit.
        masses: (vertices,) [kg], or times a number.
    """
    total = 0.0
    for row in range(len(forces)):
        if masses[row] > 0.0:
            total += (forces[row, 0] ** 2 + forces[row, 1] ** 2 + forces[row, 2] ** 2) / masses[row]
    return np.sqrt(total)


@compiled
def squared_ratios(forces: np.ndarray, masses: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Squared lengths (rows,) of `forces` (vertices, 3) over `masses` (vertices,), of some `rows`.

    Args:
        forces: (vertices, 3) of any unit.
        masses: (vertices,) of any unit.
        rows: (rows,) int64 vertices.
    """
    squared = np.empty(len(rows))
    for number in range(len(rows)):
        row = rows[number]
        x, y, z = forces[row, 0] / masses[row], forces[row, 1] / masses[row], forces[row, 2] / masses[row]
        squared[number] = x * x + y * y + z * z
    return squared
