"""A MeshGraphNet block without gradients on a processor, compiled: tiles of nodes with all edges that end in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, zip_longest

import numpy as np
import torch
from torch import Tensor

from pb4u.network.graph.graph import EdgeSet, Graph
from pb4u.network.graph.incidence import Span
from pb4u.network.interaction_block import InteractionBlock
from pb4u.network.kernels.compiled_mlp import TILE_ROWS, CompiledMLP, as_array
from pb4u.network.kernels.layer_kernels import pass_messages, write_product
from pb4u.network.kernels.products import packed
from pb4u.network.mlp import EDGE, RECEIVER, SENDER, EdgeMLP
from pb4u.network.tiles import of_tiles


@dataclass(frozen=True, eq=False)
class Ends:
    """Ends of an edge set as kernels read them.

    Args:
        kind: name of the edges' weights.
        sender_set: name of the node set they start from.
        senders: (edges,) int64 node at the start of each edge.
        offsets: (receivers + 1,) int64 first edge of each receiver, and the end.
    """

    kind: str
    sender_set: str
    senders: np.ndarray
    offsets: np.ndarray

    @classmethod
    def of(cls, edges: EdgeSet) -> Ends:
        """Ends of `edges`, which are in ascending order of receiver."""
        return cls(edges.kind, edges.sender_set, edges.senders.index.numpy(), edges.receivers.offsets.numpy())


@dataclass(frozen=True)
class Tile:
    """Some nodes of a set with all edges that end in them.

    Args:
        node_set: name of the set.
        nodes: its rows.
    """

    node_set: str
    nodes: slice


def cut(load: np.ndarray, nodes: Span) -> list[Span]:
    """`nodes` cut into spans of about the same number of edges, `TILE_ROWS` or few more.

    Args:
        load: (all nodes + 1,) int64 edges before each node, and the total.
        nodes: first of the nodes, and the end.
    """
    start, stop = nodes
    # A node counts as much as an edge, so that nodes with few edges are cut as well.
    weight = load[start : stop + 1] + np.arange(start, stop + 1)
    parts = max(1, -(-int(weight[-1] - weight[0]) // TILE_ROWS))
    cuts = start + np.searchsorted(weight, np.linspace(weight[0], weight[-1], parts + 1)[1:-1])
    bounds = [start, *np.unique(cuts).tolist(), stop]
    return [(a, b) for a, b in pairwise(bounds) if b > a]


class Latents:
    """Latents of a graph between blocks: in float32, and rounded where products read them.

    Args:
        nodes: (nodes, width) float32 by set name.
        edges: (edges, width) float32 by set name; overwritten.
        graph: the ends of the edges.
        kinds: kinds of edges that end in nodes.
        precision: of the products.
    """

    def __init__(
        self,
        nodes: Mapping[str, Tensor],
        edges: Mapping[str, Tensor],
        graph: Graph,
        kinds: tuple[str, ...],
        precision: torch.dtype,
    ) -> None:
        self.nodes = dict(nodes)
        self.edges = {name: values.numpy() for name, values in edges.items()}
        self.rounded = {name: values.to(precision) for name, values in edges.items()}
        self.ends = {name: Ends.of(edge_set) for name, edge_set in graph.edges.items()}
        self.inflows: dict[str, list[str]] = {
            name: [of for of, edge_set in graph.edges.items() if edge_set.receiver_set == name] for name in nodes
        }
        # Of every node its own latents and the sums of each kind of edges: what enters its perceptron.
        self.inputs: dict[str, Tensor] = {}
        for name, values in nodes.items():
            entering = torch.zeros(len(values), 1 + len(kinds), values.shape[1], dtype=precision)
            entering[:, 0] = values
            self.inputs[name] = entering
        self.tiles = []
        for name, values in nodes.items():
            load = sum((self.ends[of].offsets for of in self.inflows[name]), np.zeros(len(values) + 1, np.int64))
            self.tiles += [Tile(name, slice(*span)) for span in cut(load, (0, len(values)))]

    def replace_nodes(self, name: str, values: Tensor) -> None:
        """Give a node set other latents `values` (nodes, width) [1]."""
        self.nodes[name] = values
        self.round_nodes(name, slice(None))

    def round_nodes(self, name: str, nodes: slice) -> None:
        """Take over the latents of some nodes where products read them."""
        self.rounded_nodes(name)[nodes] = self.nodes[name][nodes]

    def rounded_nodes(self, name: str) -> Tensor:
        """Latents (nodes, width) [1] of a set as products read them."""
        return self.inputs[name][:, 0]


class CompiledBlock:
    """An `InteractionBlock` with its weights prepared, for graphs with one edge set a kind and receiver set.

    Args:
        block: on a processor; its weights are copied.
        precision: of the products, float32 or bfloat16.
    """

    def __init__(self, block: InteractionBlock, precision: torch.dtype) -> None:
        self.kinds, self.precision = block.kinds, precision
        mlps: dict[str, EdgeMLP] = dict(block.edge_mlps.items())  # type: ignore[arg-type]
        made = {kind: CompiledMLP(mlps[kind], precision) for kind in self.kinds}
        self.edge_mlps = {kind: (mlp.layers_of_part(EDGE), mlp.norm) for kind, mlp in made.items()}
        self.node_mlp = CompiledMLP(block.node_mlp, precision)
        of_ends = [made[kind].parts[part] for kind in self.kinds for part in (SENDER, RECEIVER)]
        self.of_ends = packed(torch.cat(of_ends), precision)

    def tables(self, latents: Latents) -> dict[str, np.ndarray]:
        """For each node set a table (nodes * 2 kinds, width) [1] of shares in the first layers of edges, not filled."""
        rows, width = 2 * len(self.kinds), self.node_mlp.width
        return {name: np.empty((rows * len(of), width), np.float32) for name, of in latents.nodes.items()}

    def write_shares(self, latents: Latents, tables: Mapping[str, np.ndarray], tile: Tile) -> None:
        """Fill the rows of a tile's nodes."""
        rounded = latents.rounded_nodes(tile.node_set)
        shares = tables[tile.node_set].reshape(len(rounded), -1)
        write_product(as_array(rounded)[tile.nodes], self.of_ends, shares[tile.nodes])

    def move(self, latents: Latents, tables: Mapping[str, np.ndarray], tile: Tile, keep_edges: bool) -> None:
        """Move the latents of a tile's nodes, and of the edges that end in them.

        Args:
            latents: overwritten in the rows of the tile.
            tables: filled for all nodes, by set name.
            tile: the nodes.
            keep_edges: whether latents of edges are wanted any more.
        """
        name, nodes, step = tile.node_set, tile.nodes, 2 * len(self.kinds)
        entering = latents.inputs[name][nodes].flatten(1)
        sums = as_array(entering).reshape(-1, self.node_mlp.width)
        for edge_set in latents.inflows[name]:
            ends = latents.ends[edge_set]
            offsets, kind = ends.offsets[nodes.start : nodes.stop + 1], self.kinds.index(ends.kind)
            edges = slice(int(offsets[0]), int(offsets[-1]))
            pass_messages(
                *self.edge_mlps[ends.kind],
                tables[ends.sender_set],
                ends.senders[edges],
                tables[name][nodes.start * step : nodes.stop * step],
                step,
                2 * kind,
                offsets,
                keep_edges,
                latents.edges[edge_set][edges],
                as_array(latents.rounded[edge_set])[edges],
                sums,
                1 + len(self.kinds),
                1 + kind,
            )
        self.node_mlp.write_normed(entering, latents.nodes[name][nodes], keep=True)
        latents.round_nodes(name, nodes)


def pass_blocks(blocks: Sequence[CompiledBlock], latents: Latents, wanted: str) -> None:
    """Move latents through blocks in a row.

    Args:
        blocks: any number.
        latents: overwritten.
        wanted: node set whose latents the last block moves, no others being read again.
    """
    tables: dict[str, np.ndarray] = {}
    for block in blocks[:1]:
        tables = block.tables(latents)
        of_tiles(partial(block.write_shares, latents, tables), latents.tiles)
    for block, following in zip_longest(blocks, blocks[1:]):
        after = following.tables(latents) if following else {}
        tiles = latents.tiles if following else [tile for tile in latents.tiles if tile.node_set == wanted]
        of_tiles(partial(_pass_block, block, following, latents, tables, after), tiles)
        tables = after


def _pass_block(
    block: CompiledBlock,
    following: CompiledBlock | None,
    latents: Latents,
    tables: Mapping[str, np.ndarray],
    after: Mapping[str, np.ndarray],
    tile: Tile,
) -> None:
    """Move a tile through a block, and give its shares to the one that follows."""
    block.move(latents, tables, tile, keep_edges=following is not None)
    if following is not None:
        following.write_shares(latents, after, tile)
