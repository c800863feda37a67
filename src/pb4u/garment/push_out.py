"""Cloth that starts inside the body, moved out of it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags

from pb4u.garment.fit import RestBody
from pb4u.geometry.topology import Topology

CLEARANCE = 2e-3
SMOOTHING_PASSES = 20
PROJECTION_PASSES = 40


def push_out(vertices: np.ndarray, topology: Topology, body: RestBody, clearance: float = CLEARANCE) -> np.ndarray:
    """Vertices (n, 3) [m] at least `clearance` [m] outside a closed body, where the body's creases leave room for it.

    Vertices too near are projected out, the displacement is spread over the neighbouring cloth so that it does not
    crease, and what this brings back in is projected again. Middles of edges are held outside too while this lasts.
    """
    spread = _neighbour_mean(topology)
    distances = body.signed_distances(vertices)
    # Only cloth this near can be reached by what is pushed; the rest need not be asked about again and again.
    near = distances < 2.0 * max(0.0, -float(distances.min())) + 2.0 * clearance
    a, b = topology.edges[near[topology.edges].all(axis=1)].T
    moved = vertices.copy()
    for _ in range(SMOOTHING_PASSES):
        push = np.zeros_like(moved)
        push[near] = _push(moved[near], body, clearance)
        across = _push(0.5 * (moved[a] + moved[b]), body, 0.25 * clearance)
        for end in (a, b):
            larger = np.einsum("ij,ij->i", across, across) > np.einsum("ij,ij->i", push[end], push[end])
            push[end[larger]] = across[larger]
        if not push.any():
            break
        displacement = moved + push - vertices
        moved = vertices + 0.5 * (displacement + spread @ displacement)
    left = np.arange(len(moved))
    for _ in range(PROJECTION_PASSES):
        push = _push(moved[left], body, clearance)
        left, push = left[push.any(axis=1)], push[push.any(axis=1)]
        if not len(left):
            break
        # A little further than asked: in a crease the last fraction would take forever.
        moved[left] += 1.02 * push
    return moved


def _push(points: np.ndarray, body: RestBody, clearance: float) -> np.ndarray:
    """(points, 3) smallest displacement [m] that brings each point `clearance` outside; 0 where it is already."""
    near = body.surface.nearest(points)
    depth = clearance - near.signed_distance.numpy()
    asked: np.ndarray = np.where(depth > 1e-6, depth, 0.0)[:, None] * near.normals.numpy()
    return asked


def _neighbour_mean(topology: Topology) -> csr_matrix:
    """(vertices, vertices) matrix that takes the mean over a vertex's neighbours; itself where it has none."""
    count = topology.vertex_count
    rows, columns = np.concatenate([topology.edges, topology.edges[:, ::-1]]).T
    adjacency = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    degree = np.asarray(adjacency.sum(axis=1)).reshape(-1)
    return diags(1.0 / np.maximum(degree, 1.0)) @ adjacency + diags((degree == 0).astype(np.float64))
