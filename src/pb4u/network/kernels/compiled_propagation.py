"""Propagation before update without gradients on a processor, compiled."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.network.graph.graph import BODY, GARMENT
from pb4u.network.graph.incidence import Span
from pb4u.network.kernels.compiled_block import Ends, Latents, cut
from pb4u.network.kernels.compiled_mlp import CompiledMLP, as_array, as_vector, tiles
from pb4u.network.kernels.layer_kernels import move_by_messages, write_product
from pb4u.network.kernels.products import COLUMNS, packed
from pb4u.network.mlp import EDGE, RECEIVER, SENDER
from pb4u.network.propagation import Propagation
from pb4u.network.tiles import of_tiles


class CompiledPropagation:
    """A `Propagation` whose messages have no LayerNorm of their own, with its weights prepared.

    Args:
        propagation: on a processor; its weights are copied.
        precision: of the products, float32 or bfloat16.
    """

    def __init__(self, propagation: Propagation, precision: torch.dtype) -> None:
        self.form, self.precision = propagation.form, precision
        self.message = CompiledMLP(propagation.message, precision)
        parts = self.message.parts
        self.of_edges = packed(parts[EDGE], precision)
        self.of_ends = packed(torch.cat([parts[SENDER], parts[RECEIVER]]), precision)
        norm = propagation.norm
        # In Python's own numbers kernels would compute in double precision.
        self.decay: Any = np.float32(propagation.form.decay)
        self.norm = (as_vector(norm.weight), as_vector(norm.bias), np.float32(norm.eps))

    def __call__(self, latents: Latents, garments: Sequence[Span], steps: Sequence[int]) -> Tensor:
        """Latents h^K (garment vertices, width) [1]; a garment is left out after its last step.

        Args:
            latents: of all nodes and edges; left as they are.
            garments: vertices of each garment.
            steps: K of each garment.
        """
        inflows = _Inflows(latents, self)
        cuts = [cut(inflows.offsets, garment) for garment in garments]
        for step in range(max(steps)):
            running = [tile for of, last in zip(cuts, steps, strict=True) if step < last for tile in of]
            of_tiles(partial(inflows.move, step % 2), running)
        return inflows.state


class _Inflows:
    """All edges into the garments as one list, and what a step reads and writes."""

    def __init__(self, latents: Latents, weights: CompiledPropagation) -> None:
        self.weights, self.state = weights, latents.nodes[GARMENT].clone()
        self.rounded = self.state.to(weights.precision)
        names = [
            name
            for name in latents.inflows[GARMENT]
            if weights.form.world_edges or latents.ends[name].sender_set == GARMENT
        ]
        self.offsets, order, self.senders = _merged([latents.ends[name] for name in names], len(self.state))
        # The part of the first layer that is the same at every step.
        shares = torch.cat([_product(latents.rounded[name], weights.of_edges) for name in names])
        self.constants = as_array(shares.to(weights.precision).index_select(0, torch.from_numpy(order)))
        # Shares of every vertex, as sender and as receiver, before a step and after it; those of the body stay.
        sets = [name for name in (GARMENT, BODY) if name in latents.nodes]
        first = torch.cat([_product(latents.rounded_nodes(name), weights.of_ends) for name in sets]).numpy()
        self.tables = (first, first.copy())

    def move(self, before: int, nodes: Span) -> None:
        """Take a step of a tile, and give its shares to the next.

        Args:
            before: number of the table that is read.
            nodes: the tile.
        """
        (n0, n1), weights, form = nodes, self.weights, self.weights.form
        offsets = self.offsets[n0 : n1 + 1]
        edges = slice(int(offsets[0]), int(offsets[-1]))
        move_by_messages(
            weights.message.layers,
            weights.norm,
            weights.decay,
            form.norm == "accumulated",
            weights.of_ends,
            self.constants[edges],
            self.tables[before].reshape(-1, self.state.shape[1]),
            self.senders[edges],
            offsets,
            n0,
            self.state[n0:n1].numpy(),
            as_array(self.rounded)[n0:n1],
            self.tables[1 - before][n0:n1],
        )


def _product(values: Tensor, weight: np.ndarray) -> Tensor:
    """Shares (rows, outputs) float32 of `values` (rows, inputs) in first layers, tile by tile."""
    out = torch.empty(len(values), weight.shape[0] * COLUMNS)
    of_tiles(lambda rows: write_product(as_array(values)[rows], weight, out[rows].numpy()), tiles(len(values)))
    return out


def _merged(sets: Sequence[Ends], vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edge sets into the garments as one, in ascending order of receiver.

    First edge of each receiver and the end; numbers of the edges, those of the sets after one another; row of each
    sender in a table of the garments' vertices and then the body's.
    """
    degrees = np.array([np.diff(ends.offsets) for ends in sets])
    offsets = np.concatenate([[0], np.cumsum(degrees.sum(axis=0))])
    # An edge of a set comes after those of its receiver in the sets before.
    ahead = np.cumsum(degrees, axis=0) - degrees
    places = [
        np.arange(len(ends.senders)) + np.repeat(offsets[:-1] + before - ends.offsets[:-1], degree)
        for ends, before, degree in zip(sets, ahead, degrees, strict=True)
    ]
    senders = [ends.senders + (0 if ends.sender_set == GARMENT else vertices) for ends in sets]
    place = np.concatenate(places)
    order = np.empty_like(place)
    order[place] = np.arange(len(place))
    return offsets, order, np.concatenate(senders)[order]
