"""Skinning weights that a garment borrows from the body it is worn on."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import hand_bones
from pb4u.body.skinning import SkinningWeights, strongest_influences
from pb4u.garment.garment import Garment
from pb4u.geometry.triangle_mesh import area_weighted_normals

INFLUENCES = 8
"""Bones that move one garment vertex, at most."""

# Nearest skin vertices that a close garment's weights are the mean of; the width of that mean grows with them.
_NEIGHBOURS = 16
# Samples around each vertex of a loose garment, a power of two as an even draw needs; the cost grows with them.
_SAMPLES = 256
# A sample may take skin this much farther than the nearest: the mean hardly moves, in half the time.
_SLACK = 0.3
# Vertices sampled at a time, which bounds the memory.
_SAMPLE_CHUNK = 2048
# So many edges may join different bones before a close garment counts as split between limbs, and is dressed as loose.
_TEARING_EDGES = 4


def borrow_weights(garment: Garment, body: ShapedBody) -> SkinningWeights:
    """Skinning weights for a garment, at most `INFLUENCES` bones a vertex.

    A close garment takes the weights of the nearest skin that faces the same way. A loose garment, or one that this
    would tear between the legs, takes the mean over Gaussian samples around each vertex with the distance to the body
    as standard deviation (reference 1.6). Both are then smoothed over the cloth, farther where the body is farther.

    Args:
        garment: worn by the body in its rest pose.
        body: its skinning weights are used.
    """
    # Hands, and skin inside other skin, must not drag cloth along.
    hands = hand_bones(body.skeleton.names, body.skeleton.parents)
    allowed = np.flatnonzero(body.contact & (body.weights.share_of(hands) <= 0.5))
    if not len(allowed):
        allowed = np.arange(len(body.vertices))
    tree = cKDTree(body.vertices[allowed])
    skin_weights = body.weights.dense(body.skeleton.bone_count)[allowed]
    distances, nearest = tree.query(garment.vertices, k=min(_NEIGHBOURS, len(allowed)))
    distances, nearest = distances.reshape(len(distances), -1), nearest.reshape(len(nearest), -1)

    loose = garment.loose
    weights = _nearest_skin(
        garment, area_weighted_normals(body.vertices, body.faces)[allowed], distances, nearest, skin_weights
    )
    if loose or _splitting_edges(garment, weights) > _TEARING_EDGES:
        loose = True
        weights = _gaussian_mean(garment.vertices, distances[:, 0], tree, skin_weights)
    reach = 0.02 + distances[:, 0] if loose else 0.007 + 0.75 * distances[:, 0]
    weights = diffuse(garment, weights, reach)
    bones = np.broadcast_to(np.arange(weights.shape[1]), weights.shape)
    return strongest_influences(bones, weights, INFLUENCES)


def diffuse(garment: Garment, values: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Values diffused over the cloth: one implicit step of heat flow.

    Every result is a mean of the values around it, so rows that sum to 1 still do, whatever the triangles look like.

    Args:
        garment: the cloth.
        values: (vertices, n), in any unit.
        reach: (vertices,) about how far each value is spread [m].

    Returns:
        (vertices, n), in the same unit.
    """
    edges, lengths = garment.topology.edges, np.maximum(garment.edge_lengths, 1e-6)
    count = len(garment.vertices)
    a, b = np.concatenate([edges, edges[:, ::-1]]).T
    adjacency = csr_matrix((np.tile(1.0 / lengths**2, 2), (a, b)), shape=(count, count))
    degree = np.maximum(np.bincount(a, minlength=count), 1)
    # On a regular triangulation 4 / degree x sum((u_j - u_i) / length^2) is the Laplacian of u.
    rate = 4.0 * reach**2 / degree
    laplacian = diags(np.asarray(adjacency.sum(axis=1)).reshape(-1)) - adjacency
    solver = splu((identity(count) + diags(rate) @ laplacian).tocsc())
    used = np.flatnonzero(values.any(axis=0))
    spread = np.zeros_like(values)
    spread[:, used] = np.maximum(solver.solve(np.ascontiguousarray(values[:, used], dtype=np.float64)), 0.0)
    return spread


def _nearest_skin(
    garment: Garment, normals: np.ndarray, distances: np.ndarray, nearest: np.ndarray, skin_weights: np.ndarray
) -> np.ndarray:
    """(vertices, bones): mean over the nearest skin vertices, nearer ones and those facing the same way first."""
    facing = np.einsum("id,ikd->ik", area_weighted_normals(garment.vertices, garment.faces), normals[nearest])
    if np.median(facing[:, 0]) < 0.0:  # the whole garment is inside out
        facing = -facing
    width = 0.5 * (distances[:, -1:] - distances[:, :1]) + 1e-9
    closeness = np.exp(-0.5 * ((distances - distances[:, :1]) / width) ** 2) * np.clip(facing, 0.02, 1.0)
    closeness /= closeness.sum(axis=1, keepdims=True)
    count, k = nearest.shape
    mix = csr_matrix((closeness.reshape(-1), nearest.reshape(-1), np.arange(count + 1) * k), (count, len(skin_weights)))
    return np.asarray(mix @ skin_weights)


def _gaussian_mean(vertices: np.ndarray, sigma: np.ndarray, tree: cKDTree, skin_weights: np.ndarray) -> np.ndarray:
    """(vertices, bones): mean weights of the skin vertices nearest to samples N(vertex, sigma^2)."""
    from scipy.stats.qmc import MultivariateNormalQMC

    # An even draw, the same at every vertex: noise would wrinkle the cloth.
    draw = MultivariateNormalQMC(np.zeros(3), seed=0).random(_SAMPLES)
    mean = np.empty((len(vertices), skin_weights.shape[1]))
    for start in range(0, len(vertices), _SAMPLE_CHUNK):
        rows = slice(start, start + _SAMPLE_CHUNK)
        samples = vertices[rows, None] + sigma[rows, None, None] * draw
        hit = tree.query(samples.reshape(-1, 3), eps=_SLACK)[1]
        count = len(samples)
        mix = csr_matrix(
            (np.full(len(hit), 1.0 / _SAMPLES), hit, np.arange(count + 1) * _SAMPLES), (count, len(skin_weights))
        )
        mean[rows] = mix @ skin_weights
    return mean


def _splitting_edges(garment: Garment, weights: np.ndarray) -> int:
    """Number of edges whose two ends mostly follow different bones."""
    a, b = garment.topology.edges.T
    return int((np.abs(weights[a] - weights[b]).sum(axis=1) > 1.0).sum())
