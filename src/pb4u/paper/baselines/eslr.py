"""ESLR, reconstructed: smoothed message passing beside attention that knows geodesic distances.

Liu et al. 2025 (arXiv 2504.11763) say in words what the two modules are; their code and many numbers (layers, heads,
tokens, how the two join) are not public. What is not stated is our choice (reference 5.4): this is not the authors'
network, and its results are not theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pb4u.errors import InputError
from pb4u.network.acceleration_model import Derived, NetworkConfiguration
from pb4u.network.encode_process_decode import EncodeProcessDecode
from pb4u.network.graph.features import FeatureLayout
from pb4u.network.graph.graph import GARMENT, Graph
from pb4u.network.interaction_block import InteractionBlock
from pb4u.network.mlp import MLP, SplitMLP
from pb4u.network.segment import gather, segment_sum
from pb4u.paper.baselines.meshgraphnet import MESH_GRAPH_LAYOUT
from pb4u.paper.baselines.rest_meshes import MeshMemory
from pb4u.scene.packed import PackedGarments

LANDMARKS, GEODESICS = "landmarks", "geodesics"
_BIAS_WIDTH = 16
_ROWS_PER_PIECE = 4096
"""Vertices that attend at once: with 256 landmarks and 4 heads their scores take 17 MB in float32."""
_REMEMBERED = 16
"""Garments whose distances are kept: at 38,000 triangles and 256 landmarks they take 20 MB each."""


@dataclass(frozen=True, kw_only=True)
class EslrConfiguration(NetworkConfiguration):
    """Configuration of a reconstruction of ESLR; fields that are not listed are as in `NetworkConfiguration`.

    Args:
        layers: number of layers, each with message passing and attention in parallel.
        landmarks: number of vertices of a garment that attention runs over; 0 for no attention at all.
        heads: number of attention heads; it divides the width.
        geodesic_scale: length that geodesic distances are measured in [m].
        layout: the columns read.

    Raises:
        InputError: landmarks below 0, a scale that is not above 0, or heads that do not divide the width.
    """

    layers: int = 8
    landmarks: int = 256
    heads: int = 4
    geodesic_scale: float = 0.1
    layout: FeatureLayout = field(default_factory=lambda: MESH_GRAPH_LAYOUT)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.landmarks < 0 or self.heads < 1 or self.width % self.heads or not self.geodesic_scale > 0.0:
            raise InputError(
                "ESLR needs 0 landmarks or more, a number of heads that divides the width and a scale above 0 m, not "
                f"{self.landmarks}, {self.heads} and {self.geodesic_scale}."
            )

    def network(self) -> Eslr:
        """A network of this configuration with fresh weights."""
        return Eslr(self)


class Eslr(EncodeProcessDecode):
    """Network of layers of local message passing beside attention over landmarks.

    Args:
        configuration: width, columns, layers and attention.
    """

    configuration: EslrConfiguration

    def __init__(self, configuration: EslrConfiguration) -> None:
        super().__init__(configuration)
        self._landmarks = MeshMemory(geodesic_landmarks, _REMEMBERED)
        self.decoder = MLP(configuration.width, configuration.width, 3, norm=False)
        self.layers = nn.ModuleList(_Layer(configuration) for _ in range(configuration.layers))

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3), dimensionless.

        Args:
            graph: with normalised features.
            steps: not read.
        """
        nodes, edges = self.encode(graph)
        for layer in self.layers:
            nodes, edges = layer(nodes, edges, graph)
        return self.decoder(nodes[GARMENT])

    def derive(self, garments: PackedGarments) -> Derived:
        count = self.configuration.landmarks
        if count == 0:
            return Derived()
        landmarks, distances = [], []
        for garment in range(garments.garment_count):
            chosen, away = self._landmarks.of(garments, garment, count)
            landmarks.append(torch.from_numpy(chosen))
            distances.append(torch.from_numpy(away) / self.configuration.geodesic_scale)
        device = garments.device
        return Derived(rest={LANDMARKS: torch.stack(landmarks).to(device), GEODESICS: torch.cat(distances).to(device)})


