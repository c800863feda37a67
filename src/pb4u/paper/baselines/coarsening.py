"""HOOD's coarse levels: every other ring around the middle of a garment, joined across the ring left out.

Grigorev et al. 2023, with the two repairs of their code that keep rims and neighbours within a ring connected
(reference 4.1). Each repair looks at the graph as it was before the repair began, so that the numbering of vertices
decides nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

REMEMBERED = 64
"""Number of garments whose levels are kept: more than a training's wardrobe holds, some megabytes."""


def coarse_levels(edges: np.ndarray, rest_positions: np.ndarray, count: int) -> list[np.ndarray]:
    """Undirected edges (edges, 2) int64 vertex indices of `count` coarse levels.

    An edge of level l spans 2^(l + 1) mesh edges or fewer.

    Args:
        edges: (edges, 2) int64 vertex indices of the mesh, which may have several pieces.
        rest_positions: (vertices, 3) [m]; they only decide between vertices that are equally central.
        count: number of levels; the last may be without edges.
    """
    graph = _graph(edges, len(rest_positions))
    centres = graph_centres(graph, rest_positions)
    levels = []
    for _ in range(count):
        graph = _coarser(graph, centres)
        rows, columns = graph.nonzero()
        upper = rows < columns
        levels.append(np.column_stack([rows[upper], columns[upper]]).astype(np.int64))
    return levels


def level_labels(levels: Sequence[np.ndarray], vertex_count: int) -> np.ndarray:
    """Number of coarse levels on which each vertex has edges, (vertices,) int64, dimensionless; 0 for none.

    Args:
        levels: (edges, 2) int64 vertex indices of each level, from fine to coarse.
        vertex_count: number of vertices.
    """
    labels = np.zeros(vertex_count, dtype=np.int64)
    for number, edges in enumerate(levels, start=1):
        labels[edges.reshape(-1)] = number
    return labels


def graph_centres(graph: csr_matrix, rest_positions: np.ndarray) -> list[int]:
    """Index of a vertex of least eccentricity in every piece that has edges.

    Each search from a vertex bounds the eccentricity of all others (Takes and Kosters 2011): some dozens of searches
    instead of one for each vertex.

    Args:
        graph: adjacency matrix (vertices, vertices).
        rest_positions: (vertices, 3) [m]; they only decide between vertices that are equally central.
    """
    from scipy.sparse.csgraph import connected_components

    pieces, piece_of = connected_components(graph, directed=False)
    sizes = np.bincount(piece_of, minlength=pieces)
    return [
        _centre_of_piece(graph, np.flatnonzero(piece_of == piece), rest_positions)
        for piece in np.flatnonzero(sizes > 1).tolist()
    ]


def hops_from(graph: csr_matrix, source: int) -> np.ndarray:
    """Number of edges between `source` and every vertex, (vertices,) int64, dimensionless; -1 where there is no path.

    Args:
        graph: adjacency matrix (vertices, vertices).
        source: index of a vertex.
    """
    from scipy.sparse.csgraph import breadth_first_order

    order, before = breadth_first_order(graph, source, directed=True)
    hops = np.full(graph.shape[0], -1, dtype=np.int64)
    hops[source] = 0
    place = np.empty(graph.shape[0], dtype=np.int64)
    place[order] = np.arange(len(order))
    parents = place[before[order[1:]]]
    start, stop, depth = 0, 1, 0
    while stop < len(order):
        # Found in order of depth, so the children of one depth lie together.
        start, (stop, depth) = stop, (1 + int(np.searchsorted(parents, stop)), depth + 1)
        hops[order[start:stop]] = depth
    return hops


def _coarser(graph: csr_matrix, centres: list[int]) -> csr_matrix:
    """The next level of `graph`: rings at an odd distance from the centres are left out."""
    depth = np.full(graph.shape[0], -1, dtype=np.int64)
    for centre in centres:
        depth = np.maximum(depth, hops_from(graph, centre))
    rows, columns = graph.nonzero()
    odd = depth % 2 == 1
    outward = _graph_of(rows, columns, depth[columns] == depth[rows] + 1, graph)

    across = _without_diagonal(outward[:, odd] @ outward[odd, :])
    level = _either(across, across.T)

    rim = odd & (np.diff(outward.indptr) == 0)
    over_the_rim = _without_diagonal(outward[:, rim] @ outward[:, rim].T)
    level = _either(level, _further_than_two(over_the_rim, level))

    even = (depth >= 0) & ~odd
    within_a_ring = _graph_of(rows, columns, even[rows] & even[columns], graph)
    return _either(level, _further_than_two(within_a_ring, level))


def _centre_of_piece(graph: csr_matrix, piece: np.ndarray, rest_positions: np.ndarray) -> int:
    offset = np.linalg.norm(rest_positions[piece] - rest_positions[piece].mean(axis=0), axis=1)
    at_least = np.zeros(len(piece), dtype=np.int64)
    searched = np.zeros(len(piece), dtype=bool)
    centre, least = -1, np.iinfo(np.int64).max
    while True:
        open_ones = np.flatnonzero(~searched & (at_least < least))
        if len(open_ones) == 0:
            return int(piece[centre])
        candidate = open_ones[np.lexsort((offset[open_ones], at_least[open_ones]))[0]]
        hops = hops_from(graph, int(piece[candidate]))[piece]
        eccentricity = int(hops.max())
        searched[candidate] = True
        if eccentricity < least:
            centre, least = int(candidate), eccentricity
        at_least = np.maximum(at_least, np.maximum(hops, eccentricity - hops))

        # The farthest vertex is at the border, from where most of the others are far.
        farthest = np.flatnonzero(hops == eccentricity)
        opposite = farthest[np.argmax(offset[farthest])]
        if not searched[opposite]:
            searched[opposite] = True
            hops = hops_from(graph, int(piece[opposite]))[piece]
            at_least = np.maximum(at_least, np.maximum(hops, int(hops.max()) - hops))


def _graph(edges: np.ndarray, vertex_count: int) -> csr_matrix:
    both = np.concatenate([edges, edges[:, ::-1]])
    return _links(both[:, 0], both[:, 1], vertex_count)


def _graph_of(rows: np.ndarray, columns: np.ndarray, chosen: np.ndarray, like: csr_matrix) -> csr_matrix:
    return _links(rows[chosen], columns[chosen], like.shape[0])


def _links(rows: np.ndarray, columns: np.ndarray, vertex_count: int) -> csr_matrix:
    from scipy.sparse import csr_matrix

    values = np.ones(len(rows), dtype=np.int32)
    return csr_matrix((values, (rows, columns)), shape=(vertex_count, vertex_count))


def _either(a: csr_matrix, b: csr_matrix) -> csr_matrix:
    joined = (a + b).tocsr()
    joined.data = np.ones_like(joined.data)
    return joined


def _without_diagonal(matrix: csr_matrix) -> csr_matrix:
    rows, columns = matrix.nonzero()
    return _graph_of(rows, columns, rows != columns, matrix)


def _further_than_two(pairs: csr_matrix, graph: csr_matrix) -> csr_matrix:
    """Those of `pairs` that are more than two edges of `graph` apart."""
    near = _either(graph, graph @ graph)
    return _without_diagonal(pairs - pairs.multiply(near))
