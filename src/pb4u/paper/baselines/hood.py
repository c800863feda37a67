"""HOOD: a mesh and two coarse levels, from fine to coarse and back (Grigorev et al. 2023; reference 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from pb4u.errors import InputError
from pb4u.network.acceleration_model import Derived, NetworkConfiguration
from pb4u.network.encode_process_decode import LEVEL, EncodeProcessDecode
from pb4u.network.graph.features import FeatureLayout
from pb4u.network.graph.graph import GARMENT, Graph
from pb4u.network.interaction_block import InteractionBlock
from pb4u.network.mlp import MLP
from pb4u.paper.baselines.coarsening import REMEMBERED, coarse_levels
from pb4u.paper.baselines.meshgraphnet import MESH_GRAPH_LAYOUT
from pb4u.paper.baselines.rest_meshes import MeshMemory, levels_of, packed_levels
from pb4u.scene.packed import PackedGarments

NEAR, FAR = "coarse_near", "coarse_far"
SCHEDULE = (("mesh", NEAR), (NEAR, FAR), (FAR,), (NEAR, FAR), ("mesh", NEAR))
"""Kinds of garment edges that the blocks of each stage process."""


@dataclass(frozen=True)
class LevelsByHops:
    """HOOD's own rule: the same levels at every resolution, so that they shrink in metres as meshes get finer.

    Args:
        near: number of the finer level, counted from 0.
        far: number of the coarser level.

    Raises:
        InputError: the levels do not rise from 0 to at most 12.
    """

    near: int = 0
    far: int = 1

    def __post_init__(self) -> None:
        if not 0 <= self.near < self.far <= 12:
            raise InputError(f"Coarse levels must rise, from 0 to at most 12; {self.near} and {self.far} do not.")


@dataclass(frozen=True, kw_only=True)
class HoodConfiguration(NetworkConfiguration):
    """Configuration of a HOOD; fields that are not listed are as in `NetworkConfiguration`.

    Args:
        repeats: blocks of each of the five stages, one number for all or one for each; 3 in the paper, 15 blocks in
            total.
        choice: rule for the coarse levels.
        labelled: number of levels, from the finest, that vertices are labelled by; 3 in HOOD's code, None for the two
            that are used.
        layout: the feature columns; coarse edges have those of mesh edges.

    Raises:
        InputError: a stage without a block, or a number of labelled levels that is not from 1 to 12.
    """

    repeats: int | tuple[int, ...] = 3
    choice: LevelsByHops = field(default_factory=LevelsByHops)
    labelled: int | None = None
    layout: FeatureLayout = field(default_factory=lambda: MESH_GRAPH_LAYOUT)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.blocks_by_stage) != len(SCHEDULE) or min(self.blocks_by_stage) < 1:
            raise InputError(f"HOOD must have {len(SCHEDULE)} stages of 1 block or more each, not {self.repeats}.")
        if self.labelled is not None and not 1 <= self.labelled <= 12:
            raise InputError(f"Vertices can be labelled with 1 to 12 coarse levels, not {self.labelled}.")

    @property
    def blocks_by_stage(self) -> tuple[int, ...]:
        """Number of blocks of each stage."""
        return (self.repeats,) * len(SCHEDULE) if isinstance(self.repeats, int) else tuple(self.repeats)

    def network(self) -> Hood:
        """A network of this configuration with fresh weights."""
        return Hood(self)


class Hood(EncodeProcessDecode):
    """Network of blocks over one or two levels at a time; every vertex has one latent for all levels.

    Args:
        configuration: width, columns, levels and blocks.
    """

    def __init__(self, configuration: HoodConfiguration) -> None:
        super().__init__(configuration, ("mesh", NEAR, FAR), levels=1 + (configuration.labelled or 2))
        self.choice = configuration.choice
        self.labelled = configuration.labelled
        self._levels = MeshMemory(coarse_levels, REMEMBERED)
        width = configuration.width
        self.decoder = MLP(width, width, 3, norm=False)
        stages = zip(SCHEDULE, configuration.blocks_by_stage, strict=True)
        self.schedule = tuple(kinds for kinds, count in stages for _ in range(count))
        self.blocks = nn.ModuleList(InteractionBlock(width, (*kinds, "world")) for kinds in self.schedule)

    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3), dimensionless.

        Args:
            graph: with normalised features.
            steps: not read.
        """
        nodes, edges = self.encode(graph)
        masks = [_level_masks(graph, depth) for depth in range(3)]
        saved: list[dict[str, Tensor]] = []
        for index, (kinds, block) in enumerate(zip(self.schedule, self.blocks, strict=True)):
            depth = _depth(kinds)
            if depth > len(saved):
                saved.append(_world_latents(graph, edges))
            elif depth < len(saved):
                stayed = masks[len(saved)]
                before = saved.pop()
                # Edges that left the level take back what they had, and those that stayed keep what they became.
                edges = edges | {name: torch.where(stayed[name] > 0.0, edges[name], before[name]) for name in before}
            last = index == len(self.blocks) - 1
            nodes, changed = block(nodes, edges, graph, (GARMENT,) if last else None, masks[depth])
            edges = edges | changed
        return self.decoder(nodes[GARMENT])

    def derive(self, garments: PackedGarments) -> Derived:
        chosen, labelled = [], []
        near, far = self.choice.near, self.choice.far
        for garment in range(garments.garment_count):
            levels = levels_of(garments, garment, max(far + 1, self.labelled or 0), self._levels)
            chosen.append([levels[near], levels[far]])
            labelled.append(chosen[-1] if self.labelled is None else levels[: self.labelled])
        edges, labels = packed_levels(garments, chosen, (NEAR, FAR), labelled)
        return Derived(edges=edges, rest={LEVEL: labels})


def _depth(kinds: Sequence[str]) -> int:
    """The finest level that these kinds of edges belong to, where the mesh is level 0."""
    return ("mesh", NEAR, FAR).index(kinds[0])


def _world_latents(graph: Graph, edges: dict[str, Tensor]) -> dict[str, Tensor]:
    """Latents of world edges before a stage on a coarser level, taken back once it has ended."""
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
