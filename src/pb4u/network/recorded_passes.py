"""Perceptrons, edges and propagation while gradients are recorded on a processor, each with its derivative by hand.

Some hundred rows at a time go through all layers and stay in cache: with all rows at once, a product waited for memory
two thirds of its time. The same layers in torch's operations, which accelerators take, are the slow form that tests
compare with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from pb4u.collision.jit import compiled_with_free_sums
from pb4u.network.graph.incidence import Incidence

Gradients: TypeAlias = tuple[Tensor | None, ...]
Layers: TypeAlias = tuple[nn.Linear, nn.Linear, nn.LayerNorm]

_ROWS = 256
"""Rows at a time: five arrays of 64 columns take 320 kB, and products of fewer rows are slower."""

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@dataclass(frozen=True, eq=False)
class Ends:
    """Both ends of edges in ascending order of receiver.

    Args:
        senders: node at the start of each edge; None where its share of the first layer is in the edge's own.
        receivers: node at the end of each.
    """

    senders: Incidence | None
    receivers: Incidence

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Sender (edges,) int64 of each edge, 0 where there is none, and first edge (nodes + 1,) of each receiver."""
        index = self.receivers.index
        senders = torch.zeros_like(index) if self.senders is None else self.senders.index
        return senders.numpy(), self.receivers.offsets.numpy()


def records(values: Tensor, weight: Tensor, *receivers: Incidence) -> bool:
    """Whether these passes take `values`: gradients are recorded, and a processor computes in float32 or float64.

    Args:
        values: (rows, columns) that enter.
        weight: of the layers that they meet, of any shape.
        receivers: of the edges that they pass over; the kernels have no row for edges that are only room.
    """
    return (
        torch.is_grad_enabled()
        and not any(end.spare for end in receivers)
        and values.device.type == "cpu"
        and values.dtype == weight.dtype
        and values.dtype in (torch.float32, torch.float64)
    )


def normed_perceptron(values: Tensor, weight: Tensor | None, bias: Tensor, layers: Layers) -> Tensor:
    """Output (rows, width) [1] of a perceptron.

    Args:
        values: (rows, inputs) [1] that enter; (rows, width) the first layer's sum without its bias where no `weight` is
            given.
        weight: (width, inputs) [1] of the first layer.
        bias: (width,) [1] of it.
        layers: the second layer, the last and the norm, all `width` wide.
    """
    output: Tensor = _Perceptron.apply(layers[2].eps, values, weight, bias, *_weights(layers))  # type: ignore[no-untyped-call]
    return output


def passed_edges(
    latents: Tensor,
    from_senders: Tensor,
    from_receivers: Tensor,
    weight: Tensor,
    bias: Tensor,
    layers: Layers,
    ends: Ends,
) -> tuple[Tensor, Tensor]:
    """New latents (edges, width) of edges, and sums (receivers, width) of what was added to them, all [1].

    Args:
        latents: (edges, width) [1] before.
        from_senders: (nodes, width) [1] shares of senders in the first layer's sum.
        from_receivers: (receivers, width) [1] shares of receivers.
        weight: (width, width) [1] columns of the first layer that meet the latents.
        bias: (width,) [1] of that layer.
        layers: the second, the last and the norm.
        ends: of the edges.
    """
    given = (latents, from_senders, from_receivers, weight, bias, *_weights(layers))
    new, sums = _EdgePass.apply(layers[2].eps, ends, *given)  # type: ignore[no-untyped-call]
    return new, sums


def propagated(
    steps: int,
    state: Tensor,
    constants: Sequence[Tensor],
    weights: tuple[Tensor, Tensor],
    layers: Layers,
    decay: float,
    inflows: Sequence[Ends],
) -> Tensor:
    """State (vertices, width) [1] after steps h <- gamma h + LayerNorm(sum of messages).

    Args:
        steps: how many.
        state: (vertices, width) [1] before.
        constants: (edges, width) [1] for each set of edges, the part of the first layer's sum that stays the same.
        weights: (width, width) [1] each, columns of the first layer that meet senders and receivers.
        layers: the second and the last of a message, and the norm of a step.
        decay: gamma.
        inflows: ends of each set of edges.
    """
    given = (state, *weights, *_weights(layers), *constants)
    after: Tensor = _Propagation.apply(steps, decay, layers[2].eps, inflows, *given)  # type: ignore[no-untyped-call]
    return after


