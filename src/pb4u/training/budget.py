"""Length and progress of a training, and the test whether its energies explode."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from pb4u.errors import InputError
from pb4u.training.validation import Score

_FAST, _SLOW = 0.95, 0.998
"""Memory of the guard's two averages: some twenty and some five hundred steps."""


@dataclass(frozen=True)
class ExplosionGuard:
    """Compares the energies of about the last twenty steps with those of the last five hundred, by their logarithms.

    Single outliers do not count, a loss that stays high does.

    Args:
        factor: ratio above which a training counts as exploded.
        patience: steps before which it never does.
        fast: average of the logarithm of the energy over about twenty steps.
        slow: the same over about five hundred.
        seen: number of steps watched.
    """

    factor: float = 30.0
    patience: int = 50
    fast: float = 0.0
    slow: float = 0.0
    seen: int = 0

    def after(self, energy: float) -> ExplosionGuard:
        """Guard after a further step of `energy` [J], above 0.

        Args:
            energy: of the further step [J].
        """
        value = math.log(max(energy, 1e-12)) if math.isfinite(energy) else 60.0
        # At first the averages are plain means, so that the initial value has no weight.
        fast, slow = min(_FAST, self.seen / (self.seen + 1.0)), min(_SLOW, self.seen / (self.seen + 1.0))
        return ExplosionGuard(
            self.factor,
            self.patience,
            fast * self.fast + (1.0 - fast) * value,
            slow * self.slow + (1.0 - slow) * value,
            self.seen + 1,
        )

    @property
    def ratio(self) -> float:
        """Ratio of the latest energies to earlier ones, dimensionless."""
        return math.exp(min(self.fast - self.slow, 100.0))

    @property
    def exploded(self) -> bool:
        """Whether the ratio is above `factor`, after `patience` steps."""
        return self.seen >= self.patience and self.ratio > self.factor

    @property
    def calm(self) -> bool:
        """Whether the energies allow a snapshot: the ratio is below the root of `factor`, or not judged yet."""
        return self.seen < self.patience or self.ratio < self.factor**0.5


@dataclass(frozen=True)
class Budget:
    """Limit of a training in optimiser steps or minutes, whichever comes first.

    Args:
        steps: number of optimiser steps, or None.
        minutes: wall time [min], or None.

    Raises:
        InputError: both are None or one is not above 0.
    """

    steps: int | None = None
    minutes: float | None = None

    def __post_init__(self) -> None:
        if self.steps is None and self.minutes is None:
            raise InputError("A training needs a number of steps or minutes.")
        if (self.steps is not None and self.steps < 1) or (self.minutes is not None and not self.minutes > 0):
            raise InputError("The steps or minutes of a training must be above 0.")

    def without(self, seconds: float) -> Budget:
        """Budget reduced by time for other work, but at least half of this one.

        Args:
            seconds: wall time of that [s].
        """
        if self.minutes is None:
            return self
        return Budget(self.steps, max(self.minutes - seconds / 60.0, 0.5 * self.minutes))

    def spent(self, steps: int, seconds: float) -> float:
        """Fraction of the budget that is used up.

        Args:
            steps: number of optimiser steps so far.
            seconds: wall time spent [s].
        """
        by_steps = steps / self.steps if self.steps else 0.0
        return max(by_steps, seconds / (60.0 * self.minutes) if self.minutes else 0.0)


@dataclass
class Counters:
    """Progress of a training, besides its weights. Every random draw follows from the number of the window.

    Args:
        step: number of optimiser steps so far.
        window: number of windows drawn, including those for the statistics.
        seconds: wall time spent [s].
        rate_factor: factor on the learning rate, lowered by each rollback.
        rollbacks: number of rollbacks.
        best: score of the best weights.
        flat: number of validations since the best one.
        validated: step of the last validation.
        guard: averages of the energies of late.
    """

    step: int = 0
    window: int = 0
    seconds: float = 0.0
    rate_factor: float = 1.0
    rollbacks: int = 0
    best: Score | None = None
    flat: int = 0
    validated: int = 0
    guard: ExplosionGuard = field(default_factory=ExplosionGuard)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON data of the counters."""
        return asdict(self)

    @staticmethod
    def from_json(record: dict[str, Any]) -> Counters:
        """Counters from the data that `to_json` gave.

        Args:
            record: what `to_json` gave.

        Raises:
            InputError: it is something else.
        """
        try:
            values = dict(record)
            guard, best = ExplosionGuard(**values.pop("guard")), values.pop("best")
            if best is not None and "excess_height" not in best:
                best = None  # of earlier versions, by energy: nothing of now is compared with it
            return Counters(**values, guard=guard, best=None if best is None else Score(**best))
        except (KeyError, TypeError) as error:
            raise InputError(f"The checkpoint does not say how far the training had come: {error}.") from error
