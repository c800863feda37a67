"""Derivatives, by hand, of the loops over the rows of perceptrons, edges and messages.

`between` and `layers` are as in `layer_loops`, the layers as the network holds them; `further` are the derivatives by
them, in the same order, to which is added.
"""

from __future__ import annotations

import numpy as np

from pb4u.collision.jit import compiled_with_free_sums
from pb4u.network.layer_loops import ROWS, add_rows, most_rows, next_nodes

_ZERO = np.float32(0.0)


@compiled_with_free_sums
def perceptron_derivative(
    on: np.ndarray,
    values: np.ndarray,
    layers: tuple,
    between: tuple,
    further: tuple,
    wanted: bool,
    on_values: np.ndarray,
) -> None:
    """Add the derivatives by `layers` to `further`, and fill `on_values` with that by `values` where it is `wanted`."""
    width = on.shape[1]
    spare, out = np.empty((ROWS, width), on.dtype), np.empty((ROWS, width), on.dtype)
    square, entering = np.empty((width, width), on.dtype), np.empty(layers[0].shape, on.dtype)
    for start in range(0, len(values), ROWS):
        rows = slice(start, min(start + ROWS, len(values)))
        n = rows.stop - start
        _through_layers(on[rows], rows, between, layers, further, spare[:n], square, out[:n])
        np.dot(out[:n].T, values[rows], entering)
        add_rows(entering, further[0])
        if wanted:
            np.dot(out[:n], layers[0], on_values[rows])


@compiled_with_free_sums
def edge_pass_derivative(
    on_new: np.ndarray,
    on_sums: np.ndarray,
    kept: bool,
    latents: np.ndarray,
    senders: np.ndarray,
    offsets: np.ndarray,
    layers: tuple,
    between: tuple,
    further: tuple,
    on_latents: np.ndarray,
) -> None:
    """Add the derivatives by both shares and by `layers` to `further`, and fill `on_latents` (edges, width)."""
    of_layers = further[2:]
    width, most = latents.shape[1], most_rows(offsets)
    on, spare = np.empty((most, width), latents.dtype), np.empty((most, width), latents.dtype)
    out, square = np.empty((most, width), latents.dtype), np.empty((width, width), latents.dtype)
    node = 0
    while node < len(offsets) - 1:
        last = next_nodes(offsets, node, len(offsets) - 1)
        rows, ends = slice(offsets[node], offsets[last]), offsets[node : last + 1]
        n = rows.stop - rows.start
        if n > 0:
            _of_edges(on_new[rows], on_sums[node:last], kept, ends, on[:n])
            _through_layers(on[:n], rows, between, layers, of_layers, spare[:n], square, out[:n])
            np.dot(out[:n].T, latents[rows], square)
            add_rows(square, of_layers[0])
            _sum_at_ends(out[:n], senders[rows], ends, further[0], further[1][node:last], True)
            np.dot(out[:n], layers[0], on_latents[rows])
            if kept:
                add_rows(on_new[rows], on_latents[rows])
        node = last


@compiled_with_free_sums
def message_derivative(
    of_sums: np.ndarray,
    first: np.ndarray,
    hidden: np.ndarray,
    second: np.ndarray,
    senders: np.ndarray,
    offsets: np.ndarray,
    d_second: np.ndarray,
    d_bias: np.ndarray,
    d_constants: np.ndarray,
    on_senders: np.ndarray,
    on_receivers: np.ndarray,
    sent: bool,
) -> None:
    """Add the derivatives of what `message` computes to the last five arrays, given that by its sums."""
    width, most, unused = first.shape[1], most_rows(offsets), np.zeros_like(d_bias)
    on, out = np.empty((most, width), first.dtype), np.empty((most, width), first.dtype)
    square = np.empty((width, width), first.dtype)
    node = 0
    while node < len(offsets) - 1:
        last = next_nodes(offsets, node, len(offsets) - 1)
        rows, ends = slice(offsets[node], offsets[last]), offsets[node : last + 1]
        n = rows.stop - rows.start
        if n > 0:
            _of_edges(out[:n], of_sums[node:last], False, ends, on[:n])
            _gate(on[:n], hidden[rows], d_bias)
            np.dot(on[:n].T, first[rows], square)
            add_rows(square, d_second)
            np.dot(on[:n], second, out[:n])
            _gate(out[:n], first[rows], unused)
            add_rows(out[:n], d_constants[rows])
            _sum_at_ends(out[:n], senders[rows], ends, on_senders, on_receivers[node:last], sent)
        node = last