def _weights(layers: Layers) -> tuple[Tensor, ...]:
    second, last, norm = layers
    return second.weight, second.bias, last.weight, last.bias, norm.weight, norm.bias


class _Perceptron(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, eps: float, values: Tensor, weight: Tensor | None, *rest: Tensor) -> Tensor:
        values = values.contiguous()
        ctx.weighted = weight is not None
        weights = (values if weight is None else weight, *rest)
        between, out = _between(values, len(rest[0])), values.new_empty(len(values), len(rest[0]))
        ctx.save_for_backward(values, *weights, *between)
        given, *layers = _arrays(values, *weights)
        eps = layers[0].dtype.type(eps)
        _perceptron(given, ctx.weighted, tuple(layers), eps, tuple(_arrays(*between)), _array(out))
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Gradients:
        values, *saved = ctx.saved_tensors
        further, on_values = [torch.zeros_like(weight) for weight in saved[:-4]], torch.empty_like(values)
        on, given, *arrays = _arrays(gradients[0].contiguous(), values, *saved)
        layers, between, wanted = tuple(arrays[:-4]), tuple(arrays[-4:]), ctx.needs_input_grad[1]
        _perceptron_derivative(
            on, given, ctx.weighted, layers, between, tuple(_arrays(*further)), wanted, _array(on_values)
        )
        return None, on_values if wanted else None, further[0] if ctx.weighted else None, *further[1:]


class _EdgePass(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, eps: float, ends: Ends, *given: Tensor) -> Any:
        tensors = [each.contiguous() for each in given]
        between = _between(tensors[0], tensors[0].shape[1])
        ctx.save_for_backward(*tensors, *between)
        ctx.ends = ends
        ctx.set_materialize_grads(False)
        latents, at_sender, at_receiver, *layers = _arrays(*tensors)
        new, sums = torch.empty_like(tensors[0]), torch.empty_like(tensors[2])
        shares, eps = (at_sender, at_receiver, *ends.arrays()), latents.dtype.type(eps)
        _pass_edges(latents, shares, tuple(layers), eps, tuple(_arrays(*between)), *_arrays(new, sums))
        return new, sums

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> Gradients:
        tensors, between = ctx.saved_tensors[:-4], tuple(_arrays(*ctx.saved_tensors[-4:]))
        latents, _, _, *layers = _arrays(*tensors)
        further, on_latents = [torch.zeros_like(each) for each in tensors[1:]], torch.empty_like(tensors[0])
        of_new, of_sums = gradients
        on_sums = torch.zeros_like(tensors[2]) if of_sums is None else of_sums.contiguous()
        # Where nothing reads the new latents any more, any array stands for their derivative.
        on_new = on_latents if of_new is None else of_new.contiguous()
        on = (*_arrays(on_new, on_sums), of_new is not None)
        changed = tuple(_arrays(*further)), _array(on_latents)
        given = (*on, latents, *ctx.ends.arrays(), tuple(layers), between, *changed)
        _pass_edges_derivative(*given)
        return None, None, on_latents, *further


