"""Perceptrons and messages in compiled code: all layers of a few hundred rows, which stay in cache, before the next.

A perceptron comes as `layers` (first, bias, second, bias, last, bias) with weights from `packed` and (width,) float32
biases, and `norm` (scale, shift, eps) of `normed_rows`.
"""

from __future__ import annotations

import numpy as np

from pb4u.collision.jit import compiled
from pb4u.network.kernels.products import multiply
from pb4u.network.kernels.row_kernels import (
    first_layer_of_edges,
    normed_edges,
    normed_rows,
    propagate,
    rectify,
    sums_of_rectified,
)

_ROWS = 256
"""Rows at a time: 64 columns of a product take 64 kB, and a product takes a hundred times the call of its pass."""


@compiled
def _up_to_last(values: np.ndarray, layers: tuple, product: np.ndarray, hidden: np.ndarray) -> None:
    """Fill `product` (rows, outputs) with that of the last layer, without its bias."""
    multiply(values, layers[0], product)
    rectify(product, layers[1], hidden)
    _after_first(layers, product, hidden)


@compiled
def _after_first(layers: tuple, product: np.ndarray, hidden: np.ndarray) -> None:
    multiply(hidden, layers[2], product)
    rectify(product, layers[3], hidden)
    multiply(hidden, layers[4], product)


@compiled
def write_normed(values: np.ndarray, layers: tuple, norm: tuple, keep: bool, out: np.ndarray) -> None:
    """Fill `out` with the output of a perceptron that ends in a LayerNorm, or add it.

    Args:
        values: (rows, inputs) in the precision of the products.
        layers: as above.
        norm: as above.
        keep: whether what `out` holds is added to.
        out: (rows, width) float32, overwritten.
    """
    width = out.shape[1]
    product, hidden = np.empty((_ROWS, width), np.float32), np.empty((_ROWS, width), values.dtype)
    for start in range(0, len(values), _ROWS):
        stop = min(start + _ROWS, len(values))
        rows = stop - start
        _up_to_last(values[start:stop], layers, product[:rows], hidden[:rows])
        normed_rows(product[:rows], layers[5], norm[0], norm[1], norm[2], keep, out[start:stop])


@compiled
def write_plain(values: np.ndarray, layers: tuple, out: np.ndarray) -> None:
    """Fill `out` (rows, outputs) float32 with the output of a perceptron without LayerNorm; see `write_normed`."""
    width = layers[1].shape[0]
    product, hidden = np.empty((_ROWS, width), np.float32), np.empty((_ROWS, width), values.dtype)
    for start in range(0, len(values), _ROWS):
        rows = min(start + _ROWS, len(values)) - start
        _up_to_last(values[start : start + rows], layers, product[:rows], hidden[:rows])
        for row in range(rows):
            for c in range(out.shape[1]):
                out[start + row, c] = product[row, c] + layers[5][c]


