"""What lies between the products of a network, compiled: each kernel is one pass over rows that stay in cache.

Rows that enter products are float32 or bfloat16. NumPy has no bfloat16, so such an array holds its 16 bits as uint16;
everything is computed in float32 and rounded to the nearest, ties to even, where it is stored. No allocations but one
row, no Python: several threads run them at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from pb4u.collision.jit import compiled_with_free_sums

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_HALF_WORD, _LAST_BIT, _BELOW_HALF = np.uint32(16), np.uint32(1), np.uint32(0x7FFF)


def _read(values: np.ndarray, row: int, column: int) -> Any:
    """Entry of an array in float32; known to the compiler alone."""
    raise NotImplementedError


@overload(_read, strict=False)
def _read_of(values: Any, row: Any, column: Any) -> Any:
    if isinstance(values.dtype, types.Float):
        return lambda values, row, column: values[row, column]
    return lambda values, row, column: np.uint32(np.uint32(values[row, column]) << _HALF_WORD).view(np.float32)


def _write(values: np.ndarray, row: int, column: int, value: Any) -> None:
    """Store a float32 in an array, rounded where it holds bfloat16; known to the compiler alone."""
    raise NotImplementedError


@overload(_write, strict=False)
def _write_of(values: Any, row: Any, column: Any, value: Any) -> Any:
    def store(values: Any, row: Any, column: Any, value: Any) -> None:
        values[row, column] = value

    def store_rounded(values: Any, row: Any, column: Any, value: Any) -> None:
        bits = np.float32(value).view(np.uint32)
        rounded = bits + _BELOW_HALF + ((bits >> _HALF_WORD) & _LAST_BIT)
        values[row, column] = np.uint16(rounded >> _HALF_WORD)

    return store if isinstance(values.dtype, types.Float) else store_rounded


def _write_copy(values: np.ndarray, row: int, column: int, value: Any) -> None:
    """Store in the rounded copy of an array of float32, which in float32 is that array itself."""
    raise NotImplementedError


@overload(_write_copy, strict=False)
def _write_copy_of(values: Any, row: Any, column: Any, value: Any) -> Any:
    def nothing(values: Any, row: Any, column: Any, value: Any) -> None:
        pass

    def store(values: Any, row: Any, column: Any, value: Any) -> None:
        _write(values, row, column, value)

    return nothing if isinstance(values.dtype, types.Float) else store


def _rectified(value: Any) -> Any:
    raise NotImplementedError


@overload(_rectified, strict=False)
def _rectified_of(value: Any) -> Any:
    # What is not a number stays so, and the step is found to have diverged.
    return lambda value: _ZERO if value < _ZERO else value


@compiled_with_free_sums
def rectify(values: np.ndarray, bias: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (rows, width) with ReLU(`values` + `bias`).

    Args:
        values: (rows, width) a product.
        bias: (width,) float32.
        out: overwritten.
    """
    for row in range(values.shape[0]):
        for c in range(values.shape[1]):
            _write(out, row, c, _rectified(_read(values, row, c) + bias[c]))


