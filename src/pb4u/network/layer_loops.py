"""Loops over the rows of perceptrons, edges and messages, compiled for a processor.

Arrays are float32 or float64. `between` are the hidden layers and the norm's output (rows, width) each, and the norm's
factors (rows,), which the derivative reads again, or none of them has rows; `layers` are weights and biases of three
layers, in order, and scale and shift of the norm, as `turned` gives them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pb4u.collision.jit import compiled_with_free_sums

ROWS = 128
"""Rows at a time: five arrays of 32 columns take 80 kB, and products of fewer rows are slower."""

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@compiled_with_free_sums
def next_nodes(offsets: np.ndarray, first: int, stop: int) -> int:
    """End of the nodes from `first` on, before `stop`, whose edges are `ROWS` at most, or of one node alone."""
    last = first + 1
    while last < stop and offsets[last + 1] - offsets[first] <= ROWS:
        last += 1
    return last


@compiled_with_free_sums
def most_rows(offsets: np.ndarray) -> int:
    """Rows that the edges of `next_nodes` need."""
    most = ROWS
    for node in range(len(offsets) - 1):
        most = max(most, offsets[node + 1] - offsets[node])
    return most


@compiled_with_free_sums
def turned(layers: tuple) -> tuple:
    """The `layers` as `perceptron` and `edge_pass` read them.

    Weights are (inputs, width), by which the library multiplies half as fast again. The last layer's outputs have zero
    mean over columns, which the norm would subtract anyway.
    """
    width, last, bias = layers[4].shape[0], layers[4].copy(), layers[5].copy()
    for column in range(width):
        mean = np.sum(layers[4][:, column]) / last.dtype.type(width)
        for row in range(width):
            last[row, column] -= mean
    bias -= np.sum(bias) / bias.dtype.type(width)
    return layers[0].T.copy(), layers[1], layers[2].T.copy(), layers[3], last.T.copy(), bias, layers[6], layers[7]


@compiled_with_free_sums
def _room(between: tuple, rows: int, width: int) -> tuple:
    """`between`, or room for so many `rows` at a time where it has none since nothing is kept."""
    first, hidden, normed, inverse = between
    if len(first) == 0:
        shape, kind = (rows, width), first.dtype
        return np.empty(shape, kind), np.empty(shape, kind), np.empty(shape, kind), np.empty(rows, kind)
    return first, hidden, normed, inverse


@compiled_with_free_sums
def _later_layers(first: np.ndarray, layers: tuple, eps: Any, between: tuple, out: np.ndarray) -> None:
    """Fill the rest of `between` and `out` (rows, width) from the `first` layer."""
    hidden, normed, inverse = between
    np.dot(first, layers[2], hidden)
    _rectify(hidden, layers[3])
    np.dot(hidden, layers[4], normed)
    centred_norm(normed, layers[5], layers[6], layers[7], eps, inverse, out)


@compiled_with_free_sums
def perceptron(
    values: np.ndarray, layers: tuple, eps: Any, between: tuple, out: np.ndarray, begin: int, stop: int
) -> None:
    """Fill `between`, where it has rows, and `out` (rows, width) for the rows `begin` to `stop` of `values`."""
    kept = len(between[0]) > 0
    first, hidden, normed, inverse = _room(between, ROWS, out.shape[1])
    for start in range(begin, stop, ROWS):
        rows = slice(start, min(start + ROWS, stop))
        own = rows if kept else slice(0, rows.stop - start)
        np.dot(values[rows], layers[0], first[own])
        _rectify(first[own], layers[1])
        _later_layers(first[own], layers, eps, (hidden[own], normed[own], inverse[own]), out[rows])


@compiled_with_free_sums
def edge_pass(
    latents: np.ndarray,
    shares: tuple,
    layers: tuple,
    eps: Any,
    between: tuple,
    new: np.ndarray,
    sums: np.ndarray,
    begin: int,
    stop: int,
) -> None:
    """Fill `between`, where it has rows, `new` (edges, width) and `sums` (receivers, width); see `passed_edges`.

    For the receivers from `begin` to `stop`. `shares` are those of senders and receivers, the senders (edges,) and the
    first edge of each receiver.
    """
    from_senders, from_receivers, senders, offsets = shares
    kept, node = len(between[0]) > 0, begin
    first, hidden, normed, inverse = _room(between, most_rows(offsets[begin : stop + 1]), new.shape[1])
    while node < stop:
        last = next_nodes(offsets, node, stop)
        rows, ends = slice(offsets[node], offsets[last]), offsets[node : last + 1]
        if rows.stop > rows.start:
            own = rows if kept else slice(0, rows.stop - rows.start)
            np.dot(latents[rows], layers[0], first[own])
            _join(first[own], layers[1], from_senders, senders[rows], from_receivers[node:last], ends, True, first[own])
            _later_layers(first[own], layers, eps, (hidden[own], normed[own], inverse[own]), new[rows])
        _sum_and_add(latents[rows], ends, new[rows], sums[node:last])
        node = last


@compiled_with_free_sums
def propagation_step(
    inflows: tuple, before: tuple, layers: tuple, eps: Any, decay: Any, after: tuple, begin: int, stop: int
) -> None:
    """Fill what a step of propagation makes, for the nodes from `begin` to `stop`.

    `inflows` are, for each set of edges, what `_add_messages` reads. `before` are the state (nodes, width), its shares
    at senders and at receivers, and to be filled the sums of messages, what the norm scales, and its factors; `after`
    are the state after the step and its shares. `layers` are the second of a message and its bias, the last, the bias
    of all messages of each node (nodes, width), scale and shift of the norm, and the weights that meet senders and
    receivers; weights are (inputs, width), and the last layer's outputs without mean.
    """
    state, at_senders, at_receivers, sums, values, inverse = before
    new, new_at_senders, new_at_receivers = after
    second, second_bias, last, biases, scale, shift, of_sender, of_receiver = layers
    no_bias = np.zeros_like(scale)
    for first in range(begin, stop, ROWS):
        own = slice(first, min(first + ROWS, stop))
        sums[own] = _ZERO
        for inflow in inflows:
            _add_messages(inflow, at_senders, at_receivers, second, second_bias, sums, own.start, own.stop)
        np.dot(sums[own], last, values[own])
        add_rows(biases[own], values[own])
        centred_norm(values[own], no_bias, scale, shift, eps, inverse[own], new[own])
        for row in range(own.start, own.stop):
            for c in range(state.shape[1]):
                new[row, c] += decay * state[row, c]
        np.dot(new[own], of_sender, new_at_senders[own])
        np.dot(new[own], of_receiver, new_at_receivers[own])


@compiled_with_free_sums
def _add_messages(
    inflow: tuple,
    from_senders: np.ndarray,
    from_receivers: np.ndarray,
    second: np.ndarray,
    bias: np.ndarray,
    sums: np.ndarray,
    begin: int,
    stop: int,
) -> None:
    """Add what enters the last layer of messages to its `sums` (receivers, width).

    An `inflow` are constants (edges, width), which enter the first layer, senders (edges,), the first edge of each
    receiver, both layers (edges, width), which are filled where they have rows, and whether senders have a share.
    """
    constants, senders, offsets, first, hidden, sent = inflow
    kept, nothing, node = len(first) > 0, np.zeros_like(bias), begin
    if not kept:
        first = np.empty((most_rows(offsets[begin : stop + 1]), len(bias)), bias.dtype)
        hidden = np.empty_like(first)
    while node < stop:
        last = next_nodes(offsets, node, stop)
        rows, ends = slice(offsets[node], offsets[last]), offsets[node : last + 1]
        if rows.stop > rows.start:
            own = rows if kept else slice(0, rows.stop - rows.start)
            at_receivers = from_receivers[node:last]
            _join(constants[rows], nothing, from_senders, senders[rows], at_receivers, ends, sent, first[own])
            np.dot(first[own], second, hidden[own])
            _rectify_and_sum(hidden[own], bias, ends, sums[node:last])
        node = last


@compiled_with_free_sums
def _rectify(values: np.ndarray, bias: np.ndarray) -> None:
    """ReLU(`values` + `bias`) of (rows, width), in place; what is not a number stays so."""
    for row in range(values.shape[0]):
        for c in range(values.shape[1]):
            value = values[row, c] + bias[c]
            values[row, c] = _ZERO if value < _ZERO else value


@compiled_with_free_sums
def _join(
    values: np.ndarray,
    bias: np.ndarray,
    from_senders: np.ndarray,
    senders: np.ndarray,
    from_receivers: np.ndarray,
    offsets: np.ndarray,
    sent: bool,
    out: np.ndarray,
) -> None:
    """Fill `out` with ReLU(`values` + share of the sender, if `sent`, + share of the receiver + `bias`), by edge."""
    width = values.shape[1]
    received = np.empty(width, values.dtype)
    for node in range(len(offsets) - 1):
        for c in range(width):
            received[c] = from_receivers[node, c] + bias[c]
        for edge in range(offsets[node] - offsets[0], offsets[node + 1] - offsets[0]):
            if sent:
                sender = senders[edge]
                for c in range(width):
                    value = values[edge, c] + from_senders[sender, c] + received[c]
                    out[edge, c] = _ZERO if value < _ZERO else value
            else:
                for c in range(width):
                    value = values[edge, c] + received[c]
                    out[edge, c] = _ZERO if value < _ZERO else value


@compiled_with_free_sums
def _rectify_and_sum(values: np.ndarray, bias: np.ndarray, offsets: np.ndarray, sums: np.ndarray) -> None:
    """ReLU(`values` + `bias`) of (edges, width), in place; the rows are added to those of their receivers in `sums`."""
    for node in range(len(offsets) - 1):
        for edge in range(offsets[node] - offsets[0], offsets[node + 1] - offsets[0]):
            for c in range(values.shape[1]):
                value = values[edge, c] + bias[c]
                value = _ZERO if value < _ZERO else value
                values[edge, c] = value
                sums[node, c] += value


@compiled_with_free_sums
def _sum_and_add(latents: np.ndarray, offsets: np.ndarray, new: np.ndarray, sums: np.ndarray) -> None:
    """Fill `sums` (receivers, width) with those of `new` (edges, width), to which then the `latents` are added."""
    for node in range(len(offsets) - 1):
        for c in range(new.shape[1]):
            sums[node, c] = _ZERO
        for edge in range(offsets[node] - offsets[0], offsets[node + 1] - offsets[0]):
            for c in range(new.shape[1]):
                value = new[edge, c]
                sums[node, c] += value
                new[edge, c] = value + latents[edge, c]


@compiled_with_free_sums
def add_rows(values: np.ndarray, total: np.ndarray) -> None:
    """Add `values` (rows, width) to the `total` of the same shape."""
    for row in range(total.shape[0]):
        for c in range(total.shape[1]):
            total[row, c] += values[row, c]


@compiled_with_free_sums
def centred_norm(
    values: np.ndarray,
    bias: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    eps: Any,
    inverse: np.ndarray,
    out: np.ndarray,
) -> None:
    """Scale rows of `values` + `bias`, whose mean is 0, in place; `out` is their LayerNorm, `inverse` the factors."""
    width = values.shape[1]
    for row in range(values.shape[0]):
        square = eps * _ZERO
        for c in range(width):
            value = values[row, c] + bias[c]
            values[row, c] = value
            square += value * value
        factor = _ONE / np.sqrt(square / values.dtype.type(width) + eps)
        inverse[row] = factor
        for c in range(width):
            value = values[row, c] * factor
            values[row, c] = value
            out[row, c] = value * scale[c] + shift[c]