@compiled
def write_product(values: np.ndarray, weight: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (rows, outputs) float32 with the product of `values` (rows, inputs) and `packed` weights."""
    multiply(values, weight, out)


@compiled
def _next_nodes(offsets: np.ndarray, first: int) -> int:
    """End of the nodes from `first` whose edges are `_ROWS` at most, or of one node alone."""
    last = first + 1
    while last < len(offsets) - 1 and offsets[last + 1] - offsets[first] <= _ROWS:
        last += 1
    return last


@compiled
def _most_edges(offsets: np.ndarray) -> int:
    """Rows that the edges of `_next_nodes` need: `_ROWS`, or as many as one node has."""
    most = _ROWS
    for node in range(len(offsets) - 1):
        most = max(most, offsets[node + 1] - offsets[node])
    return most


@compiled
def pass_messages(
    layers: tuple,
    norm: tuple,
    from_senders: np.ndarray,
    senders: np.ndarray,
    from_receivers: np.ndarray,
    step: int,
    part: int,
    offsets: np.ndarray,
    keep: bool,
    latents: np.ndarray,
    rounded: np.ndarray,
    sums: np.ndarray,
    sums_step: int,
    sums_part: int,
) -> None:
    """Sum the new edges of some receivers at them, and add them to the edges' latents.

    Args:
        layers: of the edges' perceptron; its first weights are those that meet an edge's own latents.
        norm: likewise.
        from_senders: (nodes * step, width) float32 table of shares; row `part` of each node is its share as sender.
        senders: (edges,) int64 node at the start of each edge.
        from_receivers: (receivers * step, width) likewise; row `part` + 1 is a node's share as receiver.
        step: rows of the tables for each node.
        part: as above.
        offsets: (receivers + 1,) int64 first edge of each, and the end; `senders` begins at the first of these.
        keep: whether latents are wanted any more.
        latents: (edges, width) float32, added to.
        rounded: (edges, width) copy of them in the precision of the products; in float32 the latents themselves.
        sums: (receivers * sums_step, width); row `sums_part` of each receiver is overwritten.
        sums_step: rows of each receiver.
        sums_part: number of the row.
    """
    width, most = latents.shape[1], _most_edges(offsets)
    product, hidden = np.empty((most, width), np.float32), np.empty((most, width), rounded.dtype)
    node = 0
    while node < len(offsets) - 1:
        last = _next_nodes(offsets, node)
        start, stop = offsets[node] - offsets[0], offsets[last] - offsets[0]
        own, of_edges, ends = product[: stop - start], hidden[: stop - start], offsets[node : last + 1]
        if stop > start:
            multiply(rounded[start:stop], layers[0], own)
        received = from_receivers[node * step : last * step]
        first_layer_of_edges(
            own, layers[1], from_senders, senders[start:stop], step, part, received, step, part + 1, ends, of_edges
        )
        if stop > start:
            _after_first(layers, own, of_edges)
        at = sums[node * sums_step : last * sums_step]
        normed_edges(
            own,
            layers[5],
            norm[0],
            norm[1],
            norm[2],
            ends,
            keep,
            latents[start:stop],
            rounded[start:stop],
            at,
            sums_step,
            sums_part,
        )
        node = last


@compiled
def move_by_messages(
    layers: tuple,
    norm: tuple,
    decay: float,
    accumulated: bool,
    of_ends: np.ndarray,
    constants: np.ndarray,
    before: np.ndarray,
    senders: np.ndarray,
    offsets: np.ndarray,
    first_node: int,
    state: np.ndarray,
    rounded: np.ndarray,
    after: np.ndarray,
) -> None:
    """Take a step of propagation for some nodes.

    Args:
        layers: of the messages' perceptron; its first weights are not read.
        norm: (scale, shift, eps) of the LayerNorm of `propagate`.
        decay: gamma.
        accumulated: as in `propagate`.
        of_ends: `packed` weights that give a node's share as sender, followed by its share as receiver.
        constants: (edges, width) part of the first layer that is the same at every step.
        before: (all nodes * 2, width) float32 table of these shares.
        senders: (edges,) int64 node at the start of each edge.
        offsets: (nodes + 1,) int64 first edge of each node, and the end; `senders` begins at the first of these.
        first_node: number of the first of the nodes.
        state: (nodes, width) float32, overwritten.
        rounded: (nodes, width) copy of it in the precision of the products; in float32 the state itself.
        after: (nodes, 2 width) float32, overwritten by the nodes' shares in the next step.
    """
    width, most = state.shape[1], _most_edges(offsets)
    product, hidden = np.empty((most, width), np.float32), np.empty((most, width), rounded.dtype)
    sums = np.empty((_ROWS, width), rounded.dtype)
    node = 0
    while node < len(offsets) - 1:
        last = min(_next_nodes(offsets, node), node + _ROWS)
        start, stop = offsets[node] - offsets[0], offsets[last] - offsets[0]
        messages, of_edges, ends = product[: stop - start], hidden[: stop - start], offsets[node : last + 1]
        received = before[2 * (first_node + node) : 2 * (first_node + last)]
        first_layer_of_edges(
            constants[start:stop], layers[1], before, senders[start:stop], 2, 0, received, 2, 1, ends, of_edges
        )
        if stop > start:
            multiply(of_edges, layers[2], messages)
        sums_of_rectified(messages, layers[3], ends, sums)
        total, own = product[: last - node], rounded[node:last]
        multiply(sums[: last - node], layers[4], total)
        propagate(total, layers[5], ends, norm[0], norm[1], norm[2], decay, accumulated, state[node:last], own)
        multiply(own, of_ends, after[node:last])
        node = last