@compiled_with_free_sums
def first_layer_of_edges(
    own: np.ndarray,
    bias: np.ndarray,
    from_senders: np.ndarray,
    senders: np.ndarray,
    sender_step: int,
    sender_part: int,
    from_receivers: np.ndarray,
    receiver_step: int,
    receiver_part: int,
    offsets: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill `out` (edges, width) with ReLU(own share + share of the sender + share of the receiver + `bias`).

    A table has several rows of `width` for each node, one for every share that is read of it.

    Args:
        own: (edges, width) shares of the edges' own latents.
        bias: (width,) float32.
        from_senders: (nodes * sender_step, width) shares of senders.
        senders: (edges,) int64 node at the start of each edge.
        sender_step: rows of the table for each sender.
        sender_part: number of the row to read.
        from_receivers: (receivers * receiver_step, width) shares of the receivers, the first of them first.
        receiver_step: rows of the table for each receiver.
        receiver_part: number of the row to read.
        offsets: (receivers + 1,) int64 first edge of each receiver, and the end; `own` begins at the first of these.
        out: overwritten.
    """
    width, start = out.shape[1], offsets[0]
    received = np.empty(width, np.float32)
    for node in range(offsets.shape[0] - 1):
        row = node * receiver_step + receiver_part
        for c in range(width):
            received[c] = _read(from_receivers, row, c) + bias[c]
        for edge in range(offsets[node] - start, offsets[node + 1] - start):
            row = senders[edge] * sender_step + sender_part
            for c in range(width):
                total = _read(own, edge, c) + _read(from_senders, row, c) + received[c]
                _write(out, edge, c, _rectified(total))


@compiled_with_free_sums
def sums_of_rectified(values: np.ndarray, bias: np.ndarray, offsets: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (receivers, width) with the sums of ReLU(`values` + `bias`) over the edges of each receiver.

    Args:
        values: (edges, width) a product.
        bias: (width,) float32.
        offsets: (receivers + 1,) int64 first edge of each, and the end; `values` begins at the first of these.
        out: overwritten.
    """
    width, start = values.shape[1], offsets[0]
    total = np.empty(width, np.float32)
    for node in range(offsets.shape[0] - 1):
        for c in range(width):
            total[c] = _ZERO
        for edge in range(offsets[node] - start, offsets[node + 1] - start):
            for c in range(width):
                total[c] += _rectified(_read(values, edge, c) + bias[c])
        for c in range(width):
            _write(out, node, c, total[c])


@compiled_with_free_sums
def _inverse_length(values: np.ndarray, row: int, bias: np.ndarray, eps: float) -> Any:
    """1 / sqrt(|values[row] + bias|^2 + eps)."""
    square = eps
    for c in range(values.shape[1]):
        value = _read(values, row, c) + bias[c]
        square += value * value
    return _ONE / np.sqrt(square)


@compiled_with_free_sums
def normed_rows(
    values: np.ndarray,
    bias: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    eps: float,
    keep: bool,
    out: np.ndarray,
) -> None:
    """Fill `out` (rows, width) with the LayerNorm of `values` + `bias`, whose rows have a mean of 0, or add it.

    Args:
        values: (rows, width) a product, divided by the root of the width.
        bias: (width,) float32, likewise.
        scale: (width,) float32, multiplied by that root.
        shift: (width,) float32.
        eps: added to the variance.
        keep: whether what `out` holds is added to.
        out: (rows, width) float32, overwritten.
    """
    for row in range(values.shape[0]):
        factor = _inverse_length(values, row, bias, eps)
        for c in range(values.shape[1]):
            value = (_read(values, row, c) + bias[c]) * factor * scale[c] + shift[c]
            out[row, c] = value + out[row, c] if keep else value


@compiled_with_free_sums
def normed_edges(
    values: np.ndarray,
    bias: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    eps: float,
    offsets: np.ndarray,
    keep: bool,
    latents: np.ndarray,
    rounded: np.ndarray,
    sums: np.ndarray,
    sums_step: int,
    sums_part: int,
) -> None:
    """Sum the LayerNorm of the edges' `values` + `bias` at their receivers, and add it to their latents.

    Args:
        values: (edges, width) as in `normed_rows`, and `bias`, `scale`, `shift` and `eps` with it.
        bias: (width,) float32.
        scale: (width,) float32.
        shift: (width,) float32.
        eps: added to the variance.
        offsets: (receivers + 1,) int64 first edge of each, and the end; `values` begins at the first of these.
        keep: whether latents are wanted any more.
        latents: (edges, width) float32, added to.
        rounded: (edges, width) copy of the latents for products; in float32 the latents themselves.
        sums: (receivers * sums_step, width); row `sums_part` of each receiver is overwritten.
        sums_step: rows of each receiver.
        sums_part: number of the row.
    """
    width, start = values.shape[1], offsets[0]
    total = np.empty(width, np.float32)
    for node in range(offsets.shape[0] - 1):
        for c in range(width):
            total[c] = _ZERO
        for edge in range(offsets[node] - start, offsets[node + 1] - start):
            factor = _inverse_length(values, edge, bias, eps)
            if keep:
                for c in range(width):
                    value = (_read(values, edge, c) + bias[c]) * factor * scale[c] + shift[c]
                    total[c] += value
                    value += latents[edge, c]
                    latents[edge, c] = value
                    _write_copy(rounded, edge, c, value)
            else:
                for c in range(width):
                    total[c] += (_read(values, edge, c) + bias[c]) * factor * scale[c] + shift[c]
        for c in range(width):
            _write(sums, node * sums_step + sums_part, c, total[c])


@compiled_with_free_sums
def propagate(
    messages: np.ndarray,
    bias: np.ndarray,
    offsets: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    eps: float,
    decay: float,
    accumulated: bool,
    state: np.ndarray,
    rounded: np.ndarray,
) -> None:
    """Move the state of nodes by the sums of their messages: `PropagationForm.norm` of either name.

    Args:
        messages: (nodes, width) sums of messages without the bias of their last layer.
        bias: (width,) float32 that every message has.
        offsets: (nodes + 1,) int64 first edge of each node, and the end.
        scale: (width,) float32 of the LayerNorm.
        shift: (width,) float32.
        eps: added to the variance.
        decay: gamma.
        accumulated: whether the LayerNorm is of the decayed state and messages, not of messages alone.
        state: (nodes, width) float32, overwritten.
        rounded: (nodes, width) copy of it for products; in float32 the state itself.
    """
    width = state.shape[1]
    inside, outside = (decay, _ZERO) if accumulated else (_ZERO, decay)
    row = np.empty(width, np.float32)
    for node in range(state.shape[0]):
        degree = np.float32(offsets[node + 1] - offsets[node])
        mean = _ZERO
        for c in range(width):
            value = _read(messages, node, c) + degree * bias[c] + inside * state[node, c]
            row[c] = value
            mean += value
        mean /= np.float32(width)
        square = _ZERO
        for c in range(width):
            square += (row[c] - mean) * (row[c] - mean)
        factor = _ONE / np.sqrt(square / np.float32(width) + eps)
        for c in range(width):
            value = outside * state[node, c] + (row[c] - mean) * factor * scale[c] + shift[c]
            state[node, c] = value
            _write_copy(rounded, node, c, value)
