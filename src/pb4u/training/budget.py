"""How long a training lasts, where it is, and whether it is coming apart."""

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
    """Compares the energies of the last twenty steps or so with those of the last five hundred, on a logarithm.

    Single wild samples do not count, a loss that stays high does.

    Args:
        factor: ratio at which a training counts as exploded.
        patience: steps before it is judged at all.
        fast: average of the logarithm over the last steps.
        slow: the same over many more.
        seen: steps watched.
    """

    factor: float = 30.0
    patience: int = 50
    fast: float = 0.0
    slow: float = 0.0
    seen: int = 0

    def after(self, energy: float) -> ExplosionGuard:
        """The guard after a step of `energy` [J], above 0."""
        value = math.log(max(energy, 1e-12)) if math.isfinite(energy) else 60.0
        # Young averages are plain means, so that they do not lean to where they began.
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
        """How many times higher the energies are than they were."""
        return math.exp(min(self.fast - self.slow, 100.0))

    @property
    def exploded(self) -> bool:
        return self.seen >= self.patience and self.ratio > self.factor

    @property
    def calm(self) -> bool:
        """Whether this is a state worth going back to."""
        return self.seen < self.patience or self.ratio < self.factor**0.5


@dataclass(frozen=True)
class Budget:
    """When a training ends: after so many optimiser steps or minutes, whichever comes first.

    Args:
        steps: optimiser steps, or None.
        minutes: of wall time, or None.
    """

    steps: int | None = None
    minutes: float | None = None

    def __post_init__(self) -> None:
        if self.steps is None and self.minutes is None:
            raise InputError("A training needs a number of steps or minutes.")
        if (self.steps is not None and self.steps < 1) or (self.minutes is not None and not self.minutes > 0):
            raise InputError("The steps or minutes of a training must be above 0.")

    def spent(self, steps: int, seconds: float) -> float:
        """Fraction that is used up."""
        by_steps = steps / self.steps if self.steps else 0.0
        return max(by_steps, seconds / (60.0 * self.minutes) if self.minutes else 0.0)


@dataclass
class Counters:
    """Where a training is, besides its weights. Every random draw follows from the number of the window.

    Args:
        step: optimiser steps taken.
        window: windows drawn, those of the statistics included.
        seconds: of wall time spent.
        rate_factor: of the learning rate, lowered by each rollback.
        rollbacks: so far.
        best: score of the best weights.
        flat: validations since then.
        validated: step of the last validation.
        guard: what the energies of late were.
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
        """As plain JSON data."""
        return asdict(self)

    @staticmethod
    def from_json(record: dict[str, Any]) -> Counters:
        """What `to_json` gave. Raises InputError where it is something else."""
        try:
            given = dict(record)
            guard, best = ExplosionGuard(**given.pop("guard")), given.pop("best")
            return Counters(**given, guard=guard, best=None if best is None else Score(**best))
        except (KeyError, TypeError) as error:
            raise InputError(f"The checkpoint does not say how far the training was: {error}.") from error