class _Propagation(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, steps: int, decay: float, eps: float, inflows: Sequence[Ends], *given: Tensor) -> Tensor:
        state, *tensors = [each.contiguous() for each in given]
        of_sender, of_receiver, second, second_bias, last, last_bias, scale, shift, *constants = tensors
        degrees = torch.stack([ends.receivers.offsets.diff() for ends in inflows]).sum(0).to(state)[:, None]
        nothing, small, taken = _array(torch.zeros_like(scale)), _array(state).dtype.type(eps), []
        for _ in range(steps):
            shares = _arrays(state.mm(of_sender.t()), state.mm(of_receiver.t()))
            sums = torch.zeros_like(state)
            messages = []
            for ends, constant in zip(inflows, constants, strict=True):
                between, sent = (torch.empty_like(constant), torch.empty_like(constant)), ends.senders is not None
                kept = (*_arrays(second, second_bias, *between, sums), sent)
                _message(_array(constant), (*shares, *ends.arrays()), *kept)  # type: ignore[arg-type]
                messages.append(between)
            values = torch.addmm(degrees * last_bias, sums, last.t())
            inverse, after = values.new_empty(len(values)), torch.empty_like(values)
            normed = (*_arrays(scale, shift), small, *_arrays(inverse, after))
            _norm(_array(values), nothing, *normed)
            taken.append((state, messages, sums, values, inverse))
            state = after.add_(state, alpha=decay)
        ctx.save_for_backward(*tensors)
        ctx.taken, ctx.inflows, ctx.decay, ctx.degrees = taken, inflows, decay, degrees
        return state

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Gradients:
        of_sender, of_receiver, second, _, last, _, scale, *_ = ctx.saved_tensors
        further = [torch.zeros_like(each) for each in ctx.saved_tensors]
        d_sender, d_receiver, d_second, d_second_bias, d_last, d_last_bias, d_scale, d_shift, *d_constants = further
        on, unused = gradients[0].contiguous(), torch.zeros_like(scale)
        for state, messages, sums, values, inverse in reversed(ctx.taken):
            of_total = torch.empty_like(values)
            _norm_derivative(*_arrays(on, values, inverse, scale, d_scale, d_shift, unused, of_total))
            d_last.addmm_(of_total.t(), sums)
            d_last_bias += (ctx.degrees * of_total).sum(0)
            of_sums = of_total.mm(last)
            on_ends = torch.zeros_like(state), torch.zeros_like(state)
            for ends, between, d_constant in zip(ctx.inflows, messages, d_constants, strict=True):
                changed = _arrays(d_second, d_second_bias, d_constant, *on_ends)
                given = (*_arrays(of_sums, *between, second), *ends.arrays(), *changed, ends.senders is not None)
                _message_derivative(*given)
            on = on * ctx.decay
            for share, of_end, d_end in zip(on_ends, (of_sender, of_receiver), (d_sender, d_receiver), strict=True):
                d_end.addmm_(share.t(), state)
                on.addmm_(share, of_end)
        # What the steps left is large, and a second derivative is not for these passes.
        ctx.taken = None
        return None, None, None, None, on, *further


def _between(values: Tensor, width: int) -> tuple[Tensor, ...]:
    """What the derivative reads again: hidden layers and output of the norm (rows, width), its (rows,) factors."""
    rows = len(values)
    return (*(values.new_empty(rows, width) for _ in range(3)), values.new_empty(rows))


def _array(values: Tensor) -> np.ndarray:
    array: np.ndarray = values.detach().numpy()
    return array


def _arrays(*values: Tensor) -> list[np.ndarray]:
    return [_array(each) for each in values]


@compiled_with_free_sums
def _next_nodes(offsets: np.ndarray, first: int) -> int:
    """End of the nodes from `first` whose edges are `_ROWS` at most, or of one node alone."""
    last = first + 1
    while last < len(offsets) - 1 and offsets[last + 1] - offsets[first] <= _ROWS:
        last += 1
    return last


@compiled_with_free_sums
def _most_rows(offsets: np.ndarray) -> int:
    """Rows that the edges of `_next_nodes` need."""
    most = _ROWS
    for node in range(len(offsets) - 1):
        most = max(most, offsets[node + 1] - offsets[node])
    return most


@compiled_with_free_sums
def _later_layers(first: np.ndarray, layers: tuple, hidden: np.ndarray, values: np.ndarray) -> None:
    """Fill `hidden` with the second layer, and `values` with the product of the last, (rows, width) each.

    `layers` are the weights and biases of all three layers, in order, and scale and shift of the norm.
    """
    np.dot(first, layers[2].T, hidden)
    _rectify(hidden, layers[3])
    np.dot(hidden, layers[4].T, values)


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
    _norm_derivative(on, normed[rows], inverse[rows], layers[6], further[6], further[7], further[5], out)
    np.dot(out.T, hidden[rows], square)
    _add(square, further[4])
    np.dot(out, layers[4], spare)
    _gate(spare, hidden[rows], further[3])
    np.dot(spare.T, first[rows], square)
    _add(square, further[2])
    np.dot(spare, layers[2], out)
    _gate(out, first[rows], further[1])


