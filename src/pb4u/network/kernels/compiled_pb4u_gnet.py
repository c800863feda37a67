"""Pb4U-GNet without gradients on a processor, its weights prepared once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from pb4u.network.acceleration_model import Derived, GraphNetwork
from pb4u.network.graph.garment_graph import GarmentGraph
from pb4u.network.graph.graph import GARMENT, Graph
from pb4u.network.interaction_block import InteractionBlock
from pb4u.network.kernels.compiled_block import CompiledBlock, Latents, pass_blocks
from pb4u.network.kernels.compiled_mlp import CompiledMLP
from pb4u.network.kernels.compiled_propagation import CompiledPropagation
from pb4u.network.kernels.products import COLUMNS, multiplies_in
from pb4u.network.mlp import MLP
from pb4u.scene.packed import PackedGarments

if TYPE_CHECKING:
    from pb4u.network.pb4u_gnet import Pb4uGNet


class CompiledPb4uGNet(GraphNetwork):
    """The same function as a `Pb4uGNet`, compiled.

    Encoders and decoder multiply in float32, the rest in the precision asked for.

    Args:
        network: on a processor, in float32, one that it `takes`; its weights are copied.
        precision: of the products, float32 or bfloat16.
    """

    propagates = True

    @staticmethod
    def takes(network: Pb4uGNet, precision: torch.dtype) -> bool:
        """Whether this processor multiplies in `precision` in kernels, and they cover the network's form and width."""
        form, width = network.propagation.form, network.configuration.width
        return width % COLUMNS == 0 and not form.message_norm and multiplies_in(precision)

    def __init__(self, network: Pb4uGNet, precision: torch.dtype) -> None:
        super().__init__(network.configuration)
        self.exact, self.precision = network, precision
        encoders: dict[str, MLP] = dict(network.edge_encoders.items())  # type: ignore[arg-type]
        blocks: list[InteractionBlock] = list(network.blocks)  # type: ignore[arg-type]
        self.node_encoder = CompiledMLP(network.node_encoder, torch.float32)
        self.edge_encoders = {kind: CompiledMLP(mlp, torch.float32) for kind, mlp in encoders.items()}
        self.propagation = CompiledPropagation(network.propagation, precision)
        self.update = CompiledMLP(network.update, precision)
        self.blocks = [CompiledBlock(block, precision) for block in blocks]
        self.decoder = CompiledMLP(network.decoder, torch.float32)

    @torch.no_grad()
    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3), dimensionless.

        Args:
            graph: with normalised features.
            steps: propagation steps of each garment.
        """
        # A process that was handed the network has not asked for the matrix units yet.
        if not multiplies_in(self.precision):
            raise RuntimeError(f"This processor does not multiply in {self.precision} in kernels.")
        nodes = {name: self.node_encoder.normed(values) for name, values in self.exact.node_inputs(graph).items()}
        edges = {name: self.edge_encoders[s.kind].normed(s.features) for name, s in graph.edges.items()}
        latents = Latents(nodes, edges, graph, self.exact.kinds, self.precision)
        propagated = self.propagation(latents, list(pairwise(graph.vertex_offsets)), steps)
        both = torch.cat([latents.rounded_nodes(GARMENT), propagated.to(self.precision)], dim=1)
        latents.replace_nodes(GARMENT, self.update.normed(both))
        pass_blocks(self.blocks, latents, GARMENT)
        return self.decoder.plain(latents.nodes[GARMENT])

    def propagation_steps(self, mean_edge_length: float) -> int:
        """Number K of propagation steps of a garment of `mean_edge_length` [m]."""
        return self.exact.propagation_steps(mean_edge_length)

    def update_scale(self, garments: GarmentGraph) -> Tensor | None:
        """Factors (vertices, 1), dimensionless, on the accelerations, or None for 1."""
        return self.exact.update_scale(garments)

    def derive(self, garments: PackedGarments) -> Derived:
        """Data that the network needs of a pack beyond its meshes."""
        return self.exact.derive(garments)
