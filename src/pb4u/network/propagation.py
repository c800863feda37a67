"""Propagation before update: K message-passing steps with one set of weights, then nodes are updated once.

Paper, "Propagation-before-Update": h^0 = v; h~_i = LayerNorm(sum_j f_m(h_i, h_j, e_ij)); h_i <- gamma h_i + h~_i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import torch
from torch import Tensor, nn

from pb4u.errors import InputError
from pb4u.network.compiled_layers import Ends, are_compiled, propagated
from pb4u.network.graph.graph import GARMENT, EdgeSet, Graph
from pb4u.network.graph.incidence import Span
from pb4u.network.mlp import EDGE, RECEIVER, SENDER, EdgeMLP
from pb4u.network.segment import gather, segment_sum


@dataclass(frozen=True)
class PropagationForm:
    """Form of the propagation: choices in which the paper and its released code differ.

    Args:
        decay: gamma; 0.9 in the released code, not stated in the paper.
        norm: "messages": h = gamma h + LN(sum) (paper); "accumulated": h = LN(gamma h + sum) (release).
        message_norm: whether f_m ends in a LayerNorm of its own (release).
        world_edges: whether body neighbours send messages too (paper: "spatial and topological" neighbours).

    Raises:
        InputError: a norm of another name.
    """

    decay: float = 0.9
    norm: str = "messages"
    message_norm: bool = False
    world_edges: bool = True

    def __post_init__(self) -> None:
        if self.norm not in ("messages", "accumulated"):
            raise InputError(f'The norm of propagation is "messages" or "accumulated", not {self.norm!r}.')


PAPER_PROPAGATION = PropagationForm()
RELEASED_PROPAGATION = PropagationForm(norm="accumulated", message_norm=True, world_edges=False)


class Propagation(nn.Module):
    """K weight-shared message steps over the garment; the latents of body vertices are sent, but do not change.

    Args:
        width: number of columns of all latents and hidden layers.
        form: the paper's or the released one.
    """

    def __init__(self, width: int, form: PropagationForm) -> None:
        super().__init__()
        self.form = form
        self.message = EdgeMLP(width, norm=form.message_norm)
        self.norm = nn.LayerNorm(width)

    def forward(self, nodes: dict[str, Tensor], edges: dict[str, Tensor], graph: Graph, steps: Sequence[int]) -> Tensor:
        """Latents h^K (garment vertices, width), dimensionless; a garment is left out after its last step.

        Args:
            nodes: latents (nodes, width) [1] by set name.
            edges: latents (edges, width) [1] by set name.
            graph: the ends of the edges.
            steps: K of each garment.
        """
        inflows = self._inflows(nodes, edges, graph)
        if any(inflow.receivers.spare for inflow in inflows) and len(set(steps)) > 1:
            return self._side_by_side(nodes[GARMENT], inflows, graph, steps)
        state, depth_so_far, depths = nodes[GARMENT], 0, sorted(set(steps))
        running = dict(enumerate(pairwise(graph.vertex_offsets)))
        finished: dict[int, Tensor] = {}
        for depth in depths:
            state, depth_so_far = self._after(depth - depth_so_far, state, inflows), depth
            finished |= {garment: state[slice(*span)] for garment, span in running.items() if steps[garment] == depth}
            running = {garment: span for garment, span in running.items() if steps[garment] > depth}
            if running:
                spans = list(running.values())
                state = torch.cat([state[start:stop] for start, stop in spans])
                inflows = [inflow.restrict(spans) for inflow in inflows]
                running = dict(zip(running, _packed(spans), strict=True))
        return state if len(depths) == 1 else torch.cat([finished[garment] for garment in sorted(finished)])

    def _side_by_side(self, state: Tensor, inflows: list[EdgeSet], graph: Graph, steps: Sequence[int]) -> Tensor:
        """State after the steps of each garment; all take those of the most, so that no shape changes."""
        spans = list(pairwise(graph.vertex_offsets))
        for number in range(max(steps)):
            after = self._step(state, inflows)
            parts = [(after if count > number else state)[a:b] for (a, b), count in zip(spans, steps, strict=True)]
            state = torch.cat(parts)
        return state

    def _inflows(self, nodes: dict[str, Tensor], edges: dict[str, Tensor], graph: Graph) -> list[EdgeSet]:
        """Edges into the garment; as their features, the part of the first layer that is the same at every step."""
        inflows = []
        for name, edge_set in graph.edges.items():
            from_garment = edge_set.sender_set == GARMENT
            if edge_set.receiver_set != GARMENT or not (from_garment or self.form.world_edges):
                continue
            constant = self.message.project(EDGE, edges[name], bias=True)
            if not from_garment:
                constant += gather(self.message.project(SENDER, nodes[edge_set.sender_set]), edge_set.senders)
            inflows.append(replace(edge_set, features=constant))
        return inflows

    def _after(self, steps: int, state: Tensor, inflows: list[EdgeSet]) -> Tensor:
        """State after `steps` steps of the garments that all `inflows` end in."""
        message, norm = self.message, self.norm
        recorded = are_compiled(state, message.first.weight, *(inflow.receivers for inflow in inflows))
        if recorded and self.form.norm == "messages" and not self.form.message_norm:
            constants = [inflow.features for inflow in inflows]
            ends = [Ends(i.senders if i.sender_set == GARMENT else None, i.receivers) for i in inflows]
            weights, layers = (
                (message.weight_of(SENDER), message.weight_of(RECEIVER)),
                (message.second, message.last, norm),
            )
            return propagated(steps, state, constants, weights, layers, self.form.decay, ends)
        for _ in range(steps):
            state = self._step(state, inflows)
        return state

    def _step(self, state: Tensor, inflows: list[EdgeSet]) -> Tensor:
        """One step; all edges of a set at once."""
        message = self.message
        at_receiver, at_sender = message.project(RECEIVER, state), message.project(SENDER, state)
        sums = []
        for inflow in inflows:
            hidden = inflow.features + gather(at_receiver, inflow.receivers)
            if inflow.sender_set == GARMENT:
                hidden = hidden + gather(at_sender, inflow.senders)
            sent = message.up_to_last(hidden)
            if self.form.message_norm:
                sent = message.output(sent)
            sums.append(segment_sum(sent, inflow.receivers))
        total = torch.stack(sums).sum(dim=0)
        if not self.form.message_norm:
            degrees = torch.stack([inflow.degrees() for inflow in inflows]).sum(dim=0)
            total = message.last_of_sums(total, degrees)
        return self._moved(state, total)

    def _moved(self, state: Tensor, total: Tensor) -> Tensor:
        """State after a step, given the sums `total` (vertices, width) [1] of its messages."""
        form = self.form
        return (
            form.decay * state + self.norm(total) if form.norm == "messages" else self.norm(form.decay * state + total)
        )


def _packed(spans: Sequence[Span]) -> list[Span]:
    """The same spans moved together, in order, from 0."""
    packed, base = [], 0
    for start, stop in spans:
        packed.append((base, base + stop - start))
        base += stop - start
    return packed
