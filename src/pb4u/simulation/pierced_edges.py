"""Cloth that a part of the body has come through between its vertices, which contact at vertices cannot see.

Cloth caught on a forearm or a shin has all its vertices outside the body, on both sides of it, and edges that go
through. No force leads back from there: it has to be seen in the step in which it happens. Measured in
docs/design/body_contact.md.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.physics.contact.contact_set import ContactPlanes, nearest_planes
from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import ColliderPose
from pb4u.scene.packed import PackedGarments

_DEPTH = 0.5
"""Depth of the middle of an edge from which on it goes through a limb, as a share of the garment's mean edge length.

In a walking dress of 2,500 triangles the edges over shoulders and knees lie up to a third of their length beneath the
skin, those caught on a shin six to nine tenths.
"""

_TURNED = 0.5
"""Cosine between the normals of the body beneath the two ends of an edge below which it may: 60 degrees, where an edge
from skin to skin is seven times as long as its middle is deep."""


def newly_pierced(step: TimeStep, x: Tensor) -> int:
    """Number of edges that go through a part of the body at the end of a step and did not at its start.

    Args:
        step: the time step.
        x: (vertices, 3) [m] at its end.
    """
    garments, bodies = step.garments, step.bodies
    planes = step.contacts.now
    if bodies is None or planes is None:
        return 0
    # Planes of vertices beyond are as old as the last closest-point query that reached them.
    after = nearest_planes(bodies.following, garments, x, within=max(garments.mean_edge_lengths))
    edges = torch.nonzero(_may_be(after, garments)).reshape(-1)
    if not len(edges):
        return 0
    pierced = edges[_through(bodies.following, garments, x, edges)]
    return len(pierced) - int(_through(bodies.now, garments, step.state.positions, pierced).sum())


def _may_be(planes: ContactPlanes, garments: PackedGarments) -> Tensor:
    """Edges (edges,) bool whose ends lie by the body, where it faces different ways."""
    a, b = garments.edges.T
    near = planes.touchable & (planes.distance < garments.vertex_edge_lengths)
    return near[a] & near[b] & ((planes.normals[a] * planes.normals[b]).sum(1) < _TURNED)


def _through(pose: ColliderPose, garments: PackedGarments, x: Tensor, edges: Tensor) -> Tensor:
    """Which of some `edges` (edges,) int64 have their middle deep in the body; bool."""
    ends = garments.edges[edges]
    middles, world = x[ends].mean(1), garments.vertex_world[ends[:, 0]]
    deep = torch.zeros(len(edges), dtype=torch.bool)
    for number, surface in enumerate(pose.surfaces):
        rows = torch.nonzero(world == number).reshape(-1)
        if surface is None or not len(rows):
            continue
        nearest = surface.nearest(middles[rows])
        limit = _DEPTH * garments.vertex_edge_lengths[ends[rows, 0]]
        deep[rows] = ~nearest.beyond_border & (nearest.signed_distance < -limit)
    return deep
