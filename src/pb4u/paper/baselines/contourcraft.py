"""ContourCraft: a mesh with one coarse level, and edges between cloth that comes near itself (Grigorev et al. 2024).

Reference 6. Left out: edges to where pinned vertices will be, the repair of states by impulses and rigid zones during
training, the cutting out of faces that intersect from the start, and windows of hundreds of steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from torch import Tensor, nn

from pb4u.errors import InputError
from pb4u.network.acceleration_model import Derived, NetworkConfiguration
from pb4u.network.encode_process_decode import LEVEL, EncodeProcessDecode
from pb4u.network.graph.features import FeatureLayout
from pb4u.network.graph.graph import Graph
from pb4u.network.interaction_block import InteractionBlock
from pb4u.network.mlp import MLP
from pb4u.paper.baselines.coarsening import REMEMBERED, coarse_levels
from pb4u.paper.baselines.directed_self_contact import DirectedSelfEdges
from pb4u.paper.baselines.rest_meshes import MeshMemory, levels_of, packed_levels
from pb4u.paper.baselines.self_contact_edges import (
    ATTRACTION,
    REPULSION,
    ContourLength,
    Repulsion,
    SelfContactLoss,
    SymmetricSelfEdges,
    own_proximity,
)
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
    found_edge=(
        "relative_position",
        "length",
        "previous_relative_position",
        "previous_length",
        "relative_velocity",
        "relative_speed",
        "dt",
        "material",
    ),
)


@dataclass(frozen=True, kw_only=True)
class ContourCraftConfiguration(NetworkConfiguration):
    """Configuration of a ContourCraft; fields that are not listed are as in `NetworkConfiguration`.

    Args:
        blocks: number of blocks, each over all kinds of edges.
        level: coarse level used besides the mesh; its edges span 2^(level + 1) mesh edges.
        radius: distance [m] within which cloth is joined to itself by edges; 0 for no such edges.
        losses: losses minimised besides the incremental potential.
        self_edges: rule for the edges between parts of cloth that are near each other.
        layout: the columns read.

    Raises:
        InputError: a level that is not from 0 to 12, or a radius below 0.
    """

    blocks: int = 15
    level: int = 3
    radius: float = 0.03
    losses: tuple[Repulsion | ContourLength, ...] = (Repulsion(), ContourLength())
    self_edges: SymmetricSelfEdges | DirectedSelfEdges = field(default_factory=SymmetricSelfEdges)
    layout: FeatureLayout = field(default_factory=lambda: CONTOURCRAFT_LAYOUT)

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
    """Network of blocks over mesh, coarse, repulsion, attraction and world edges.

    Args:
        configuration: width, columns, level and blocks.
    """

    configuration: ContourCraftConfiguration

    def __init__(self, configuration: ContourCraftConfiguration) -> None:
        contact_kinds = (REPULSION, ATTRACTION) if configuration.radius > 0 else ()
        super().__init__(configuration, ("mesh", COARSE), contact_kinds, levels=configuration.level + 2)
        self._levels = MeshMemory(coarse_levels, REMEMBERED)
        width, kinds = configuration.width, ("mesh", COARSE, *contact_kinds, "world")
        self.decoder = MLP(width, width, 3, norm=False)
        self.blocks = nn.ModuleList(InteractionBlock(width, kinds) for _ in range(configuration.blocks))

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3), dimensionless.

        Args:
            graph: with normalised features.
            steps: not read.
        """
        return self.decode_after(self.blocks, *self.encode(graph), graph)

    def derive(self, garments: PackedGarments) -> Derived:
        c, proximity = self.configuration, own_proximity(garments)
        count = garments.garment_count
        levels = [levels_of(garments, garment, c.level + 1, self._levels) for garment in range(count)]
        edges, labels = packed_levels(garments, levels, (COARSE,))
        return Derived(
            edges=edges,
            finder=c.self_edges.finder(garments, proximity, c.radius) if c.radius > 0 else None,
            rest={LEVEL: labels},
            losses=tuple(SelfContactLoss(loss, garments, proximity) for loss in c.losses),
        )
