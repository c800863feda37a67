"""Multi-layer perceptrons: two hidden layers, ReLU, a linear output, and an optional LayerNorm (reference 1.1).

The precision of the weights is that of the products: what enters a product is rounded to it, hidden layers stay in it,
and outputs and the statistics of norms have at least that of float32.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pb4u.network.compiled_layers import are_compiled, normed_perceptron


class MLP(nn.Module):
    """Perceptron inputs -> width -> width -> outputs; all values are dimensionless.

    Args:
        inputs: number of columns that enter.
        width: number of columns of both hidden layers.
        outputs: number of columns that leave.
        norm: whether a LayerNorm ends it.
    """

    def __init__(self, inputs: int, width: int, outputs: int, norm: bool) -> None:
        super().__init__()
        self.first = nn.Linear(inputs, width)
        self.second = nn.Linear(width, width)
        self.last = nn.Linear(width, outputs)
        self.norm: nn.Module = nn.LayerNorm(outputs) if norm else nn.Identity()

    @property
    def precision(self) -> torch.dtype:
        """Data type of the products."""
        return self.first.weight.dtype

    def forward(self, values: Tensor) -> Tensor:
        """Output (rows, outputs) [1] for `values` (rows, inputs) [1].

        Args:
            values: (rows, inputs) [1].
        """
        if isinstance(self.norm, nn.LayerNorm) and are_compiled(values, self.first.weight):
            return normed_perceptron(values, self.first.weight, self.first.bias, (self.second, self.last, self.norm))
        return self.after_first(self.first(values.to(self.precision)))

    def after_first(self, hidden: Tensor) -> Tensor:
        """Output (..., outputs) [1], given the first layer's sum `hidden` (..., width) [1], which is overwritten.

        Args:
            hidden: (..., width) [1] sum of the first layer.
        """
        return self.output(self.up_to_last(hidden))

    def up_to_last(self, hidden: Tensor) -> Tensor:
        """Input (..., width) [1] of the last layer, given the first layer's sum `hidden` (..., width) [1].

        `hidden` is overwritten.

        Args:
            hidden: (..., width) [1] sum of the first layer.
        """
        return _rectified(self.second(_rectified(hidden)))

    def output(self, hidden: Tensor) -> Tensor:
        """Output (..., outputs) [1] of the last layer and the norm, from their input `hidden` (..., width) [1].

        Args:
            hidden: (..., width) [1] input of the last layer.
        """
        return self.norm(_widened(self.last(hidden)))


def _widened(values: Tensor) -> Tensor:
    """`values` in float32 at least."""
    return values.to(torch.promote_types(values.dtype, torch.float32))


def _rectified(values: Tensor) -> Tensor:
    """ReLU, in place."""
    if values.dtype == torch.bfloat16 and not torch.is_grad_enabled() and values.device.type == "cpu":
        # As integers, negative numbers are negative too, and their larger one is found seven times faster.
        values.view(torch.int16).clamp_min_(0)
        return values
    return values.relu_()


class SplitMLP(MLP):
    """An MLP of several concatenated parts whose first layer is applied part by part.

    W [a, b, c] = W_a a + W_b b + W_c c: a node's share is computed once a node instead of once an edge, and nothing as
    wide as all parts together is built.

    Args:
        parts: number of columns of each part.
        width: number of columns of both hidden layers.
        outputs: number of columns that leave.
        norm: whether a LayerNorm ends it.
    """

    def __init__(self, parts: Sequence[int], width: int, outputs: int, norm: bool) -> None:
        super().__init__(sum(parts), width, outputs, norm)
        self.parts = tuple(parts)

    def of_parts(self, values: Mapping[int, Tensor]) -> Tensor:
        """Output (rows, outputs) [1] for some of the parts, the others being zero.

        Args:
            values: (rows, columns of that part) [1] by number of the part.
        """
        parts = list(values.values())
        if isinstance(self.norm, nn.LayerNorm) and are_compiled(parts[0], self.first.weight):
            weight, layers = (
                torch.cat([self.weight_of(part) for part in values], 1),
                (self.second, self.last, self.norm),
            )
            return normed_perceptron(torch.cat(parts, 1), weight, self.first.bias, layers)
        shares = [self.project(part, rows) for part, rows in values.items()]
        return self.after_first(reduce(torch.add, shares) + self.first.bias)

    def project(self, part: int, values: Tensor, bias: bool = False) -> Tensor:
        """Contribution (..., width) [1] of one part to the first layer's sum.

        Args:
            part: number of the part.
            values: (..., columns of that part) [1].
            bias: whether to add the layer's bias; exactly one part of a sum must.
        """
        return F.linear(values.to(self.precision), self.weight_of(part), self.first.bias if bias else None)

    def weight_of(self, part: int) -> Tensor:
        """Columns (width, columns of that part) [1] of the first layer's weights for one part.

        Args:
            part: number of the part.
        """
        start = sum(self.parts[:part])
        return self.first.weight[:, start : start + self.parts[part]]

    def last_of_sums(self, sums: Tensor, degrees: Tensor) -> Tensor:
        """Sums (nodes, outputs) [1] of outputs over edges, for an MLP without LayerNorm.

        The sum of W x + b is W (sum of x) + degree b.

        Args:
            sums: (nodes, width) [1] sums of the last layer's inputs.
            degrees: (nodes, 1) [1] number of edges summed.
        """
        return _widened(F.linear(sums.to(self.precision), self.last.weight)) + _widened(degrees) * self.last.bias


RECEIVER, SENDER, EDGE = 0, 1, 2


class EdgeMLP(SplitMLP):
    """MLP of [receiver, sender, edge], each `width` wide.

    Args:
        width: number of columns of each part, of the hidden layers and of the output.
        norm: whether a LayerNorm ends it.
    """

    def __init__(self, width: int, norm: bool) -> None:
        super().__init__((width, width, width), width, width, norm)
