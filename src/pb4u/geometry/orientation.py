"""Orientation of triangle meshes."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pb4u.geometry.topology import Topology


def faces_to_flip(topology: Topology) -> tuple[np.ndarray, bool]:
    """Which faces to turn over so that neighbours agree, and whether that is possible.

    In each piece the fewer faces are turned. Not possible means a one-sided surface (a Moebius strip): its faces are
    then left alone.

    Returns:
        flip: (faces,) bool.
        orientable: whether every piece has two sides.
    """
    faces, pairs = topology.faces, topology.hinge_faces
    count = len(faces)
    start, end = topology.hinges[:, 0], topology.hinges[:, 1]
    second = faces[pairs[:, 1]]
    agree = ~((second == start[:, None]) & (np.roll(second, -1, axis=1) == end[:, None])).any(axis=1)
    # Two copies of every face, as it is and turned over; an edge joins the copies that agree across it.
    a, b = pairs.T
    rows = np.concatenate([a, a + count])
    columns = np.concatenate([np.where(agree, b, b + count), np.where(agree, b + count, b)])
    graph = coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    labels = connected_components(graph, directed=False)[1]
    as_is, turned = labels[:count], labels[count:]
    orientable = as_is != turned
    size = np.bincount(as_is, minlength=labels.max(initial=0) + 1)
    # The side with more faces as they are wins; on a tie the copy with the lower label does, on both its faces.
    more = (size[turned] > size[as_is]) | ((size[turned] == size[as_is]) & (turned < as_is))
    return more & orientable, bool(orientable.all())
