"""Notices a training that is coming apart."""

from __future__ import annotations

import math
from dataclasses import dataclass

FAST, SLOW = 0.95, 0.998


@dataclass(frozen=True)
class ExplosionGuard:
    """Compares the energies of the last twenty steps or so with those of the last five hundred, on a logarithm.

    Single wild samples do not count, a loss that stays high does.

    Args:
        factor: ratio at which a training counts as exploded.
        patience: steps before it is judged at all.
        fast, slow: averages of the logarithm. seen: steps watched.
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
        fast, slow = min(FAST, self.seen / (self.seen + 1.0)), min(SLOW, self.seen / (self.seen + 1.0))
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
