"""Multi-layer perceptrons: two hidden layers, ReLU, a linear output, and an optional LayerNorm (ref. 1.1)."""

from __future__ import annotations

from collections.abc import Sequence

import torch.nn.functional as F
from torch import Tensor, nn


class MLP(nn.Module):
    """inputs -> width -> width -> outputs.

    Args:
        inputs: columns.
        width: of both hidden layers.
        outputs: columns.
        norm: whether a LayerNorm ends it.
    """

    def __init__(self, inputs: int, width: int, outputs: int, norm: bool) -> None:
        super().__init__()
        self.first = nn.Linear(inputs, width)
        self.second = nn.Linear(width, width)
        self.last = nn.Linear(width, outputs)
        self.norm: nn.Module = nn.LayerNorm(outputs) if norm else nn.Identity()

    def forward(self, values: Tensor) -> Tensor:
        """(..., outputs) of `values` (..., inputs)."""
        return self.after_first(self.first(values))

    def after_first(self, hidden: Tensor) -> Tensor:
        """The output, given the first layer's sum (..., width), which may be overwritten."""
        return self.after_second(self.up_to_last(hidden))

    def up_to_last(self, hidden: Tensor) -> Tensor:
        """What enters the last layer, given the first layer's sum (..., width), which may be overwritten."""
        return self.second(hidden.relu_()).relu_()

    def after_second(self, hidden: Tensor) -> Tensor:
        """The output, given what enters the last layer (..., width)."""
        return self.norm(self.last(hidden))


class SplitMLP(MLP):
    """An MLP of several concatenated parts whose first layer is applied part by part.

    W [a, b, c] = W_a a + W_b b + W_c c: a node's share is computed once a node instead of once an edge, and nothing as
    wide as all parts together is built.

    Args:
        parts: columns of each part.
        width: of both hidden layers.
        outputs: columns.
        norm: whether a LayerNorm ends it.
    """

    def __init__(self, parts: Sequence[int], width: int, outputs: int, norm: bool) -> None:
        super().__init__(sum(parts), width, outputs, norm)
        self.parts = tuple(parts)

    def project(self, part: int, values: Tensor, bias: bool = False) -> Tensor:
        """The first layer's share (..., width) of one part.

        Args:
            part: which one.
            values: (..., columns of that part).
            bias: whether to add the layer's bias, which exactly one part of a sum does.
        """
        start = sum(self.parts[:part])
        weight = self.first.weight[:, start : start + self.parts[part]]
        return F.linear(values, weight, self.first.bias if bias else None)

    def last_of_sums(self, sums: Tensor, degrees: Tensor) -> Tensor:
        """Sum of outputs over edges, where the MLP ends linear: the sum of W x + b is W (sum of x) + degree b.

        Args:
            sums: (nodes, width) of what enters the last layer.
            degrees: (nodes, 1) number of edges summed.
        """
        return F.linear(sums, self.last.weight) + degrees * self.last.bias


RECEIVER, SENDER, EDGE = 0, 1, 2


def edge_mlp(width: int, norm: bool) -> SplitMLP:
    """An MLP of [receiver, sender, edge], each `width` wide."""
    return SplitMLP((width, width, width), width, width, norm)
