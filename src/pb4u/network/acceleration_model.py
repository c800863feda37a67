"""The interface that the simulation step and the trainer know: a graph in, accelerations out."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar, Protocol

import torch
from torch import Tensor, nn

from pb4u.errors import InputError
from pb4u.network.graph.builder import EdgeFinder, GraphBuilder
from pb4u.network.graph.features import Feature, FeatureLayout
from pb4u.network.graph.garment_graph import GarmentGraph, garment_graph
from pb4u.network.graph.graph import EdgeSet, Graph
from pb4u.network.graph.pins import PinsAtPresent, PinsAtTarget, PinsAtTargetInEdges
from pb4u.network.graph.world_edges import NearestFaceRule, WorldEdgeRule
from pb4u.network.mlp import SplitMLP
from pb4u.network.normaliser import Normaliser
from pb4u.network.update_scaling import UpdateScale
from pb4u.scene.packed import PackedGarments

ACCELERATION = Feature("acceleration", 3, "m/step^2", True, 3e-3, "x(t+1) - 2 x(t) + x(t-1), in displacement units")
MOST_PROPAGATION_STEPS = 500
"""Limit against mistyped numbers, far above the 31 that the rule gives at 38,000 triangles."""


MOST_COUNTED = 1024
"""Columns, blocks or layers that a network may have, eight times the largest published."""


class FurtherLoss(Protocol):
    """Loss that a method minimises in training besides the incremental potential, for the garments of one pack."""

    @property
    def name(self) -> str:
        """Name under which the loss is logged."""

    def energies(self, before: Tensor, after: Tensor, progress: float) -> Tensor:
        """Losses (garments,) [J] of a step, differentiable with respect to `after`.

        Args:
            before: (vertices, 3) positions before the step [m].
            after: (vertices, 3) positions after the step [m].
            progress: fraction of the training's budget that is spent.
        """


@dataclass(frozen=True, eq=False)
class Derived:
    """Data that a method derives once from the garments of a pack, beyond their meshes; none by default.

    Args:
        edges: undirected edges (edges, 2) int64 vertex indices within one garment, by kind, such as "coarse"; they have
            the columns of mesh edges and share their normaliser.
        finder: finds edges at every step, with the layout's `found_edge` columns.
        rest: tensors handed on in `Graph.rest`, by name.
        losses: losses that training minimises besides the incremental potential.
    """

    edges: Mapping[str, Tensor] = field(default_factory=dict)
    finder: EdgeFinder | None = None
    rest: Mapping[str, Tensor] = field(default_factory=dict)
    losses: tuple[FurtherLoss, ...] = ()


@dataclass(frozen=True, kw_only=True)
class NetworkConfiguration(ABC):
    """Configuration shared by all networks; each method adds its own fields.

    Args:
        width: number of columns of all latents and hidden layers.
        layout: the columns read.
        world_edges: rule for the body vertices that a garment vertex has edges to.
        pins: rule for the positions and velocities of pinned vertices that the network gets.
        passes: evaluations of the network in one time step, each adding to the accelerations of the previous one; 1 in
            the paper. Above 1 the layout should name "descent" and "advance".
        warm_start_shares: shares of the body's motion that a time step may start with; the one of least energy, or free
            flight, is used; none in the paper. With any the layout should name the same two.
        conjugate: combine each pass with the move of the previous one, with the step lengths of least potential; not in
            the paper.
        descent_size: RMS to which each garment's gradient feature is normalised, in edge lengths; accelerations are
            scaled back, so that a pass is as good near the minimum as far from it. 0 does not normalise it; the paper
            has no such feature.
        further_passes: largest number of evaluations beyond `passes`, each made only if the previous pass lowered the
            energy enough; for `conjugate` networks.

    Raises:
        InputError: less than 1 pass, further passes of a network that is not conjugate, a width below 1, a count below
            0 or above `MOST_COUNTED`, or a share that is not above 0 and up to 1.
    """

    width: int = 128
    layout: FeatureLayout = field(default_factory=FeatureLayout)
    world_edges: WorldEdgeRule | NearestFaceRule = field(default_factory=WorldEdgeRule)
    pins: PinsAtPresent | PinsAtTarget | PinsAtTargetInEdges = field(default_factory=PinsAtPresent)
    passes: int = 1
    warm_start_shares: tuple[float, ...] = ()
    conjugate: bool = False
    further_passes: int = 0
    descent_size: float = 0.0

    def __post_init__(self) -> None:
        if self.width < 1:
            raise InputError(f"network.width must be 1 or more, not {self.width}.")
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, int) and not 0 <= value <= MOST_COUNTED:
                raise InputError(f"network.{entry.name} must be from 0 to {MOST_COUNTED}, not {value}.")
        if self.passes < 1:
            raise InputError(f"A network needs at least 1 pass a step, not {self.passes}.")
        if self.further_passes and not self.conjugate:
            raise InputError(
                "further_passes needs conjugate passes: only their line search can tell whether another "
                "pass is worth its time."
            )
        if not 0.0 <= self.descent_size <= 1.0:
            raise InputError(f"network.descent_size must be from 0 to 1 edge lengths, not {self.descent_size}.")
        if not all(0.0 < share <= 1.0 for share in self.warm_start_shares):
            raise InputError(f"network.warm_start_shares must be above 0 and at most 1, not {self.warm_start_shares}.")

    @abstractmethod
    def network(self) -> GraphNetwork:
        """A network of this configuration with fresh weights."""


class GraphNetwork(nn.Module, ABC):
    """A network on normalised features; baselines differ from ours only in this class.

    Args:
        configuration: the columns read, the world edges and the number of passes in a step.

    Attributes:
        configuration: as given.
        propagates: whether it has propagation steps, whose number can be set.
    """

    propagates: ClassVar[bool] = False

    def __init__(self, configuration: NetworkConfiguration) -> None:
        super().__init__()
        self.configuration = configuration

    @abstractmethod
    def forward(self, graph: Graph, steps: Sequence[int]) -> Tensor:
        """Normalised accelerations (garment vertices, 3), dimensionless.

        Args:
            graph: with normalised features.
            steps: propagation steps of each garment.
        """

    def propagation_steps(self, mean_edge_length: float) -> int:
        """Number of propagation steps of a garment; 0 for a method without them.

        Args:
            mean_edge_length: mean rest edge length [m].
        """
        return 0

    def update_scale(self, garments: PackedGarments, graph: GarmentGraph) -> UpdateScale | None:
        """Factors on the accelerations, or None for 1.

        Args:
            garments: the pack.
            graph: its static graph.
        """
        return None

    def derive(self, garments: PackedGarments) -> Derived:
        """Data that the method needs of a pack beyond its meshes; called once a pack.

        Args:
            garments: the pack.
        """
        return Derived()


@dataclass(frozen=True, eq=False)
class PreparedGarments:
    """Data that a model derives once from garments and reuses every step.

    Args:
        builder: makes the graph of a step.
        steps: propagation steps of each garment.
        scale: factors on the accelerations, or None for 1.
        losses: losses that the method minimises in training besides the incremental potential.
        descent_size: RMS to which gradient features are normalised, in edge lengths; 0 does not normalise them.
    """

    builder: GraphBuilder
    steps: tuple[int, ...]
    scale: UpdateScale | None
    losses: tuple[FurtherLoss, ...] = ()
    descent_size: float = 0.0

    @property
    def graph(self) -> Callable[..., Graph]:
        """Function that makes the graph of a step; see `GraphBuilder.build`."""
        return self.builder.build

    def with_steps(self, steps: int | Sequence[int]) -> PreparedGarments:
        """Copy with other numbers of propagation steps; unchanged for a method without such steps.

        Args:
            steps: one number for all garments, or one for each.

        Raises:
            InputError: a number is not between 1 and 500.
        """
        if not any(self.steps):
            return self
        count = len(self.steps)
        chosen = (steps,) * count if isinstance(steps, int) else tuple(steps)
        for number in chosen:
            require_propagation_steps(number)
        return replace(self, steps=chosen)


def require_propagation_steps(number: int) -> None:
    """Refuse a number of propagation steps out of range.

    Args:
        number: the number K.

    Raises:
        InputError: it is not from 1 to 500.
    """
    if not 1 <= number <= MOST_PROPAGATION_STEPS:
        raise InputError(
            f"Propagation steps must lie between 1 and {MOST_PROPAGATION_STEPS}, not {number}; "
            "leave the option out to let the resolution decide."
        )


class AccelerationModel(nn.Module):
    """A network between its normalisers: acceleration x dt^2 from a graph of raw features.

    Called as `model(prepared.graph(state, collider, dt, origins), prepared)`.

    Args:
        network: maps normalised features to normalised accelerations.
    """

    def __init__(self, network: GraphNetwork) -> None:
        super().__init__()
        self.network = network
        layout = network.configuration.layout
        self.node_normaliser = Normaliser(layout.columns("node"))
        self.mesh_edge_normaliser = Normaliser(layout.columns("mesh_edge"))
        self.world_edge_normaliser = Normaliser(layout.columns("world_edge"))
        self.acceleration_normaliser = Normaliser((ACCELERATION,))
        # Absent where no edges are found, so that such a network's checkpoint holds nothing of them.
        self.found_edge_normaliser = Normaliser(layout.columns("found_edge")) if layout.found_edge else None

    def prepare(
        self,
        garments: PackedGarments,
        propagation_steps: int | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> PreparedGarments:
        """Data of `garments` that are the same at every step.

        Args:
            garments: on the device to compute on.
            propagation_steps: overrides the number that follows from the resolution.
            dtype: precision of features and accelerations.

        Raises:
            InputError: the override is not between 1 and 500.
        """
        network, configuration = self.network, self.network.configuration
        layout = configuration.layout
        derived = network.derive(garments)
        static = garment_graph(garments, layout.material_range, dtype, derived.edges)
        builder = GraphBuilder(
            static, layout, configuration.world_edges, derived.finder, derived.rest, configuration.pins
        )
        steps = tuple(network.propagation_steps(length) for length in garments.mean_edge_lengths)
        scale = network.update_scale(garments, static)
        prepared = PreparedGarments(builder, steps, scale, derived.losses, configuration.descent_size)
        return prepared if propagation_steps is None else prepared.with_steps(propagation_steps)

    def for_inference(self, precision: torch.dtype = torch.float32) -> AccelerationModel:
        """Copy that computes the same without gradients.

        Perceptrons over several parts, nine tenths of the products, hold their weights, and so multiply, in
        `precision`. Encoders, decoder, latents, norms, sums over nodes and accelerations keep float32: rounding the
        features alone to bfloat16 caused three quarters of the error.

        Args:
            precision: of the products, such as `torch.bfloat16`.
        """
        copied = copy.deepcopy(self)
        for module in copied.network.modules():
            if isinstance(module, SplitMLP):
                for layer in (module.first, module.second, module.last):
                    layer.to(precision)
        return copied

    def forward(self, graph: Graph, prepared: PreparedGarments) -> Tensor:
        """Acceleration x dt^2 (garment vertices, 3) [m per step^2].

        Args:
            graph: with raw features.
            prepared: the garments.
        """
        output = self.network(self.normalised(graph), prepared.steps).to(prepared.builder.dtype)
        acceleration = self.acceleration_normaliser.restore(output)
        return acceleration if prepared.scale is None else prepared.scale(acceleration)

    def normalised(self, graph: Graph) -> Graph:
        """Graph with centred and scaled features, in the precision of the network's weights or float32 at least.

        Args:
            graph: features of nodes and edges.
        """
        dtype = torch.promote_types(next(self.network.parameters()).dtype, torch.float32)
        nodes = {name: self.node_normaliser(node_set.features).to(dtype) for name, node_set in graph.nodes.items()}
        edges = {name: self._edge_normaliser(s)(s.features).to(dtype) for name, s in graph.edges.items()}
        return graph.with_features(nodes, edges)

    @torch.no_grad()
    def gather_statistics(self, graph: Graph, acceleration: Tensor) -> None:
        """Add a step to the statistics during warm-up; every world of the graph weighs the same.

        Args:
            graph: with raw features.
            acceleration: (garment vertices, 3) accelerations of skinning [m per step^2].

        Raises:
            RuntimeError: the statistics are frozen.
        """
        most = len(graph.vertex_offsets) - 1
        node_sets = list(graph.nodes.values())
        worlds = torch.cat([node_set.world for node_set in node_sets])
        self.node_normaliser.gather(torch.cat([s.features for s in node_sets]), worlds, most)
        for edge_set in graph.edges.values():
            edge_worlds = graph.nodes[edge_set.receiver_set].world[edge_set.receivers.index]
            if edge_set.receivers.spare:
                filled = edge_set.receivers.offsets[-2]
                edge_worlds[filled:] = most
            self._edge_normaliser(edge_set).gather(edge_set.features, edge_worlds, most)
        self.acceleration_normaliser.gather(acceleration, graph.nodes["garment"].world, most)

    def normalisers(self) -> tuple[Normaliser, ...]:
        """Normalisers of the model in a fixed order, so that their sums can be added over devices."""
        return (
            self.node_normaliser,
            self.mesh_edge_normaliser,
            self.world_edge_normaliser,
            self.acceleration_normaliser,
            *((self.found_edge_normaliser,) if self.found_edge_normaliser is not None else ()),
        )

    def freeze_statistics(self) -> None:
        """End warm-up: the normalisers keep their statistics from here on."""
        for normaliser in self.normalisers():
            normaliser.freeze()

    def _edge_normaliser(self, edges: EdgeSet) -> Normaliser:
        return getattr(self, f"{edges.columns}_normaliser")
