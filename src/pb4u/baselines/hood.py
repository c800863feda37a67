"""HOOD: a mesh and two coarse levels, gone up and down like the strokes of a U (Grigorev et al. 2023; reference 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from pb4u.baselines.coarsening import coarse_levels, level_labels
from pb4u.baselines.encode_process_decode import (
    LEVEL,
    MESH_GRAPH_LAYOUT,
    EncodeProcessDecode,
    packed_pairs,
    require_scipy,
    with_edges,
)
from pb4u.errors import InputError
from pb4u.graph.features import FeatureLayout
from pb4u.graph.graph import GARMENT, Graph
from pb4u.graph.world_edges import WorldEdgeRule
from pb4u.nn.acceleration_model import Derived, NetworkConfiguration
from pb4u.nn.interaction_block import InteractionBlock
from pb4u.scene.packed import PackedGarments

NEAR, FAR = "coarse_near", "coarse_far"
SCHEDULE = (("mesh", NEAR), (NEAR, FAR), (FAR,), (NEAR, FAR), ("mesh", NEAR))
"""Kinds of garment edges that the blocks of each stage process."""


class LevelChoice(Protocol):
    """Asked which two coarse levels a garment uses."""

    def levels(self, mean_edge_length: float) -> tuple[int, int]:
        """The near and the far one, for a mean rest edge length [m]; an edge of level l spans 2^(l + 1) mesh edges."""


@dataclass(frozen=True)
class LevelsByHops:
    """HOOD's own: the same levels at every resolution, so that they shrink in metres as meshes get finer.

    Args:
        near, far: levels, counted from 0.
    """

    near: int = 0
    far: int = 1

    def __post_init__(self) -> None:
        if not 0 <= self.near < self.far <= 12:
            raise InputError(f"Coarse levels rise from 0 to at most 12, unlike {self.near} and {self.far}.")

    def levels(self, mean_edge_length: float) -> tuple[int, int]:
        return self.near, self.far


@dataclass(frozen=True)
class LevelsByLength:
    """Levels whose edges are about so long at every resolution; our own, not published.

    Args:
        near, far: lengths [m] of coarse edges; HOOD's at the 15 mm of its training meshes by default.
    """

    near: float = 0.03
    far: float = 0.06

    def __post_init__(self) -> None:
        if not 0.0 < self.near < self.far < math.inf:
            raise InputError(f"Coarse edges are of rising lengths above 0 m, unlike {self.near} and {self.far}.")

    def levels(self, mean_edge_length: float) -> tuple[int, int]:
        near, far = (round(math.log2(length / mean_edge_length)) - 1 for length in (self.near, self.far))
        near = max(near, 0)
        return near, max(far, near + 1)


@dataclass(frozen=True, kw_only=True)
class HoodConfiguration(NetworkConfiguration):
    """A HOOD.

    Args:
        width: of all latents and hidden layers.
        repeats: blocks of each of the five stages; 3 in the paper, 15 blocks together.
        choice: which coarse levels.
        layout: the columns read; coarse edges have those of mesh edges.
        world_edges: which body vertices a garment vertex sees.
    """

    width: int = 128
    repeats: int = 3
    choice: LevelsByHops | LevelsByLength = field(default_factory=LevelsByHops)
    layout: FeatureLayout = field(default_factory=lambda: MESH_GRAPH_LAYOUT)
    world_edges: WorldEdgeRule = field(default_factory=WorldEdgeRule)

    def network(self) -> Hood:
        """A network of this configuration with fresh weights."""
        return Hood(self)


class Hood(EncodeProcessDecode):
    """Blocks over one or two levels at a time. Every vertex keeps one latent, whatever the level."""

    def __init__(self, configuration: HoodConfiguration) -> None:
        require_scipy("HOOD")
        super().__init__(configuration, ("mesh", NEAR, FAR), levels=3)
        self.configuration = configuration
        self.choice: LevelChoice = configuration.choice
        self.schedule = tuple(kinds for kinds in SCHEDULE for _ in range(configuration.repeats))
        self.blocks = nn.ModuleList(InteractionBlock(configuration.width, (*kinds, "world")) for kinds in self.schedule)

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3); `steps` is not read."""
        nodes, edges = self.encode(graph)
        views = {kinds: with_edges(graph, (*kinds, "world")) for kinds in SCHEDULE}
        masks = [_level_masks(graph, depth) for depth in range(3)]
        put_aside: list[dict[str, Tensor]] = []
        for index, (kinds, block) in enumerate(zip(self.schedule, self.blocks, strict=True)):
            depth = _depth(kinds)
            if depth > len(put_aside):
                put_aside.append(_world_latents(graph, edges))
            elif depth < len(put_aside):
                edges = edges | put_aside.pop()
            last = index == len(self.blocks) - 1
            nodes, changed = block(nodes, edges, views[kinds], (GARMENT,) if last else None, masks[depth])
            edges = edges | changed
        return self.decoder(nodes[GARMENT])

    def derive(self, garments: PackedGarments) -> Derived:
        chosen = [_chosen_levels(garments, garment, self.choice) for garment in range(garments.garment_count)]
        offsets = garments.vertex_offsets
        counts = np.diff(offsets).tolist()
        labels = [level_labels(levels, count) for levels, count in zip(chosen, counts, strict=True)]
        return Derived(
            edges={
                name: packed_pairs([torch.from_numpy(levels[place]) for levels in chosen], offsets, garments.edges)
                for place, name in enumerate((NEAR, FAR))
            },
            rest={LEVEL: torch.from_numpy(np.concatenate(labels)).to(garments.device)},
        )


def garment_levels(garments: PackedGarments, garment: int, count: int) -> list[np.ndarray]:
    """The edges (edges, 2) of the first `count` coarse levels of one garment of a pack, numbered within it."""
    start, stop = garments.vertex_offsets[garment : garment + 2]
    edges = garments.edges[garments.edge_garment == garment].cpu().numpy() - start
    rest = garments.rest_positions[start:stop].to(torch.float64).cpu().numpy()
    return coarse_levels(edges, rest, count)


def _chosen_levels(garments: PackedGarments, garment: int, choice: LevelChoice) -> list[np.ndarray]:
    near, far = choice.levels(garments.mean_edge_lengths[garment])
    levels = garment_levels(garments, garment, far + 1)
    return [levels[near], levels[far]]


def _depth(kinds: Sequence[str]) -> int:
    """How many levels are left behind where these kinds of edges are the ones processed."""
    return ("mesh", NEAR, FAR).index(kinds[0])


def _world_latents(graph: Graph, edges: dict[str, Tensor]) -> dict[str, Tensor]:
    """Latents of world edges as they are before a stage on a coarser level, which the way up takes back."""
    latents = {name: edges[name] for name, edge_set in graph.edges.items() if edge_set.kind == "world"}
    # While gradients are off, blocks write over the latents they are given.
    return latents if torch.is_grad_enabled() else {name: values.clone() for name, values in latents.items()}


def _level_masks(graph: Graph, depth: int) -> dict[str, Tensor]:
    """(edges, 1) by edge set: 0 for world edges of garment vertices not on level `depth`, where the mesh is level 0."""
    if depth == 0:
        return {}
    on_level = (graph.rest[LEVEL] >= depth)[:, None]
    masks = {}
    for name, edge_set in graph.edges.items():
        if edge_set.kind == "world":
            garment_end = edge_set.receivers if edge_set.receiver_set == GARMENT else edge_set.senders
            masks[name] = on_level[garment_end.index].to(edge_set.features)
    return masks
