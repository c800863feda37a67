"""What optimiser steps gave: their losses, and whether they count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.collision.capacities import Capacities
from pb4u.training.budget import Counters
from pb4u.training.journal import Journal
from pb4u.training.lost_garment import GarmentWatch
from pb4u.training.objective import comparable_total, strain_energy


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
        """1 () float32 if the weights must not change, else 0."""
        return ((self.values[-3:] > 0.0).any() | ~torch.isfinite(self.values).all()).to(torch.float32)

    def finite(self, row: list[float]) -> bool:
        """Whether the step with the values `row` is finite.

        Args:
            row: collected values of the step.
        """
        return row[-1] == 0.0 and all(math.isfinite(value) for value in row)

    def skipped(self, row: list[float]) -> bool:
        """Whether the step with the values `row` was skipped; records lost garments of its window.

        Args:
            row: collected values of the step.
        """
        if self.watch is not None and row[-2] > 0.0:
            self.watch.seen_lost = True
        return row[-3] > 0.0 or row[-2] > 0.0


def note_outcomes(
    outcomes: Sequence[Outcome], capacities: Capacities | None, counters: Counters, journal: Journal
) -> bool:
    """Read the outcomes of steps, and record the valid ones; False if one is not finite.

    Args:
        outcomes: of the latest steps, in order; at least one.
        capacities: array sizes of the searches on an accelerator, enlarged if one was too small; None on a processor.
        counters: progress of the training including these steps; skipped ones are subtracted.
        journal: log of the losses.
    """
    seen = torch.stack([outcome.values for outcome in outcomes])
    if capacities is not None:
        # All that the processor reads comes in one copy.
        searches, sizes = capacities.taken()
        read = torch.cat([seen.flatten().double(), sizes.double()]).cpu()
        seen = read[: seen.numel()].reshape(seen.shape)
        capacities.grow(searches, read[seen.numel() :].to(torch.int64))
    counters.step -= len(outcomes)
    for outcome, row in zip(outcomes, seen.tolist(), strict=True):
        if outcome.skipped(row):
            continue
        if not outcome.finite(row):
            return False
        energies, weight = dict(zip(outcome.names, row, strict=False)), outcome.settings["collision_weight"]
        counters.step += 1
        counters.guard = counters.guard.after(strain_energy(energies, weight))
        journal.add({**energies, **outcome.settings}, comparable_total(energies, weight))
    return True