@compiled_with_free_sums
def _perceptron(values: np.ndarray, weighted: bool, layers: tuple, eps: Any, between: tuple, out: np.ndarray) -> None:
    """Fill `between` and `out` (rows, width) for `values` (rows, inputs), the first layer's sums unless `weighted`."""
    first, hidden, normed, inverse = between
    for start in range(0, len(values), _ROWS):
        rows = slice(start, min(start + _ROWS, len(values)))
        if weighted:
            np.dot(values[rows], layers[0].T, first[rows])
        else:
            first[rows] = values[rows]
        _rectify(first[rows], layers[1])
        _later_layers(first[rows], layers, hidden[rows], normed[rows])
        _norm(normed[rows], layers[5], layers[6], layers[7], eps, inverse[rows], out[rows])


@compiled_with_free_sums
def _perceptron_derivative(
    on: np.ndarray,
    values: np.ndarray,
    weighted: bool,
    layers: tuple,
    between: tuple,
    further: tuple,
    wanted: bool,
    on_values: np.ndarray,
) -> None:
    """Add the derivatives by `layers` to `further`, and fill `on_values` with that by `values` where it is `wanted`."""
    width = on.shape[1]
    spare, out = np.empty((_ROWS, width), on.dtype), np.empty((_ROWS, width), on.dtype)
    square, entering = np.empty((width, width), on.dtype), np.empty(layers[0].shape, on.dtype)
    for start in range(0, len(values), _ROWS):
        rows = slice(start, min(start + _ROWS, len(values)))
        n = rows.stop - start
        _through_layers(on[rows], rows, between, layers, further, spare[:n], square, out[:n])
        if weighted:
            np.dot(out[:n].T, values[rows], entering)
            _add(entering, further[0])
            if wanted:
                np.dot(out[:n], layers[0], on_values[rows])
        else:
            on_values[rows] = out[:n]


@compiled_with_free_sums
def _pass_edges(
    latents: np.ndarray, shares: tuple, layers: tuple, eps: Any, between: tuple, new: np.ndarray, sums: np.ndarray
) -> None:
    """Fill `between`, `new` (edges, width) and `sums` (receivers, width); see `passed_edges`.

    `shares` are those of senders and receivers, the senders (edges,) and the first edge of each receiver.
    """
    from_senders, from_receivers, senders, offsets = shares
    first, hidden, normed, inverse = between
    node = 0
    while node < len(offsets) - 1:
        last = _next_nodes(offsets, node)
        rows, ends = slice(offsets[node], offsets[last]), offsets[node : last + 1]
        if rows.stop > rows.start:
            np.dot(latents[rows], layers[0].T, first[rows])
            _join(first[rows], layers[1], from_senders, senders[rows], from_receivers[node:last], ends, True)
            _later_layers(first[rows], layers, hidden[rows], normed[rows])
            _norm(normed[rows], layers[5], layers[6], layers[7], eps, inverse[rows], new[rows])
        _sum_and_add(latents[rows], ends, new[rows], sums[node:last])
        node = last


