"""One MeshGraphNet block over named node sets and kinds of edges (Pfaff et al. 2021; reference 1.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

from torch import Tensor, nn

from pb4u.network.compiled_layers import Ends, are_compiled, passed_edges
from pb4u.network.graph.graph import EdgeSet, Graph
from pb4u.network.mlp import EDGE, RECEIVER, SENDER, EdgeMLP, SplitMLP
from pb4u.network.segment import gather, segment_sum


class InteractionBlock(nn.Module):
    """Edges e' = f_e([v_i, v_j, e_ij]), nodes v_i + f_v([v_i, sum of e' a kind]), then e_ij + e'.

    The sum is over edge outputs before their residual. All node sets share f_v; all edge sets of a kind share f_e.

    Args:
        width: number of columns of all latents and hidden layers.
        kinds: kinds of edges on which messages are computed; others are ignored.
    """

    def __init__(self, width: int, kinds: Sequence[str]) -> None:
        super().__init__()
        self.kinds = tuple(kinds)
        self.edge_mlps = nn.ModuleDict({kind: EdgeMLP(width, norm=True) for kind in kinds})
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
            edges: latents (edges, width) [1] by set name.
            graph: the ends of the edges.
            receivers: node sets to update, all by default; if given, edge latents are not updated, since nothing reads
                them again.
            masks: (edges, 1) dimensionless factors on the messages by set name, 1 where a set is not named.
        """
        names, masks = list(nodes) if receivers is None else receivers, masks or {}
        entering = {name: {0: nodes[name]} for name in names}
        new_edges = {}
        for name, edge_set in graph.edges.items():
            if edge_set.kind not in self.kinds or edge_set.receiver_set not in entering:
                continue
            mlp: EdgeMLP = self.edge_mlps[edge_set.kind]  # type: ignore[assignment]
            new_edges[name], sums = _passed(mlp, nodes, edges[name], edge_set, masks.get(name))
            parts, kind = entering[edge_set.receiver_set], 1 + self.kinds.index(edge_set.kind)
            parts[kind] = parts[kind] + sums if kind in parts else sums
            if receivers is not None:
                new_edges[name] = edges[name]
        return {name: nodes[name] + self.node_mlp.of_parts(parts) for name, parts in entering.items()}, new_edges


def _passed(
    mlp: EdgeMLP, nodes: Mapping[str, Tensor], latents: Tensor, edge_set: EdgeSet, mask: Tensor | None
) -> tuple[Tensor, Tensor]:
    """New latents (edges, width) [1] of a set of edges, and sums (receivers, width) [1] of their changes."""
    at_sender = mlp.project(SENDER, nodes[edge_set.sender_set])
    at_receiver = mlp.project(RECEIVER, nodes[edge_set.receiver_set])
    if mask is None and are_compiled(latents, mlp.first.weight, edge_set.receivers):
        ends, norm = Ends(edge_set.senders, edge_set.receivers), cast(nn.LayerNorm, mlp.norm)
        layers, edge_weight = (mlp.second, mlp.last, norm), mlp.weight_of(EDGE)
        return passed_edges(latents, at_sender, at_receiver, edge_weight, mlp.first.bias, layers, ends)
    first = mlp.project(EDGE, latents, bias=True) + gather(at_sender, edge_set.senders)
    new = mlp.after_first(first + gather(at_receiver, edge_set.receivers))
    return latents + new, segment_sum(new if mask is None else new * mask, edge_set.receivers)
