"""ContourCraft: a mesh with one coarse level, and edges between cloth that comes near itself (Grigorev et al. 2024).

Reference 6. Left out: edges to where pinned vertices will be, the repair of states by impulses and rigid zones during
training, the cutting out of faces that intersect from the start, and windows of hundreds of steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from pb4u.baselines.coarsening import level_labels
from pb4u.baselines.contact_losses import ContourLength, Repulsion
from pb4u.baselines.encode_process_decode import LEVEL, EncodeProcessDecode, packed_pairs, require_scipy
from pb4u.baselines.hood import garment_levels
from pb4u.baselines.self_proximity import ATTRACTION, REPULSION, SelfProximityEdges
from pb4u.errors import InputError
from pb4u.graph.builder import EdgeFinder, NoFoundEdges
from pb4u.graph.features import FOUND_EDGE_FEATURES, FeatureLayout
from pb4u.graph.graph import GARMENT, Graph
from pb4u.graph.world_edges import WorldEdgeRule
from pb4u.nn.acceleration_model import FurtherLoss, NetworkConfiguration
from pb4u.nn.interaction_block import InteractionBlock
from pb4u.scene.packed import PackedGarments

COARSE = "coarse"
CONTOURCRAFT_LAYOUT = FeatureLayout(
    mesh_edge=("relative_position", "length", "rest_length", "dt", "material"),
    world_edge=(
        "relative_now",
        "distance_now",
        "relative_next",
        "distance_next",
        "relative_velocity",
        "relative_speed",
        "dt",
    ),
    found_edge=tuple(FOUND_EDGE_FEATURES),
)


@dataclass(frozen=True, kw_only=True)
class ContourCraftConfiguration(NetworkConfiguration):
    """A ContourCraft.

    Args:
        width: of all latents and hidden layers.
        blocks: each over all kinds of edges.
        level: coarse level used besides the mesh; its edges span 2^(level + 1) mesh edges.
        radius: how near cloth must come to itself to be joined by edges [m]; 0 for no such edges.
        losses: what is minimised besides the incremental potential.
        layout: the columns read.
        world_edges: which body vertices a garment vertex sees.
    """

    width: int = 128
    blocks: int = 15
    level: int = 3
    radius: float = 0.03
    losses: tuple[Repulsion | ContourLength, ...] = (Repulsion(), ContourLength())
    layout: FeatureLayout = field(default_factory=lambda: CONTOURCRAFT_LAYOUT)
    world_edges: WorldEdgeRule = field(default_factory=WorldEdgeRule)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.level <= 12 or not 0.0 <= self.radius < float("inf"):
            raise InputError(
                f"ContourCraft needs a coarse level from 0 to 12 and a radius of 0 m or more, not {self.level} and "
                f"{self.radius}."
            )

    def network(self) -> ContourCraft:
        """A network of this configuration with fresh weights."""
        return ContourCraft(self)


class ContourCraft(EncodeProcessDecode):
    """Blocks over mesh, coarse, repulsion, attraction and world edges."""

    def __init__(self, configuration: ContourCraftConfiguration) -> None:
        require_scipy("ContourCraft")
        found = (REPULSION, ATTRACTION) if configuration.radius > 0 else ()
        super().__init__(configuration, ("mesh", COARSE), found, levels=configuration.level + 2)
        self.configuration = configuration
        kinds = ("mesh", COARSE, *found, "world")
        self.blocks = nn.ModuleList(InteractionBlock(configuration.width, kinds) for _ in range(configuration.blocks))

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3); `steps` is not read."""
        nodes, edges = self.encode(graph)
        for index, block in enumerate(self.blocks):
            last = index == len(self.blocks) - 1
            nodes, edges = block(nodes, edges, graph, receivers=(GARMENT,) if last else None)
        return self.decoder(nodes[GARMENT])

    def further_edges(self, garments: PackedGarments) -> Mapping[str, Tensor]:
        coarsest = [torch.from_numpy(levels[-1]) for levels in self._levels(garments)]
        return {COARSE: packed_pairs(coarsest, garments.vertex_offsets, garments.edges)}

    def rest_quantities(self, garments: PackedGarments) -> Mapping[str, Tensor]:
        counts = np.diff(garments.vertex_offsets).tolist()
        labels = [level_labels(levels, count) for levels, count in zip(self._levels(garments), counts, strict=True)]
        return {LEVEL: torch.from_numpy(np.concatenate(labels)).to(garments.device)}

    def edge_finder(self, garments: PackedGarments) -> EdgeFinder:
        radius = self.configuration.radius
        return SelfProximityEdges(garments, radius) if radius > 0 else NoFoundEdges()

    def further_losses(self) -> tuple[FurtherLoss, ...]:
        return self.configuration.losses

    def _levels(self, garments: PackedGarments) -> list[list[np.ndarray]]:
        count = self.configuration.level + 1
        return [garment_levels(garments, garment, count) for garment in range(garments.garment_count)]
