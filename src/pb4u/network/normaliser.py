"""Running statistics that centre and scale features: cumulative mean and spread, every garment weighing the same."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from pb4u.network.graph.features import Feature, total_width

SMALLEST_SPREAD = 1e-2
"""Smallest spread as a share of the typical one: dividing by less would blow up rounding in a constant column."""


class Normaliser(nn.Module):
    """Centres and scales columns by statistics gathered during warm-up, then frozen (reference 1.3).

    `sums` holds everything gathered, [garments, sum of means, sum of mean squares] in float64: add it over devices to
    reduce, then call `refresh`. Columns that are not normalised pass through unchanged. Without statistics the mean is
    0 and the spread the feature's typical one.

    Args:
        columns: the features, in order.
    """

    sums: Tensor
    mean: Tensor
    spread: Tensor
    normalised: Tensor
    typical: Tensor
    frozen: Tensor

    def __init__(self, columns: Sequence[Feature]) -> None:
        super().__init__()
        width = total_width(tuple(columns))
        typical = torch.tensor([f.typical if f.normalised else 1.0 for f in columns for _ in range(f.width)])
        self.register_buffer("sums", torch.zeros(1 + 2 * width, dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("spread", typical.clone())
        self.register_buffer("frozen", torch.tensor(False))
        self.register_buffer("typical", typical, persistent=False)
        self.register_buffer(
            "normalised", torch.tensor([f.normalised for f in columns for _ in range(f.width)]), persistent=False
        )

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.mean.shape[0]

    def forward(self, values: Tensor) -> Tensor:
        """Normalised values (rows, width), dimensionless, of `values` (rows, width), each column in its unit.

        Args:
            values: (rows, width), each column in its unit.
        """
        return (values - self.mean) / self.spread

    def restore(self, values: Tensor) -> Tensor:
        """Values (rows, width), each column in its unit, of normalised `values` (rows, width) [1].

        Args:
            values: (rows, width) [1].
        """
        return values * self.spread + self.mean

    @torch.no_grad()
    def gather(self, values: Tensor, world: Tensor, most: int) -> None:
        """Add one step to the statistics: the mean and mean square of each world, whatever its number of rows.

        Args:
            values: (rows, width), each column in its unit.
            world: (rows,) int64 world of each row.
            most: number above that of any world; worlds without a row add nothing, nor do rows of this number.

        Raises:
            RuntimeError: the statistics are frozen.
        """
        if bool(self.frozen):
            raise RuntimeError("The statistics are frozen; they are gathered during warm-up only.")
        rows = values.to(torch.float64)
        stacked = torch.cat([torch.ones_like(rows[:, :1]), rows, rows.square()], dim=1)
        totals = torch.zeros(most + 1, stacked.shape[1], dtype=torch.float64, device=rows.device)
        totals = totals.index_add_(0, world, stacked)[:most]
        present = (totals[:, :1] > 0).to(torch.float64)
        means = totals[:, 1:] / totals[:, :1].clamp_min(1.0)
        self.sums += torch.cat([present, means * present], dim=1).sum(dim=0)
        self.refresh()

    @torch.no_grad()
    def refresh(self) -> None:
        """Recompute mean and spread from `sums`; call it after adding sums over devices."""
        count, width = self.sums[0], self.width
        if float(count) == 0.0:
            return
        mean, square = self.sums[1 : 1 + width] / count, self.sums[1 + width :] / count
        spread = (square - mean.square()).clamp_min(0.0).sqrt()
        spread = torch.maximum(spread, SMALLEST_SPREAD * self.typical.to(spread))
        self.mean.copy_(torch.where(self.normalised, mean, 0.0))
        self.spread.copy_(torch.where(self.normalised, spread, 1.0))

    def freeze(self) -> None:
        """End the gathering of statistics."""
        self.frozen.fill_(True)