@compiled_with_free_sums
def _pass_edges_derivative(
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
    width, most = latents.shape[1], _most_rows(offsets)
    on, spare = np.empty((most, width), latents.dtype), np.empty((most, width), latents.dtype)
    out, square = np.empty((most, width), latents.dtype), np.empty((width, width), latents.dtype)
    node = 0
    while node < len(offsets) - 1:
        last = _next_nodes(offsets, node)
        rows, ends = slice(offsets[node], offsets[last]), offsets[node : last + 1]
        n = rows.stop - rows.start
        if n > 0:
            _of_edges(on_new[rows], on_sums[node:last], kept, ends, on[:n])
            _through_layers(on[:n], rows, between, layers, of_layers, spare[:n], square, out[:n])
            np.dot(out[:n].T, latents[rows], square)
            _add(square, of_layers[0])
            _sum_at_ends(out[:n], senders[rows], ends, further[0], further[1][node:last], True)
            np.dot(out[:n], layers[0], on_latents[rows])
            if kept:
                _add(on_new[rows], on_latents[rows])
        node = last


@compiled_with_free_sums
def _message(
    constants: np.ndarray,
    shares: tuple,
    second: np.ndarray,
    bias: np.ndarray,
    first: np.ndarray,
    hidden: np.ndarray,
    sums: np.ndarray,
    sent: bool,
) -> None:
    """Add what enters the last layer of messages to its `sums` (receivers, width); `shares` as in `_pass_edges`.

    `constants` (edges, width) enter the first layer; those of senders do too where they are `sent`. Both layers,
    `first` and `hidden` (edges, width), are filled.
    """
    from_senders, from_receivers, senders, offsets = shares
    nothing, node = np.zeros_like(bias), 0
    while node < len(offsets) - 1:
        last = _next_nodes(offsets, node)
        rows, ends = slice(offsets[node], offsets[last]), offsets[node : last + 1]
        if rows.stop > rows.start:
            first[rows] = constants[rows]
            _join(first[rows], nothing, from_senders, senders[rows], from_receivers[node:last], ends, sent)
            np.dot(first[rows], second.T, hidden[rows])
            _rectify(hidden[rows], bias)
            _sum_at_ends(hidden[rows], senders[rows], ends, sums, sums[node:last], False)
        node = last


@compiled_with_free_sums
def _message_derivative(
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
    """Add the derivatives of what `_message` computes to the last five arrays, given that by its sums."""
    width, most, unused = first.shape[1], _most_rows(offsets), np.zeros_like(d_bias)
    on, out = np.empty((most, width), first.dtype), np.empty((most, width), first.dtype)
    square = np.empty((width, width), first.dtype)
    node = 0
    while node < len(offsets) - 1:
        last = _next_nodes(offsets, node)
        rows, ends = slice(offsets[node], offsets[last]), offsets[node : last + 1]
        n = rows.stop - rows.start
        if n > 0:
            _of_edges(out[:n], of_sums[node:last], False, ends, on[:n])
            _gate(on[:n], hidden[rows], d_bias)
            np.dot(on[:n].T, first[rows], square)
            _add(square, d_second)
            np.dot(on[:n], second, out[:n])
            _gate(out[:n], first[rows], unused)
            _add(out[:n], d_constants[rows])
            _sum_at_ends(out[:n], senders[rows], ends, on_senders, on_receivers[node:last], sent)
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
) -> None:
    """ReLU(`values` + share of the sender, if `sent`, + share of the receiver + `bias`) of (edges, width), in place."""
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
                    values[edge, c] = _ZERO if value < _ZERO else value
            else:
                for c in range(width):
                    value = values[edge, c] + received[c]
                    values[edge, c] = _ZERO if value < _ZERO else value


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
def _of_edges(on_new: np.ndarray, on_sums: np.ndarray, kept: bool, offsets: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` (edges, width) with the row of each receiver in `on_sums`, and that of `on_new` where it is `kept`."""
    for node in range(len(offsets) - 1):
        for edge in range(offsets[node] - offsets[0], offsets[node + 1] - offsets[0]):
            for c in range(out.shape[1]):
                out[edge, c] = on_sums[node, c]
    if kept:
        _add(on_new, out)


@compiled_with_free_sums
def _add(values: np.ndarray, total: np.ndarray) -> None:
    for row in range(total.shape[0]):
        for c in range(total.shape[1]):
            total[row, c] += values[row, c]


@compiled_with_free_sums
def _norm(
    values: np.ndarray,
    bias: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    eps: Any,
    inverse: np.ndarray,
    out: np.ndarray,
) -> None:
    """Centre and scale rows of `values` + `bias`, in place; `out` is their LayerNorm, `inverse` (rows,) the factors."""
    width = values.shape[1]
    for row in range(values.shape[0]):
        mean, square = eps * _ZERO, eps * _ZERO
        for c in range(width):
            value = values[row, c] + bias[c]
            values[row, c] = value
            mean += value
        mean /= values.dtype.type(width)
        for c in range(width):
            value = values[row, c] - mean
            square += value * value
        factor = _ONE / np.sqrt(square / values.dtype.type(width) + eps)
        inverse[row] = factor
        for c in range(width):
            value = (values[row, c] - mean) * factor
            values[row, c] = value
            out[row, c] = value * scale[c] + shift[c]


@compiled_with_free_sums
def _norm_derivative(
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
def _gate(on: np.ndarray, rectified: np.ndarray, d_bias: np.ndarray) -> None:
    """Derivative of a ReLU, in place of that by its output `on` (rows, width); `d_bias` gains its sum over rows."""
    for row in range(on.shape[0]):
        for c in range(on.shape[1]):
            value = _ZERO if rectified[row, c] <= _ZERO else on[row, c]
            on[row, c] = value
            d_bias[c] += value
