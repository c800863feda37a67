"""Layers of a network as a processor computes them: autograd functions around compiled loops.

Some hundred rows at a time go through all layers and stay in cache (`layer_loops`): with all rows at once, a product
waited for memory two thirds of its time. Threads share the rows out. The same layers in torch's operations, which
accelerators take, are the slow form that tests compare with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from pb4u.network import layer_derivatives as derivatives, layer_loops as loops
from pb4u.network.graph.incidence import Incidence
from pb4u.threads import parallel_map

Gradients: TypeAlias = tuple[Tensor | None, ...]
Layers: TypeAlias = tuple[nn.Linear, nn.Linear, nn.LayerNorm]


_SHARED_ROWS, _SHARED_NODES = 4096, 640
"""Rows 64 wide, and nodes with some four thousand edges, that a thread takes at a time, so that results are the same
for any number of threads; to begin another takes 0.2 ms."""


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
        """Sender (edges,) int64 of each edge (arbitrary if it has none), and first edge (nodes + 1,) of each
        receiver."""
        senders = self.receivers if self.senders is None else self.senders
        return senders.index.numpy(), self.receivers.offsets.numpy()


def are_compiled(values: Tensor, weight: Tensor, *receivers: Incidence) -> bool:
    """Whether these layers can process `values`: on a processor, in float32 or float64.

    Args:
        values: (rows, columns) that enter.
        weight: of the layers to be applied, of any shape.
        receivers: of the edges that they pass over; the kernels have no row for edges that are only room.
    """
    return (
        not any(end.spare for end in receivers)
        and values.device.type == "cpu"
        and values.dtype == weight.dtype
        and values.dtype in (torch.float32, torch.float64)
    )


def normed_perceptron(values: Tensor, weight: Tensor, bias: Tensor, layers: Layers) -> Tensor:
    """Output (rows, width) [1] of a perceptron.

    Args:
        values: (rows, inputs) [1] that enter.
        weight: (width, inputs) [1] of the first layer.
        bias: (width,) [1] of this layer.
        layers: the second layer, the last and the norm, all `width` wide.
    """
    return _Perceptron.apply(  # type: ignore[no-untyped-call]
        layers[2].eps, torch.is_grad_enabled(), values, weight, bias, *_weights(layers)
    )


def passed_edges(
    latents: Tensor,
    from_senders: Tensor,
    from_receivers: Tensor,
    weight: Tensor,
    bias: Tensor,
    layers: Layers,
    ends: Ends,
) -> tuple[Tensor, Tensor]:
    """New latents (edges, width) of edges, and sums (receivers, width) of their changes, all [1].

    Args:
        latents: (edges, width) [1] before.
        from_senders: (nodes, width) [1] shares of senders in the first layer's sum.
        from_receivers: (receivers, width) [1] shares of receivers.
        weight: (width, width) [1] columns of the first layer for the latents.
        bias: (width,) [1] of that layer.
        layers: the second, the last and the norm.
        ends: of the edges.
    """
    tensors = (latents, from_senders, from_receivers, weight, bias, *_weights(layers))
    new, sums = _EdgePass.apply(layers[2].eps, torch.is_grad_enabled(), ends, *tensors)  # type: ignore[no-untyped-call]
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
        weights: (width, width) [1] each, columns of the first layer for senders and receivers.
        layers: the second and the last of a message, and the norm of a step.
        decay: gamma.
        inflows: ends of each set of edges.
    """
    tensors = (state, *weights, *_weights(layers), *constants)
    return _Propagation.apply(  # type: ignore[no-untyped-call]
        steps, decay, layers[2].eps, torch.is_grad_enabled(), inflows, *tensors
    )


def _weights(layers: Layers) -> tuple[Tensor, ...]:
    second, last, norm = layers
    return second.weight, second.bias, last.weight, last.bias, norm.weight, norm.bias


