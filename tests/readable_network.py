"""The readable twin of the network: concatenate, apply whole layers, add up by index. Same weights, nothing clever.

Slow on purpose; the tests hold the network in `src` to it, and the benchmark measures against it.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pb4u.network.acceleration_model import AccelerationModel, PreparedGarments
from pb4u.network.graph.graph import EdgeSet, Graph
from pb4u.network.interaction_block import InteractionBlock
from pb4u.network.mlp import MLP
from pb4u.network.pb4u_gnet import Pb4uGNet


def perceptron(mlp: MLP, *parts: Tensor) -> Tensor:
    x = torch.cat(parts, dim=-1)
    x = F.relu(mlp.first(x))
    x = F.relu(mlp.second(x))
    return mlp.norm(mlp.last(x))


def add_up(messages: Tensor, edges: EdgeSet, count: int) -> Tensor:
    zeros = torch.zeros(count, messages.shape[1], dtype=messages.dtype)
    return zeros.index_add(0, edges.receivers.index, messages)


def readable_propagation(
    net: Pb4uGNet, nodes: dict[str, Tensor], edges: dict[str, Tensor], graph: Graph, steps: Sequence[int]
) -> Tensor:
    form, message, norm = net.propagation.form, net.propagation.message, net.propagation.norm
    v = nodes["garment"]
    h = v
    step_of_vertex = torch.tensor(steps).repeat_interleave(torch.tensor(graph.vertex_offsets).diff())[:, None]
    for k in range(max(steps)):
        total = torch.zeros_like(h)
        for name, edge_set in graph.edges.items():
            if edge_set.receiver_set == "garment" and (edge_set.sender_set == "garment" or form.world_edges):
                senders = h if edge_set.sender_set == "garment" else nodes["body"]
                sent = perceptron(message, h[edge_set.receivers.index], senders[edge_set.senders.index], edges[name])
                total = total + add_up(sent, edge_set, len(h))
        new = form.decay * h + norm(total) if form.norm == "messages" else norm(form.decay * h + total)
        h = torch.where(step_of_vertex > k, new, h)
    return h


def readable_block(
    block: InteractionBlock, nodes: dict[str, Tensor], edges: dict[str, Tensor], graph: Graph
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    sums = {name: {kind: torch.zeros_like(v) for kind in block.kinds} for name, v in nodes.items()}
    new_edges = {}
    for name, edge_set in graph.edges.items():
        receivers = nodes[edge_set.receiver_set][edge_set.receivers.index]
        senders = nodes[edge_set.sender_set][edge_set.senders.index]
        sent = perceptron(block.edge_mlps[edge_set.kind], receivers, senders, edges[name])
        new_edges[name] = edges[name] + sent
        sums[edge_set.receiver_set][edge_set.kind] = add_up(sent, edge_set, len(nodes[edge_set.receiver_set]))
    new_nodes = {}
    for name, v in nodes.items():
        new_nodes[name] = v + perceptron(block.node_mlp, v, *(sums[name][kind] for kind in block.kinds))
    return new_nodes, new_edges


def readable_network(net: Pb4uGNet, graph: Graph, steps: Sequence[int]) -> Tensor:
    nodes = {n: perceptron(net.node_encoder, s.features, net.node_type(s.types)) for n, s in graph.nodes.items()}
    edges = {n: perceptron(net.edge_encoders[s.kind], s.features) for n, s in graph.edges.items()}
    travelled = readable_propagation(net, nodes, edges, graph, steps)
    nodes = {**nodes, "garment": perceptron(net.update, nodes["garment"], travelled)}
    for block in net.blocks:
        nodes, edges = readable_block(block, nodes, edges, graph)
    return perceptron(net.decoder, nodes["garment"])


def readable_accelerations(model: AccelerationModel, graph: Graph, prepared: PreparedGarments) -> Tensor:
    def normalise(normaliser: nn.Module, values: Tensor) -> Tensor:
        return (values - normaliser.mean) / normaliser.spread

    nodes = {name: normalise(model.node_normaliser, s.features) for name, s in graph.nodes.items()}
    of_kind = {"mesh": model.mesh_edge_normaliser, "world": model.world_edge_normaliser}
    edges = {name: normalise(of_kind[s.kind], s.features) for name, s in graph.edges.items()}
    output = readable_network(model.network, graph.with_features(nodes, edges), prepared.steps)
    output = output * model.acceleration_normaliser.spread + model.acceleration_normaliser.mean
    return output if prepared.scale is None else output * prepared.scale.wrinkles
