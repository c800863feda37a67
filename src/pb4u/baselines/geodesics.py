"""Landmarks spread over a garment, and how far every vertex is from them along the cloth."""

from __future__ import annotations

import numpy as np

from pb4u.baselines.mesh_memory import MeshMemory

_REMEMBERED = 16


def geodesic_landmarks(edges: np.ndarray, rest_positions: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Farthest-point landmarks (count,) int64 and shortest ways along edges to them (vertices, count) [m], at rest.

    The first is the vertex farthest from the middle, each next the one farthest from those before, so that every piece
    gets one while they last. A way that does not exist counts twice the longest that does. Where there are fewer
    vertices than landmarks, the rest of the landmarks are -1 and infinitely far.

    Args:
        edges: (edges, 2) of the mesh. rest_positions: (vertices, 3) [m]. count: number of landmarks.
    """
    return _memory.recall(edges, rest_positions, count)


def _geodesic_landmarks(edges: np.ndarray, rest_positions: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    vertex_count = len(rest_positions)
    lengths = np.linalg.norm(rest_positions[edges[:, 0]] - rest_positions[edges[:, 1]], axis=1)
    both = np.concatenate([edges, edges[:, ::-1]])
    ways = csr_matrix((np.tile(lengths, 2), (both[:, 0], both[:, 1])), shape=(vertex_count, vertex_count))
    landmarks = np.full(count, -1, dtype=np.int64)
    distances = np.full((vertex_count, count), np.inf)
    nearest = np.full(vertex_count, np.inf)
    offset = np.linalg.norm(rest_positions - rest_positions.mean(axis=0), axis=1)
    following = int(np.argmax(offset))
    for number in range(min(count, vertex_count)):
        landmarks[number] = following
        distances[:, number] = dijkstra(ways, directed=True, indices=following)
        nearest = np.minimum(nearest, distances[:, number])
        farthest = np.flatnonzero(nearest == nearest.max())
        following = int(farthest[np.argmax(offset[farthest])])
    used = distances[:, : min(count, vertex_count)]
    used[~np.isfinite(used)] = 2.0 * used[np.isfinite(used)].max()
    return landmarks, distances.astype(np.float32)


_memory = MeshMemory(_geodesic_landmarks, _REMEMBERED)