class _Perceptron(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, eps: float, keep: bool, *inputs: Tensor) -> Tensor:
        tensors = [tensor.contiguous() for tensor in inputs]
        values, *layers = _arrays(*tensors)
        weights, eps = loops.turned(tuple(layers)), values.dtype.type(eps)
        out = np.empty((len(values), len(layers[1])), values.dtype)
        between = _between(out if keep else out[:0])

        def passed(rows: tuple[int, int]) -> None:
            loops.perceptron(values, weights, eps, between, out, *rows)

        parallel_map(passed, _shared(len(out), _SHARED_ROWS, out.shape[1]))
        if keep:
            ctx.save_for_backward(*tensors, *map(torch.from_numpy, between))
        return torch.from_numpy(out)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Gradients:
        values, *saved = ctx.saved_tensors
        further, on_values = [torch.zeros_like(weight) for weight in saved[:-4]], torch.empty_like(values)
        on, inputs, *arrays = _arrays(gradients[0].contiguous(), values, *saved)
        layers, between, is_needed = tuple(arrays[:-4]), tuple(arrays[-4:]), ctx.needs_input_grad[2]
        derivatives.perceptron_derivative(
            on, inputs, layers, between, tuple(_arrays(*further)), is_needed, _array(on_values)
        )
        return None, None, on_values if is_needed else None, *further


class _EdgePass(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, eps: float, keep: bool, ends: Ends, *inputs: Tensor) -> Any:
        tensors = [tensor.contiguous() for tensor in inputs]
        latents, at_sender, at_receiver, *layers = _arrays(*tensors)
        new, sums, eps = np.empty_like(latents), np.empty_like(at_receiver), latents.dtype.type(eps)
        weights, between = loops.turned(tuple(layers)), _between(new if keep else new[:0])

        shares = (at_sender, at_receiver, *ends.arrays())

        def passed(nodes: tuple[int, int]) -> None:
            loops.edge_pass(latents, shares, weights, eps, between, new, sums, *nodes)

        parallel_map(passed, _shared(len(sums), _SHARED_NODES, sums.shape[1]))
        if keep:
            ctx.save_for_backward(*tensors, *map(torch.from_numpy, between))
        ctx.ends = ends
        ctx.set_materialize_grads(False)
        return torch.from_numpy(new), torch.from_numpy(sums)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> Gradients:
        tensors, between = ctx.saved_tensors[:-4], tuple(_arrays(*ctx.saved_tensors[-4:]))
        latents, _, _, *layers = _arrays(*tensors)
        further, on_latents = [torch.zeros_like(tensor) for tensor in tensors[1:]], torch.empty_like(tensors[0])
        of_new, of_sums = gradients
        on_sums = torch.zeros_like(tensors[2]) if of_sums is None else of_sums.contiguous()
        # Where nothing reads the new latents any more, any array stands for their derivative.
        on_new = on_latents if of_new is None else of_new.contiguous()
        on = (*_arrays(on_new, on_sums), of_new is not None)
        changed = tuple(_arrays(*further)), _array(on_latents)
        arguments = (*on, latents, *ctx.ends.arrays(), tuple(layers), between, *changed)
        derivatives.edge_pass_derivative(*arguments)
        return None, None, None, on_latents, *further


