"""Layers of a network as a training on a processor computes them: autograd functions around compiled loops.

Some hundred rows at a time go through all layers and stay in cache (`layer_loops`): with all rows at once, a product
waited for memory two thirds of its time. The same layers in torch's operations, which accelerators take, are the slow
form that tests compare with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from pb4u.network import layer_loops as loops
from pb4u.network.graph.incidence import Incidence

Gradients: TypeAlias = tuple[Tensor | None, ...]
Layers: TypeAlias = tuple[nn.Linear, nn.Linear, nn.LayerNorm]


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


def are_compiled(values: Tensor, weight: Tensor, *receivers: Incidence) -> bool:
    """Whether these layers take `values`: gradients are recorded, and a processor computes in float32 or float64.

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
        loops.perceptron(given, ctx.weighted, tuple(layers), eps, tuple(_arrays(*between)), _array(out))
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Gradients:
        values, *saved = ctx.saved_tensors
        further, on_values = [torch.zeros_like(weight) for weight in saved[:-4]], torch.empty_like(values)
        on, given, *arrays = _arrays(gradients[0].contiguous(), values, *saved)
        layers, between, wanted = tuple(arrays[:-4]), tuple(arrays[-4:]), ctx.needs_input_grad[1]
        loops.perceptron_derivative(
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
        loops.edge_pass(latents, shares, tuple(layers), eps, tuple(_arrays(*between)), *_arrays(new, sums))
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
        loops.edge_pass_derivative(*given)
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
                loops.message(_array(constant), (*shares, *ends.arrays()), *kept)  # type: ignore[arg-type]
                messages.append(between)
            values = torch.addmm(degrees * last_bias, sums, last.t())
            inverse, after = values.new_empty(len(values)), torch.empty_like(values)
            normed = (*_arrays(scale, shift), small, *_arrays(inverse, after))
            loops.layer_norm(_array(values), nothing, *normed)
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
            loops.layer_norm_derivative(*_arrays(on, values, inverse, scale, d_scale, d_shift, unused, of_total))
            d_last.addmm_(of_total.t(), sums)
            d_last_bias += (ctx.degrees * of_total).sum(0)
            of_sums = of_total.mm(last)
            on_ends = torch.zeros_like(state), torch.zeros_like(state)
            for ends, between, d_constant in zip(ctx.inflows, messages, d_constants, strict=True):
                changed = _arrays(d_second, d_second_bias, d_constant, *on_ends)
                given = (*_arrays(of_sums, *between, second), *ends.arrays(), *changed, ends.senders is not None)
                loops.message_derivative(*given)
            on = on * ctx.decay
            for share, of_end, d_end in zip(on_ends, (of_sender, of_receiver), (d_sender, d_receiver), strict=True):
                d_end.addmm_(share.t(), state)
                on.addmm_(share, of_end)
        # What the steps left is large, and a second derivative is not for these passes.
        ctx.taken = None
        return None, None, None, None, on, *further


def _between(values: Tensor, width: int) -> tuple[Tensor, ...]:
    """Room for what the derivative reads: hidden layers and output of the norm (rows, width), its factors (rows,)."""
    rows = len(values)
    return (*(values.new_empty(rows, width) for _ in range(3)), values.new_empty(rows))


def _array(values: Tensor) -> np.ndarray:
    array: np.ndarray = values.detach().numpy()
    return array


def _arrays(*values: Tensor) -> list[np.ndarray]:
    return [_array(each) for each in values]
