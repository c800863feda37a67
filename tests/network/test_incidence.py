"""Incidences read edges from their nodes, whole or restricted."""

from __future__ import annotations

import torch
from tests.network_scenes import DT, moment, prepared_for, sheet

from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.graph.graph import Graph
from pb4u.network.graph.incidence import incidence
from pb4u.network.pb4u_gnet import Pb4uConfiguration


def graph_of(*garments) -> Graph:
    at = moment(list(garments))
    model = AccelerationModel(Pb4uConfiguration(width=4, blocks=0).network())
    return prepared_for(model, at).graph(at.state, at.collider, DT)


def test_edges_of_each_node():
    ends = incidence(torch.tensor([2, 0, 2, 3, 0]), 5)
    of_node = [ends.order[a:b].tolist() for a, b in zip(ends.offsets, ends.offsets[1:], strict=False)]
    assert of_node == [[1, 4], [], [0, 2], [3], []]


def test_a_restricted_edge_set_is_that_of_the_kept_garments_alone():
    garments = [sheet(4, 5), sheet(3, 3), sheet(5, 3)]
    graph = graph_of(*garments)
    offsets = graph.vertex_offsets
    spans = [(offsets[0], offsets[1]), (offsets[2], offsets[3])]
    kept = graph.edges["mesh"].restrict(spans)
    alone = graph_of(garments[0], garments[2]).edges["mesh"]
    for end in ("senders", "receivers"):
        for part in ("index", "offsets", "order"):
            assert torch.equal(getattr(getattr(kept, end), part), getattr(getattr(alone, end), part)), (end, part)

    into = graph.edges["body_to_garment"]
    body = into.restrict(spans)
    inside = (into.receivers.index < offsets[1]) | (into.receivers.index >= offsets[2])
    assert torch.equal(body.senders.index, into.senders.index[inside])
    assert torch.equal(body.features, into.features[inside])
    assert torch.equal(body.degrees()[:, 0].long(), torch.bincount(body.receivers.index, minlength=offsets[1] + 15))