class _Propagation(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, steps: int, decay: float, eps: float, keep: bool, inflows: Sequence[Ends], *inputs: Tensor
    ) -> Tensor:
        tensors = [tensor.contiguous() for tensor in inputs]
        state, of_sender, of_receiver, *others = _arrays(*tensors)
        of_sender, _, second, second_bias, last, last_bias, *norm = loops.turned((of_sender, others[1], *others[:6]))
        degrees = np.stack([np.diff(ends.receivers.offsets.numpy()) for ends in inflows]).sum(axis=0)
        biases = degrees.astype(state.dtype)[:, None] * last_bias
        layers = (second, second_bias, last, biases, *norm, of_sender, of_receiver.T.copy())
        small, gamma = state.dtype.type(eps), state.dtype.type(decay)
        buffers = [_Step.of(state, others[6:], keep) for _ in range(steps + 1 if keep else 2)]

        def moved(nodes: tuple[int, int], before: _Step, after: _Step) -> None:
            sets = zip(others[6:], inflows, before.messages, strict=True)
            messages = tuple((row, *ends.arrays(), *both, ends.senders is not None) for row, ends, both in sets)
            arrays = (before.state, *before.at_ends, before.sums, before.values, before.inverse)
            loops.propagation_step(messages, arrays, layers, small, gamma, (after.state, *after.at_ends), *nodes)

        now = buffers[0]
        now.state[:] = state
        for weight, at_end in zip(layers[-2:], now.at_ends, strict=True):
            np.dot(state, weight, at_end)
        spans = _shared(len(state), _SHARED_NODES, state.shape[1])
        for number in range(steps):
            after = buffers[(number + 1) % len(buffers)]
            parallel_map(partial(moved, before=now, after=after), spans)
            now = after
        if keep:
            ctx.save_for_backward(*tensors[1:])
        ctx.taken, ctx.inflows, ctx.decay = buffers[:-1], inflows, decay
        ctx.degrees = torch.from_numpy(degrees)[:, None]
        return torch.from_numpy(now.state)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Gradients:
        of_sender, of_receiver, second, _, last, _, scale, *_ = ctx.saved_tensors
        further = [torch.zeros_like(tensor) for tensor in ctx.saved_tensors]
        d_sender, d_receiver, d_second, d_second_bias, d_last, d_last_bias, d_scale, d_shift, *d_constants = further
        on, unused = gradients[0].contiguous(), torch.zeros_like(scale)
        for step in reversed(ctx.taken):
            state, sums, values, inverse = map(torch.from_numpy, (step.state, step.sums, step.values, step.inverse))
            of_total = torch.empty_like(values)
            derivatives.layer_norm_derivative(*_arrays(on, values, inverse, scale, d_scale, d_shift, unused, of_total))
            d_last.addmm_(of_total.t(), sums)
            d_last_bias += (ctx.degrees * of_total).sum(0)
            of_sums = of_total.mm(last)
            on_ends = torch.zeros_like(state), torch.zeros_like(state)
            for ends, between, d_constant in zip(ctx.inflows, step.messages, d_constants, strict=True):
                changed = _arrays(d_second, d_second_bias, d_constant, *on_ends)
                inputs = (_array(of_sums), *between, _array(second), *ends.arrays(), *changed, ends.senders is not None)
                derivatives.message_derivative(*inputs)
            on = on * ctx.decay
            for share, of_end, d_end in zip(on_ends, (of_sender, of_receiver), (d_sender, d_receiver), strict=True):
                d_end.addmm_(share.t(), state)
                on.addmm_(share, of_end)
        # What the steps left is large, and a second derivative is not for these passes.
        ctx.taken = None
        return None, None, None, None, None, on, *further


class _Step(NamedTuple):
    """What a step of propagation reads and makes, and its derivative reads again.

    Args:
        state: (nodes, width) before it.
        at_ends: (nodes, width) each, shares of senders and of receivers.
        messages: both hidden layers (edges, width) of each set of edges; without rows where they are not kept.
        sums: (nodes, width) of the last of them.
        values: (nodes, width) that the norm centres and scales.
        inverse: (nodes,) factors by which it does.
    """

    state: np.ndarray
    at_ends: tuple[np.ndarray, np.ndarray]
    messages: list[tuple[np.ndarray, np.ndarray]]
    sums: np.ndarray
    values: np.ndarray
    inverse: np.ndarray

    @staticmethod
    def of(state: np.ndarray, constants: Sequence[np.ndarray], keep: bool) -> _Step:
        rows = [row if keep else row[:0] for row in constants]
        return _Step(
            np.empty_like(state),
            (np.empty_like(state), np.empty_like(state)),
            [(np.empty_like(row), np.empty_like(row)) for row in rows],
            np.empty_like(state),
            np.empty_like(state),
            np.empty(len(state), state.dtype),
        )


def _between(out: np.ndarray) -> tuple[np.ndarray, ...]:
    """What the derivative of `out` (rows, width) reads again: hidden layers, the norm's output and (rows,) factors."""
    return (*(np.empty_like(out) for _ in range(3)), np.empty(len(out), out.dtype))


def _shared(count: int, most: int, width: int) -> list[tuple[int, int]]:
    """First and end of the rows or nodes that threads take, of `count`: at most `most` where they are 64 wide."""
    parts = max(-(-count * width // (64 * most)), 1)
    bounds = [count * part // parts for part in range(parts + 1)]
    return list(pairwise(bounds))


def _array(values: Tensor) -> np.ndarray:
    return values.detach().numpy()


def _arrays(*values: Tensor) -> list[np.ndarray]:
    return [_array(value) for value in values]
