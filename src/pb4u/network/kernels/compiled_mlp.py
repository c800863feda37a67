"""Multi-layer perceptrons without gradients on a processor, their weights prepared once for compiled kernels."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from pb4u.network.kernels.layer_kernels import write_normed, write_plain
from pb4u.network.kernels.products import packed
from pb4u.network.mlp import MLP, SplitMLP
from pb4u.network.tiles import of_tiles

TILE_ROWS = 4096
"""Rows that a thread takes at a time: they take it 0.2 to 1 ms, and to hand them over a twentieth."""


def as_array(tensor: Tensor) -> np.ndarray:
    """The same memory as kernels read it: NumPy has no bfloat16, whose bits it sees as uint16."""
    return (tensor.view(torch.uint16) if tensor.dtype == torch.bfloat16 else tensor).numpy()


def as_vector(values: Tensor) -> np.ndarray:
    """Weights (width,) as kernels read them: a float32 copy."""
    return values.detach().to(torch.float32, copy=True).numpy()


class CompiledMLP:
    """The layers of an `MLP` with their weights packed, rounded and centred once.

    Args:
        mlp: on a processor; its weights are copied.
        precision: of the products, float32 or bfloat16.
    """

    def __init__(self, mlp: MLP, precision: torch.dtype) -> None:
        self.precision, self.width = precision, mlp.second.out_features
        columns = mlp.parts if isinstance(mlp, SplitMLP) else (mlp.first.in_features,)
        self.parts = torch.split(mlp.first.weight.detach(), list(columns), dim=1)
        weight, bias = mlp.last.weight.detach().float(), mlp.last.bias.detach().float()
        self.norm: tuple = ()
        if isinstance(mlp.norm, nn.LayerNorm):
            # The mean of the outputs is taken off the weights once instead of off every row; divided by the root of
            # their number as well, the outputs' squared length is their variance.
            root = mlp.last.out_features**0.5
            weight, bias = (weight - weight.mean(dim=0)) / root, (bias - bias.mean()) / root
            self.norm = (as_vector(mlp.norm.weight * root), as_vector(mlp.norm.bias), np.float32(mlp.norm.eps))
        self.further = (
            as_vector(mlp.first.bias),
            packed(mlp.second.weight, precision),
            as_vector(mlp.second.bias),
            packed(weight, precision),
            as_vector(bias),
        )
        self.layers = (packed(mlp.first.weight, precision), *self.further)

    def layers_of_part(self, part: int) -> tuple:
        """The layers, of the first only the weights that one part meets."""
        return (packed(self.parts[part], self.precision), *self.further)

    def write_normed(self, values: Tensor, out: Tensor, keep: bool = False) -> None:
        """Fill `out` (rows, width) [1] with the output, of a perceptron that ends in a LayerNorm.

        Args:
            values: (rows, inputs) [1] in the precision of the products.
            out: float32, overwritten.
            keep: whether to add to what `out` holds.
        """
        write_normed(as_array(values), self.layers, self.norm, keep, out.numpy())

    def normed(self, values: Tensor) -> Tensor:
        """Output (rows, width) [1] for `values` (rows, inputs) [1], tile by tile; arguments as in `write_normed`."""
        out = values.new_empty(len(values), self.width, dtype=torch.float32)
        of_tiles(lambda rows: self.write_normed(values[rows], out[rows]), tiles(len(values)))
        return out

    def plain(self, values: Tensor) -> Tensor:
        """Output (rows, outputs) [1] for `values` (rows, inputs) [1], of a perceptron without LayerNorm."""
        out = values.new_empty(len(values), len(self.layers[-1]), dtype=torch.float32)
        of_tiles(lambda rows: write_plain(as_array(values[rows]), self.layers, out[rows].numpy()), tiles(len(values)))
        return out


def tiles(rows: int) -> list[slice]:
    """`rows` cut into tiles of the same size, `TILE_ROWS` at most."""
    count = max(1, -(-rows // TILE_ROWS))
    return [slice(rows * part // count, rows * (part + 1) // count) for part in range(count)]
