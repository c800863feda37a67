"""Cache of data derived from the meshes of a pack at rest: trainings prepare the same garments again and again."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from pb4u.paper.baselines.coarsening import level_labels
from pb4u.scene.packed import PackedGarments

T = TypeVar("T")


class MeshMemory(Generic[T]):
    """Cache of the latest results of a function of a mesh and a count; meshes are distinguished by their content.

    Args:
        derive: called with edges (edges, 2) int64, rest positions (vertices, 3) [m] and the count.
        remembered: number of cached results.
    """

    def __init__(self, derive: Callable[[np.ndarray, np.ndarray, int], T], remembered: int) -> None:
        self._derive, self._remembered = derive, remembered
        self._results: OrderedDict[bytes, T] = OrderedDict()

    def of(self, garments: PackedGarments, garment: int, count: int) -> T:
        """Result for one garment of a pack, its vertices numbered within it.

        Args:
            garments: the pack.
            garment: index of the garment.
            count: third argument of `derive`.
        """
        start, stop = garments.vertex_offsets[garment : garment + 2]
        edges = garments.edges[garments.edge_garment == garment].cpu().numpy() - start
        rest = garments.rest_positions[start:stop].to(torch.float64).cpu().numpy()
        key = hashlib.blake2b(edges.tobytes() + rest.tobytes() + count.to_bytes(4, "little"), digest_size=16).digest()
        if key not in self._results:
            self._results[key] = self._derive(edges, rest, count)
            while len(self._results) > self._remembered:
                self._results.popitem(last=False)
        self._results.move_to_end(key)
        return self._results[key]


def levels_of(
    garments: PackedGarments, garment: int, count: int, memory: MeshMemory[list[np.ndarray]]
) -> list[np.ndarray]:
    """Edges (edges, 2) int64 of the first `count` coarse levels of a garment: from its file if it has them.

    Args:
        garments: the pack.
        garment: index of the garment.
        count: number of levels.
        memory: computes levels for garments whose file has too few.
    """
    levels = garments.garments[garment].coarse_edges
    return list(levels[:count]) if len(levels) >= count else memory.of(garments, garment, count)


def packed_levels(
    garments: PackedGarments,
    levels: Sequence[Sequence[np.ndarray]],
    kinds: Sequence[str],
    labelled: Sequence[Sequence[np.ndarray]] | None = None,
) -> tuple[dict[str, Tensor], Tensor]:
    """Edges (edges, 2) int64 vertex indices of the pack by kind, and the number of levels at each vertex (vertices,).

    The number is int64: of the coarse levels that the vertex has edges on.

    Args:
        garments: the pack.
        levels: edges (edges, 2) int64 indices of each garment's coarse levels, from fine to coarse, numbered within it.
        kinds: names of the last levels of each garment.
        labelled: levels of each garment for the labels of its vertices; by default the same.
    """
    spans = list(pairwise(garments.vertex_offsets))
    labels = [level_labels(level, stop - start) for level, (start, stop) in zip(labelled or levels, spans, strict=True)]
    shifted = [[edges + start for edges in level] for level, (start, _) in zip(levels, spans, strict=True)]
    edges_by_kind = zip(kinds, zip(*(level[-len(kinds) :] for level in shifted), strict=True), strict=True)
    edges = {kind: torch.from_numpy(np.concatenate(parts)).to(garments.device) for kind, parts in edges_by_kind}
    return edges, torch.from_numpy(np.concatenate(labels)).to(garments.device)