@compiled_with_free_sums
def layer_norm_derivative(
    on: np.ndarray,
    normed: np.ndarray,
    inverse: np.ndarray,
    scale: np.ndarray,
    d_scale: np.ndarray,
    d_shift: np.ndarray,
    d_bias: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill `out` with the derivative of a LayerNorm by what enters it, from that by its output `on`.

    Those by scale, shift and a bias before the norm are added to the arrays of that name.
    """
    width = on.shape[1]
    for row in range(on.shape[0]):
        mean, along = inverse[row] * _ZERO, inverse[row] * _ZERO
        for c in range(width):
            value = on[row, c]
            d_shift[c] += value
            d_scale[c] += value * normed[row, c]
            value *= scale[c]
            mean += value
            along += value * normed[row, c]
        mean /= on.dtype.type(width)
        along /= on.dtype.type(width)
        for c in range(width):
            value = inverse[row] * (on[row, c] * scale[c] - mean - normed[row, c] * along)
            out[row, c] = value
            d_bias[c] += value


@compiled_with_free_sums
def _through_layers(
    on: np.ndarray,
    rows: slice,
    between: tuple,
    layers: tuple,
    further: tuple,
    spare: np.ndarray,
    square: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill `out` with the derivative by the first layer's sum, from that by the norm's output `on`, of some `rows`.

    Those by the `layers` but the first weight are added to `further`, of the same order; `spare` (rows, width) and
    `square` (width, width) are written over.
    """
    first, hidden, normed, inverse = between
    layer_norm_derivative(on, normed[rows], inverse[rows], layers[6], further[6], further[7], further[5], out)
    np.dot(out.T, hidden[rows], square)
    add_rows(square, further[4])
    np.dot(out, layers[4], spare)
    _gate(spare, hidden[rows], further[3])
    np.dot(spare.T, first[rows], square)
    add_rows(square, further[2])
    np.dot(spare, layers[2], out)
    _gate(out, first[rows], further[1])


@compiled_with_free_sums
def _of_edges(on_new: np.ndarray, on_sums: np.ndarray, kept: bool, offsets: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (edges, width) with the row of each receiver in `on_sums`, and that of `on_new` where it is `kept`."""
    for node in range(len(offsets) - 1):
        for edge in range(offsets[node] - offsets[0], offsets[node + 1] - offsets[0]):
            for c in range(out.shape[1]):
                out[edge, c] = on_sums[node, c]
    if kept:
        add_rows(on_new, out)


@compiled_with_free_sums
def _sum_at_ends(
    values: np.ndarray,
    senders: np.ndarray,
    offsets: np.ndarray,
    at_senders: np.ndarray,
    at_receivers: np.ndarray,
    sent: bool,
) -> None:
    """Add the rows of edges to those of their receivers, and, where `sent`, of their senders."""
    for node in range(len(offsets) - 1):
        for edge in range(offsets[node] - offsets[0], offsets[node + 1] - offsets[0]):
            for c in range(values.shape[1]):
                at_receivers[node, c] += values[edge, c]
            if sent:
                sender = senders[edge]
                for c in range(values.shape[1]):
                    at_senders[sender, c] += values[edge, c]


@compiled_with_free_sums
def _gate(on: np.ndarray, rectified: np.ndarray, d_bias: np.ndarray) -> None:
    """Derivative of a ReLU, in place of that by its output `on` (rows, width); `d_bias` gains its sum over rows."""
    for row in range(on.shape[0]):
        for c in range(on.shape[1]):
            value = _ZERO if rectified[row, c] <= _ZERO else on[row, c]
            on[row, c] = value
            d_bias[c] += value
