"""Border vertices that lie on top of each other."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pb4u.geometry.topology import Topology


def coincident_border_vertices(vertices: np.ndarray, topology: Topology, tolerance: float = 1e-4) -> np.ndarray:
    """(vertices,) int64: for each border vertex the lowest index of those within `tolerance` [m], else its own index.

    Vertices that share an edge are never joined, however short the edge is.
    """
    target = np.arange(len(vertices))
    border = np.unique(topology.boundary_edges)
    if not len(border):
        return target
    pairs = cKDTree(vertices[border]).query_pairs(tolerance, output_type="ndarray")
    if not len(pairs):
        return target
    pairs = np.sort(border[pairs], axis=1)
    key = topology.edges @ np.array([len(vertices), 1])
    pairs = pairs[~np.isin(pairs @ np.array([len(vertices), 1]), key)]
    graph = coo_matrix((np.ones(len(pairs), dtype=np.int8), pairs.T), shape=(len(vertices), len(vertices)))
    count, labels = connected_components(graph, directed=False)
    lowest = np.full(count, len(vertices))
    np.minimum.at(lowest, labels, target)
    joined: np.ndarray = lowest[labels]
    return joined
