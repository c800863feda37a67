"""ContourCraft: a mesh with one coarse level, and edges between cloth that comes near itself (Grigorev et al. 2024).

Reference 6. Left out: edges to where pinned vertices will be, the repair of states by impulses and rigid zones during
training, the cutting out of faces that intersect from the start, and windows of hundreds of steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from pb4u.baselines.coarsening import level_labels
from pb4u.baselines.contact_losses import ContourLength, Repulsion, SelfContactLoss
from pb4u.baselines.encode_process_decode import LEVEL, EncodeProcessDecode, packed_pairs, require_scipy
from pb4u.baselines.hood import garment_levels
from pb4u.baselines.proximity_edges import ATTRACTION, REPULSION, SelfProximityEdges, garments_proximity
from pb4u.errors import InputError
from pb4u.graph.builder import NoFoundEdges
from pb4u.graph.features import FOUND_EDGE_FEATURES, FeatureLayout
from pb4u.graph.graph import GARMENT, Graph
from pb4u.graph.world_edges import WorldEdgeRule
from pb4u.nn.acceleration_model import Derived, NetworkConfiguration
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

    def derive(self, garments: PackedGarments) -> Derived:
        c = self.configuration
        levels = [garment_levels(garments, garment, c.level + 1) for garment in range(garments.garment_count)]
        coarsest = [torch.from_numpy(of[-1]) for of in levels]
        counts = np.diff(garments.vertex_offsets).tolist()
        labels = [level_labels(of, count) for of, count in zip(levels, counts, strict=True)]
        finders = garments_proximity(garments)
        return Derived(
            edges={COARSE: packed_pairs(coarsest, garments.vertex_offsets, garments.edges)},
            finder=SelfProximityEdges(finders, garments.vertex_offsets, c.radius) if c.radius > 0 else NoFoundEdges(),
            rest={LEVEL: torch.from_numpy(np.concatenate(labels)).to(garments.device)},
            losses=tuple(SelfContactLoss(loss, garments, finders) for loss in c.losses),
        )
