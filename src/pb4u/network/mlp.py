"""Multi-layer perceptrons: two hidden layers, ReLU, a linear output, and an optional LayerNorm (reference 1.1).

The precision of the weights is that of the products: what enters a product is rounded to it, hidden layers stay in it,
and outputs and the statistics of norms have at least that of float32.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pb4u.network.kernels.recorded_passes import normed_perceptron, records
from pb4u.network.tiles import of_tiles

ROWS_PER_RUN = 8192
"""So many rows of 64 columns in float32 take 2 MB, which stays in a processor's cache between two layers."""


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
        """Output (rows, outputs) [1] for `values` (rows, inputs) [1]."""
        if isinstance(self.norm, nn.LayerNorm) and records(values):
            return normed_perceptron(values, self.first.weight, self.first.bias, (self.second, self.last, self.norm))
        return in_runs(lambda rows: self.after_first(self.first(rows.to(self.precision))), values)

    def after_product(self, product: Tensor) -> Tensor:
        """As `after_first`, given the first layer's sum `product` (..., width) [1] without its bias."""
        if isinstance(self.norm, nn.LayerNorm) and records(product):
            return normed_perceptron(product, None, self.first.bias, (self.second, self.last, self.norm))
        return self.after_first(product + self.first.bias)

    def after_first(self, hidden: Tensor) -> Tensor:
        """Output (..., outputs) [1], given the first layer's sum `hidden` (..., width) [1], which is overwritten."""
        return self.output_layer()(self.up_to_last(hidden))

    def up_to_last(self, hidden: Tensor) -> Tensor:
        """Input (..., width) [1] of the last layer, given the first layer's sum `hidden` (..., width) [1].

        `hidden` is overwritten.
        """
        return _rectified(self.second(_rectified(hidden)))

    def output_layer(self) -> Callable[[Tensor], Tensor]:
        """The last layer and the norm, from its input (..., width) [1] to the output (..., outputs) [1].

        What they need of the weights is made once, for any number of inputs.
        """
        if (
            isinstance(self.norm, nn.LayerNorm)
            and not torch.is_grad_enabled()
            and self.last.weight.device.type == "cpu"
        ):
            return _CentredOutput(self.last, self.norm)
        return lambda hidden: self.norm(_widened(self.last(hidden)))


class _CentredOutput:
    """A last layer with its LayerNorm: the mean of the outputs is taken off the weights, once, instead of off each row.

    On a processor that takes half the time of `F.layer_norm` on rows as short as these (4,096 rows, 64 wide: 0.10 ms
    instead of 0.19).
    """

    def __init__(self, last: nn.Linear, norm: nn.LayerNorm) -> None:
        weight, bias, root = _widened(last.weight), _widened(last.bias), last.out_features**0.5
        # Divided by the root of their number as well, so that the squared length of the outputs is their variance.
        self.weight = ((weight - weight.mean(dim=0)) / root).to(last.weight.dtype)
        self.bias = ((bias - bias.mean()) / root).to(last.weight.dtype)
        self.scale, self.shift = _widened(norm.weight) * root, _widened(norm.bias)
        self.eps = self.scale.new_tensor(norm.eps)

    def __call__(self, hidden: Tensor) -> Tensor:
        values = _widened(F.linear(hidden, self.weight, self.bias))
        lengths = torch.linalg.vector_norm(values, dim=-1, keepdim=True)
        values *= torch.addcmul(self.eps, lengths, lengths).rsqrt_()
        return torch.addcmul(self.shift, values, self.scale, out=values)


def in_runs(of: Callable[..., Tensor], *values: Tensor) -> Tensor:
    """`of(*values)` (rows, columns), some rows at a time while no gradients are recorded on a processor.

    What lies between two layers then stays in its cache.

    Args:
        of: acts on every row by itself.
        values: (rows, columns) each.
    """
    rows = values[0].shape[0]
    if torch.is_grad_enabled() or rows <= ROWS_PER_RUN or values[0].device.type != "cpu":
        return of(*values)
    runs = [slice(start, start + ROWS_PER_RUN) for start in range(0, rows, ROWS_PER_RUN)]
    return torch.cat(of_tiles(lambda run: of(*(each[run] for each in values)), runs))


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

    def project(self, part: int, values: Tensor, bias: bool = False) -> Tensor:
        """Share (..., width) [1] of one part in the first layer's sum.

        Args:
            part: number of the part.
            values: (..., columns of that part) [1].
            bias: whether to add the layer's bias, which exactly one part of a sum does.
        """
        return F.linear(values.to(self.precision), self.weight_of(part), self.first.bias if bias else None)

    def weight_of(self, part: int) -> Tensor:
        """Columns (width, columns of that part) [1] of the first layer's weights that one part meets."""
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

    def weight_of_both_ends(self) -> Tensor:
        """Weights (2 width, width) [1] that give a node's share as sender, followed by its share as receiver."""
        return torch.cat([self.weight_of(SENDER), self.weight_of(RECEIVER)])

    def shares_of_ends(self, senders: Tensor, receivers: Tensor) -> Tensor:
        """Shares (senders + receivers, width) [1] in the first layer's sum, with its bias; not differentiable.

        Args:
            senders: (senders, width) [1] latents in the precision of the products.
            receivers: (receivers, width) [1] likewise.
        """
        count = senders.shape[0]
        table = senders.new_empty(count + receivers.shape[0], self.first.out_features)
        torch.mm(senders, self.weight_of(SENDER).t(), out=table[:count])
        torch.addmm(self.first.bias, receivers, self.weight_of(RECEIVER).t(), out=table[count:])
        return table
