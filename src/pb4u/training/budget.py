"""How long a training lasts, and where it is."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from pb4u.errors import InputError
from pb4u.training.explosion_guard import ExplosionGuard
from pb4u.training.validation import Score


@dataclass(frozen=True)
class Budget:
    """When a training ends: after so many optimiser steps or minutes, whichever comes first.

    Args:
        steps: optimiser steps, or None. minutes: or None.
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
        step: optimiser steps taken. window: windows drawn, those of the statistics included. seconds: spent.
        rate_factor: of the learning rate, lowered by each rollback. rollbacks: so far.
        best: score of the best weights. flat: validations since then. validated: step of the last validation.
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
