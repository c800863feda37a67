"""The baselines written down plainly, with the same weights: whole layers on concatenations, edges really left out."""

from __future__ import annotations

from dataclasses import replace

import torch
from tests.readable_network import perceptron, readable_block
from torch import Tensor

from pb4u.network.graph.graph import EdgeSet, Graph
from pb4u.network.graph.incidence import incidence


def encoded(net, graph: Graph) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    nodes = {}
    for name, node_set in graph.nodes.items():
        parts = [node_set.features, net.node_type(node_set.types)]
        if net.level is not None:
            level = graph.rest["level"] if name == "garment" else torch.zeros(len(node_set.types), dtype=torch.int64)
            parts.append(net.level(level))
        nodes[name] = perceptron(net.node_encoder, *parts)
    return nodes, {name: perceptron(net.edge_encoders[s.kind], s.features) for name, s in graph.edges.items()}


def blocks_in_a_row(net, graph: Graph) -> Tensor:
    """MeshGraphNet and ContourCraft."""
    nodes, edges = encoded(net, graph)
    for block in net.blocks:
        nodes, edges = readable_block(block, nodes, edges, graph)
    return perceptron(net.decoder, nodes["garment"])


def without(edges: EdgeSet, kept: Tensor) -> EdgeSet:
    return replace(
        edges,
        senders=incidence(edges.senders.index[kept], edges.senders.node_count),
        receivers=incidence(edges.receivers.index[kept], edges.receivers.node_count),
        features=edges.features[kept],
    )


def hood(net, graph: Graph) -> Tensor:
    """With HOOD's way up: world edges that had left the graph come back as they were, the others as they became."""
    nodes, edges = encoded(net, graph)
    stages = [
        (("mesh", "coarse_near"), None),
        (("coarse_near", "coarse_far"), "coarse_near"),
        (("coarse_far",), "coarse_far"),
        (("coarse_near", "coarse_far"), "coarse_near"),
        (("mesh", "coarse_near"), None),
    ]
    repeats, blocks = len(net.blocks) // 5, iter(net.blocks)
    stash = []
    for number, (kinds, level) in enumerate(stages):
        here = {name: s for name, s in graph.edges.items() if s.kind in kinds}
        latents = {name: edges[name] for name in here}
        if number in (1, 2):
            stash.append({name: edges[name] for name, s in graph.edges.items() if s.kind == "world"})
        if number in (3, 4):
            left, coarser = stash.pop(), stages[number - 1][1]
            for name, values in left.items():
                ends = graph.edges[name]
                index = (ends.receivers if ends.receiver_set == "garment" else ends.senders).index
                stayed = torch.isin(index, graph.edges[coarser].receivers.index)
                edges = edges | {name: torch.where(stayed[:, None], edges[name], values)}
        for name, edge_set in graph.edges.items():
            if edge_set.kind != "world":
                continue
            ends = edge_set.receivers if edge_set.receiver_set == "garment" else edge_set.senders
            kept = torch.ones(len(ends.index), dtype=torch.bool)
            if level is not None:
                kept = torch.isin(ends.index, graph.edges[level].receivers.index)
            here[name], latents[name] = without(edge_set, kept), edges[name][kept]
        for _ in range(repeats):
            nodes, latents = readable_block(next(blocks), nodes, latents, replace(graph, edges=here))
        for name, values in latents.items():
            if len(values) == len(edges[name]):
                edges = edges | {name: values}
            else:
                # Fewer, on a coarse level: the others stay put.
                whole = edges[name].clone()
                ends = graph.edges[name]
                index = (ends.receivers if ends.receiver_set == "garment" else ends.senders).index
                whole[torch.isin(index, graph.edges[level].receivers.index)] = values
                edges = edges | {name: whole}
    return perceptron(net.decoder, nodes["garment"])


def eslr(net, graph: Graph) -> Tensor:
    nodes, edges = encoded(net, graph)
    for layer in net.layers:
        before = nodes["garment"]
        nodes, edges = readable_block(layer.local, nodes, edges, graph)
        mesh = graph.edges["mesh"]
        smooth = torch.zeros_like(before)
        for vertex in range(len(before)):
            arriving = mesh.receivers.index == vertex
            smooth[vertex] = (nodes["garment"][mesh.senders.index[arriving]] + edges["mesh"][arriving]).mean(dim=0)
        distant = torch.zeros_like(before)
        values = layer.distant.norm(before)
        for garment, (start, stop) in enumerate(zip(graph.vertex_offsets, graph.vertex_offsets[1:], strict=False)):
            own, away = values[start:stop], graph.rest["geodesics"][start:stop].to(values)
            marks = graph.rest["landmarks"][garment]
            tokens = own[marks] + layer.distant.collect(own[marks], own[marks], away[marks])
            distant[start:stop] = layer.distant.spread(own, tokens, away)
        fused = perceptron(layer.fusion, perceptron(layer.smoothed, smooth), distant)
        nodes["garment"] = before + fused
    return perceptron(net.decoder, nodes["garment"])


READABLE = {
    "mgn": blocks_in_a_row,
    "contourcraft": blocks_in_a_row,
    "hood": hood,
    "eslr": eslr,
}
