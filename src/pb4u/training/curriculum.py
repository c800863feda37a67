"""Schedules of a training, as data in fractions of its budget."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

from pb4u.errors import InputError

Stages = tuple[tuple[float, float], ...]
"""(fraction of the budget, value) pairs in rising order, the first at 0."""


@dataclass(frozen=True)
class Curriculum:
    """Schedules of window length, collision weight and learning rate over the budget, from 0 to 1.

    The defaults are the family's schedule (reference 1.8, 2.5) for 450,000 steps.

    Args:
        window_steps: steps of a window from each fraction on.
        collision_weight: weight [J/m^3] at each fraction, linear in between.
        learning_rate: learning rate at the start.
        halvings: number of times that the rate halves over the budget, in equal stages.
        rate_floor: fraction of the rate that is added throughout.
        warm_up: fraction of the budget over which the rate rises from 0 to its value.
        settling_share: share of windows that begin with a settling step while windows have one step; longer windows all
            do.

    Raises:
        InputError: stages that do not rise from 0, or a value out of range.
    """

    window_steps: Stages = ((0.0, 1), (0.011, 2), (0.033, 3), (0.067, 4), (0.111, 5))
    collision_weight: Stages = ((0.0, 5e3), (0.45, 5e3), (1.0, 2.5e5))
    learning_rate: float = 5e-5
    halvings: int = 9
    rate_floor: float = 0.01
    settling_share: float = 0.5
    warm_up: float = 0.0

    def __post_init__(self) -> None:
        for name in ("window_steps", "collision_weight"):
            stages = getattr(self, name)
            rising = all(a[0] < b[0] for a, b in pairwise(stages))
            if not stages or stages[0][0] != 0.0 or not rising or any(value <= 0 for _, value in stages):
                raise InputError(
                    f"curriculum.{name} must be (fraction, value) pairs, fractions rising from 0 and values above 0."
                )
        if not (self.learning_rate > 0 and self.halvings >= 0 and self.rate_floor >= 0):
            raise InputError("The learning rate must be above 0, and its halvings and floor not below 0.")
        if not 0.0 <= self.warm_up < 1.0:
            raise InputError(f"curriculum.warm_up must lie between 0 and 1, not {self.warm_up}.")
        if not 0.0 <= self.settling_share <= 1.0:
            raise InputError(f"curriculum.settling_share must lie between 0 and 1, not {self.settling_share}.")

    def window_length(self, progress: float) -> int:
        """Number of steps of a window at a fraction `progress` of the budget.

        Args:
            progress: fraction of the budget that is spent, 0 to 1.
        """
        return int(_stage(self.window_steps, progress)[1])

    def collision(self, progress: float) -> float:
        """Weight of the collision term [J/m^3] at a fraction `progress` of the budget.

        Args:
            progress: fraction of the budget that is spent, 0 to 1.
        """
        for (start, before), (stop, after) in pairwise(self.collision_weight):
            if start <= progress < stop:
                return before + (after - before) * (progress - start) / (stop - start)
        return self.collision_weight[-1][1] if progress >= self.collision_weight[-1][0] else self.collision_weight[0][1]

    def rate(self, progress: float) -> float:
        """Learning rate at a fraction `progress` of the budget.

        Args:
            progress: fraction of the budget that is spent, 0 to 1.
        """
        stage = int(self.halvings * min(max(progress, 0.0), 1.0))
        risen = min(progress / self.warm_up, 1.0) if self.warm_up else 1.0
        return self.learning_rate * (0.5**stage + self.rate_floor) * risen


def _stage(stages: Stages, progress: float) -> tuple[float, float]:
    return stages[max(bisect_right([start for start, _ in stages], progress) - 1, 0)]