class _Layer(nn.Module):
    """V <- V + MLP([message passing and smoothing, attention]); bodies take part in message passing only."""

    def __init__(self, configuration: EslrConfiguration) -> None:
        super().__init__()
        width = configuration.width
        self.local = InteractionBlock(width, ("mesh", "world"))
        self.smoothed = MLP(width, width, width, norm=True)
        self.distant = GeodesicAttention(width, configuration.heads) if configuration.landmarks else None
        self.fusion = SplitMLP((width, width), width, width, norm=True)

    def forward(
        self, nodes: dict[str, Tensor], edges: dict[str, Tensor], graph: Graph
    ) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        before = nodes[GARMENT]
        nodes, edges = self.local(nodes, edges, graph)
        near = self.smoothed(_neighbour_mean(nodes[GARMENT], edges["mesh"], graph))
        hidden = self.fusion.project(0, near, bias=True)
        if self.distant is not None:
            hidden = hidden + self.fusion.project(1, self.distant(before, graph))
        return {**nodes, GARMENT: before + self.fusion.after_first(hidden)}, edges


def _neighbour_mean(nodes: Tensor, latents: Tensor, graph: Graph) -> Tensor:
    """Mean (vertices, width) of v_j + e_ij over the mesh neighbours j of each vertex i; 0 where it has none."""
    mesh = graph.edges["mesh"]
    total = segment_sum(gather(nodes, mesh.senders) + latents, mesh.receivers)
    return total / mesh.degrees().to(total).clamp_min(1.0)


class GeodesicAttention(nn.Module):
    """Attention of landmarks to each other, then of every vertex to them; scores have a learned bias of the distance.

    Args:
        width: number of columns of the latents.
        heads: number of attention heads; it divides the width.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.collect, self.spread = _Attention(width, heads), _Attention(width, heads)

    def forward(self, values: Tensor, graph: Graph) -> Tensor:
        """Latents (vertices, width), dimensionless, after attention within each garment.

        Args:
            values: (vertices, width) [1] latents of the garments.
            graph: with landmarks and geodesic distances in `Graph.rest`.
        """
        values = self.norm(values)
        landmarks, geodesics, offsets = graph.rest[LANDMARKS], graph.rest[GEODESICS].to(values), graph.vertex_offsets
        results = []
        for garment in range(len(offsets) - 1):
            rows, away = (of[offsets[garment] : offsets[garment + 1]] for of in (values, geodesics))
            # Where there are fewer vertices than landmarks, the landmarks beyond them do not exist.
            marks, away = landmarks[garment, : len(rows)], away[:, : len(rows)]
            tokens = rows[marks]
            tokens = tokens + self.collect(tokens, tokens, away[marks])
            pieces = [
                self.spread(rows[start : start + _ROWS_PER_PIECE], tokens, away[start : start + _ROWS_PER_PIECE])
                for start in range(0, len(rows), _ROWS_PER_PIECE)
            ]
            results.append(torch.cat(pieces))
        return torch.cat(results)


class _Attention(nn.Module):
    """softmax(Q K^T / sqrt(d) + b(g)) V, with b an MLP of the distance for each head."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value = (nn.Linear(width, width, bias=False) for _ in range(3))
        self.bias = nn.Sequential(nn.Linear(1, _BIAS_WIDTH), nn.ReLU(), nn.Linear(_BIAS_WIDTH, heads))
        self.output = nn.Linear(width, width)

    def forward(self, queries: Tensor, tokens: Tensor, distances: Tensor) -> Tensor:
        """Latents (queries, width) mixed from those of the tokens.

        Args:
            queries: (queries, width) latents.
            tokens: (tokens, width) latents.
            distances: (queries, tokens) in units of the scale.
        """
        q, k, v = (self._split(values) for values in (self.query(queries), self.key(tokens), self.value(tokens)))
        bias = self.bias(distances[..., None]).permute(2, 0, 1).contiguous()
        mixed = F.scaled_dot_product_attention(q[None], k[None], v[None], attn_mask=bias[None])[0]
        return self.output(mixed.transpose(0, 1).reshape(len(queries), -1))

    def _split(self, values: Tensor) -> Tensor:
        return values.view(len(values), self.heads, -1).transpose(0, 1)


def geodesic_landmarks(edges: np.ndarray, rest_positions: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Farthest-point landmarks (count,) int64 and shortest paths along edges to them (vertices, count) float32 [m].

    The first is the vertex farthest from the middle, each next one the vertex farthest from the landmarks so far, so
    that every piece gets one if there are enough. A missing path counts as twice the longest existing one. Where there
    are fewer vertices than landmarks, the rest of the landmarks are -1 and infinitely far.

    Args:
        edges: (edges, 2) int64 vertex indices of the mesh.
        rest_positions: (vertices, 3) [m].
        count: number of landmarks.
    """
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
