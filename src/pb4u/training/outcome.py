"""What an optimiser step gave: its losses, and whether it counts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.training.lost_garment import GarmentWatch


@dataclass(frozen=True)
class Outcome:
    """Outcome of an optimiser step; on an accelerator the processor reads it some steps later.

    Args:
        names: of the losses [J].
        values: (names + 3,) the losses, then three flags, 1 where set: the pass was not worth its time; its garments
            are lost or a search was short of room; the positions are not finite.
        settings: learning rate and weight of collisions.
        watch: of the garments, or None.
    """

    names: tuple[str, ...]
    values: Tensor
    settings: dict[str, float]
    watch: GarmentWatch | None

    def changes_nothing(self) -> Tensor:
        """1 () float32 where the weights are to stay as they are, else 0."""
        return ((self.values[-3:] > 0.0).any() | ~torch.isfinite(self.values).all()).to(torch.float32)

    def finite(self, row: list[float]) -> bool:
        """Whether the step with the values `row` is finite.

        Args:
            row: values of the step, as they were collected.
        """
        return row[-1] == 0.0 and all(math.isfinite(value) for value in row)

    def skipped(self, row: list[float]) -> bool:
        """Whether the step with the values `row` was left out; notes for its window where garments are lost.

        Args:
            row: values of the step, as they were collected.
        """
        if self.watch is not None and row[-2] > 0.0:
            self.watch.seen_lost = True
        return row[-3] > 0.0 or row[-2] > 0.0
