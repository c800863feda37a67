"""One MeshGraphNet block over named node sets and kinds of edges (Pfaff et al. 2021; reference 1.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from pb4u.graph.graph import EdgeSet, Graph
from pb4u.nn.mlp import EDGE, RECEIVER, SENDER, SplitMLP, edge_mlp
from pb4u.nn.segment import gather, joined, segment_sum


class InteractionBlock(nn.Module):
    """Edges e' = f_e([v_i, v_j, e_ij]), nodes v_i + f_v([v_i, sum of e' a kind]), then e_ij + e'.

    The sum is over edge outputs before their residual. All node sets share f_v; all edge sets of a kind share f_e.

    Args:
        width: number of columns of all latents and hidden layers.
        kinds: kinds of edges that messages pass over; others are left out.
    """

    def __init__(self, width: int, kinds: Sequence[str]) -> None:
        super().__init__()
        self.kinds = tuple(kinds)
        self.edge_mlps = nn.ModuleDict({kind: edge_mlp(width, norm=True) for kind in kinds})
        self.node_mlp = SplitMLP((width,) * (1 + len(self.kinds)), width, width, norm=True)

    def forward(
        self,
        nodes: dict[str, Tensor],
        edges: dict[str, Tensor],
        graph: Graph,
        receivers: Sequence[str] | None = None,
        masks: Mapping[str, Tensor] | None = None,
    ) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """New node latents, and those of the edges passed over, (rows, width), dimensionless, by set name.

        Args:
            nodes: latents (nodes, width) [1] by set name.
            edges: latents (edges, width) [1] by set name; overwritten while gradients are off.
            graph: the ends of the edges.
            receivers: node sets still wanted, all by default; where given, edge latents are left as they are, since
                nothing reads them again.
            masks: (edges, 1) dimensionless factors on the messages by set name, 1 where a set is not named.
        """
        hidden = {
            name: self.node_mlp.project(0, values, bias=True)
            for name, values in nodes.items()
            if receivers is None or name in receivers
        }
        new_edges = {}
        for name, edge_set in graph.edges.items():
            if edge_set.kind not in self.kinds or edge_set.receiver_set not in hidden:
                continue
            mask = None if masks is None else masks.get(name)
            sums, new_edges[name] = self._messages(edge_set, nodes, edges[name], mask, keep_edges=receivers is None)
            share = self.node_mlp.project(1 + self.kinds.index(edge_set.kind), sums)
            hidden[edge_set.receiver_set] = hidden[edge_set.receiver_set] + share
        updated = {name: nodes[name] + self.node_mlp.after_first(value) for name, value in hidden.items()}
        return updated, new_edges

    def _messages(
        self, edge_set: EdgeSet, nodes: dict[str, Tensor], latents: Tensor, mask: Tensor | None, keep_edges: bool
    ) -> tuple[Tensor, Tensor]:
        mlp: SplitMLP = self.edge_mlps[edge_set.kind]  # type: ignore[assignment]
        at_receiver = mlp.project(RECEIVER, nodes[edge_set.receiver_set], bias=True)
        at_sender = mlp.project(SENDER, nodes[edge_set.sender_set])
        sums, updated = [], []
        for piece in edge_set.pieces():
            old = latents[piece.edges]
            hidden = mlp.project(EDGE, old)
            hidden += gather(at_sender, piece.senders)
            hidden += gather(at_receiver, piece.receivers)
            new = mlp.after_first(hidden)
            sums.append(segment_sum(new if mask is None else new * mask[piece.edges], piece.receivers))
            if keep_edges:
                updated.append(old + new if torch.is_grad_enabled() else old.add_(new))
        if not keep_edges:
            return joined(sums), latents
        return joined(sums), joined(updated) if torch.is_grad_enabled() else latents
