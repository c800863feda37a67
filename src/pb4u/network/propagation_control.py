"""Number of propagation steps of a garment (paper, "Resolution-Aware Propagation Control")."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pb4u.errors import InputError


@dataclass(frozen=True)
class ConstantDistance:
    """The paper's rule: as many steps as edges fit into a fixed distance, K = max(1, floor(D / L)).

    Args:
        distance: D = K_base x L_base [m]; the paper states no value, the release has 15 steps at 15 mm.

    Raises:
        InputError: a distance that is not above 0 and finite.
    """

    distance: float = 0.225

    def __post_init__(self) -> None:
        if not 0.0 < self.distance < float("inf"):
            raise InputError(f"The propagation distance must be above 0 m, not {self.distance}.")

    def steps(self, mean_edge_length: float) -> int:
        """Number of steps, at least 1, for a garment of `mean_edge_length` [m] at rest.

        Args:
            mean_edge_length: mean edge length of the garment at rest [m].
        """
        # The small addition keeps D / L = 15 at 15 although binary fractions put it just below.
        return max(1, math.floor(self.distance / mean_edge_length + 1e-6))


@dataclass(frozen=True)
class TruncatedDistance:
    """The released form of `ConstantDistance`: K = max(1, int(D / L)) with L rounded to single precision.

    Args:
        distance: D [m].

    Raises:
        InputError: a distance that is not above 0 and finite.
    """

    distance: float = 0.225

    def __post_init__(self) -> None:
        ConstantDistance(self.distance)

    def steps(self, mean_edge_length: float) -> int:
        return max(1, int(self.distance / np.float32(mean_edge_length)))


@dataclass(frozen=True)
class FixedSteps:
    """The same number of steps at every resolution: propagation without control.

    Args:
        count: number of steps.

    Raises:
        InputError: less than 1 step.
    """

    count: int = 15

    def __post_init__(self) -> None:
        if self.count < 1:
            raise InputError(f"There must be at least 1 propagation step, not {self.count}.")

    def steps(self, mean_edge_length: float) -> int:
        return self.count
