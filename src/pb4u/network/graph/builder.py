"""Builds the graph of one time step from the state of garments and bodies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol, TypeAlias

import torch
from torch import Tensor

from pb4u.collision.capacities import found_rows
from pb4u.errors import InputError
from pb4u.network.graph.features import FeatureLayout
from pb4u.network.graph.garment_graph import GarmentEdges, GarmentGraph
from pb4u.network.graph.graph import BODY, GARMENT, EdgeSet, Graph, NodeSet, NodeType
from pb4u.network.graph.incidence import Incidence, both_directions, incidence
from pb4u.network.graph.normals import feature_normals
from pb4u.network.graph.pins import PinRule, PinsAtPresent, SeenGarments
from pb4u.network.graph.world_edges import NearestFaceRule, WorldEdgeRule
from pb4u.scene.colliders import ColliderFrame, PackedColliders
from pb4u.scene.state import State

REFERENCE_DT = 1.0 / 30.0
"""Time step [s] whose feature "dt" is 0: that of the training motions."""


Columns: TypeAlias = Mapping[str, Tensor]


@dataclass(frozen=True, eq=False)
class FoundEdges:
    """Directed edges of one kind between garment vertices, in ascending order of receiver.

    Args:
        senders: vertex at the start of each edge.
        receivers: vertex at the end of each.
        future: (edges, 1) 1 for edges between future positions of vertices, else 0 [1]; None if all use present
            positions.
    """

    senders: Incidence
    receivers: Incidence
    future: Tensor | None = None

    @classmethod
    def both_ways(cls, pairs: Tensor, vertex_count: int) -> FoundEdges:
        """Undirected edges `pairs` (edges, 2) int64 between `vertex_count` vertices, in both directions.

        Args:
            pairs: (edges, 2) int64.
            vertex_count: number of vertices.
        """
        return cls(*both_directions(pairs, vertex_count))


class EdgeFinder(Protocol):
    """Finds edges between garment vertices at every step, such as between parts of cloth that are near each other."""

    def found(self, seen: SeenGarments) -> Mapping[str, FoundEdges]:
        """Edges by kind; empty kinds are named as well.

        Args:
            seen: garments at the start of the step.
        """


@dataclass(frozen=True, eq=False)
class GraphBuilder:
    """Makes the graph of each step; its constant parts are computed once, when the builder is made.

    Args:
        static: mesh edges and rest-state features.
        layout: columns to make.
        world_edges: rule for the body vertices that a garment vertex has edges to.
        finder: finds the edges that change from step to step; None where none do.
        rest: tensors handed on to every graph (`Graph.rest`), by name.
        pins: rule for the positions and velocities of pinned vertices that the network gets.
    """

    static: GarmentGraph
    layout: FeatureLayout
    world_edges: WorldEdgeRule | NearestFaceRule
    finder: EdgeFinder | None = None
    rest: Mapping[str, Tensor] = field(default_factory=dict)
    pins: PinRule = field(default_factory=PinsAtPresent)

    @property
    def dtype(self) -> torch.dtype:
        """Data type of the features."""
        return self.static.incident_length.dtype

    def build(
        self,
        state: State,
        collider: ColliderFrame,
        dt: float,
        origins: Tensor | None = None,
        extra: Mapping[str, Tensor] | None = None,
        pin_positions: Tensor | None = None,
    ) -> Graph:
        """Graph of the time step that leaves `state`.

        Args:
            state: packed garments at time t.
            collider: bodies around t, if any.
            dt: time step [s].
            origins: (worlds, 3) subtracted from the positions of each world before they are rounded to the graph's
                precision [m].
            extra: (vertices, width) node features that the layout names as `extra`, each in the unit of its `Feature`.
            pin_positions: (vertices, 3) where pinned vertices will be after the step [m], or None if unknown; other
                rows are not read.

        Raises:
            InputError: an extra feature of the layout is absent or of another width.
        """
        origin = None if origins is None else origins[self.static.node_world]
        positions = self._localise(state.positions, origin)
        velocities = (state.velocities * dt).to(self.dtype)
        seen = self._seen(positions, velocities, pin_positions, origin)
        positions, velocities = seen.positions, seen.velocities
        duration = {
            "dt": positions.new_full((1,), math.log(dt / REFERENCE_DT)),
            "time_step": positions.new_full((1,), dt),
        }
        nodes = {GARMENT: self._garment_nodes(positions, velocities, duration, extra or {})}
        edges = {
            name: self._garment_edges(name, of, seen.edge_positions, duration) for name, of in self.static.edges.items()
        }
        for name, pairs in ({} if self.finder is None else self.finder.found(seen)).items():
            edges[name] = self._found_edges(name, pairs, positions, velocities, duration)
        self._add_body(nodes, edges, collider, positions, velocities, origins, duration)
        return Graph(nodes, edges, self.static.vertex_offsets, self.rest)

    def _localise(self, positions: Tensor, origin: Tensor | None) -> Tensor:
        return (positions if origin is None else positions - origin.to(positions)).to(self.dtype)

    def _seen(
        self, positions: Tensor, velocities: Tensor, targets: Tensor | None, origin: Tensor | None
    ) -> SeenGarments:
        if targets is None:
            nobody = torch.zeros(len(positions), 1, dtype=torch.bool, device=positions.device)
            return PinsAtPresent().seen(positions, velocities, nobody, positions)
        pinned = (self.static.node_types == int(NodeType.PINNED))[:, None]
        return self.pins.seen(positions, velocities, pinned, self._localise(targets, origin))

    def _garment_nodes(
        self, positions: Tensor, velocities: Tensor, duration: Columns, extra: Mapping[str, Tensor]
    ) -> NodeSet:
        static = self.static
        columns = {
            "velocity": velocities,
            "velocity_ahead": velocities,
            "normal": feature_normals(positions, static.faces),
            "areal_density": static.areal_density,
            "vertex_mass": static.vertex_mass,
            "mass": static.mass,
            "material": static.node_material,
        }
        chosen = _chosen(self.layout.node, columns, duration)
        for feature in self.layout.extra:
            values = extra.get(feature.name)
            if values is None or values.shape != (len(positions), feature.width):
                raise InputError(
                    f"The network needs the extra node feature {feature.name!r} with {feature.width} columns for "
                    f"{len(positions)} vertices; it got {'nothing' if values is None else tuple(values.shape)}."
                )
            chosen.append(values.to(self.dtype))
        return NodeSet(torch.cat(chosen, dim=1), static.node_types, static.node_world)

    def _garment_edges(self, kind: str, edges: GarmentEdges, positions: Tensor, duration: Columns) -> EdgeSet:
        vector = positions.index_select(0, edges.senders.index) - positions.index_select(0, edges.receivers.index)
        length = vector.norm(dim=1, keepdim=True)
        columns = {
            "direction": vector / length.clamp_min(torch.finfo(self.dtype).eps),
            "rest_direction": edges.rest_direction,
            "length_ratio": length * edges.inverse_rest_length,
            "material": edges.material,
            "relative_position": vector,
            "length": length,
            "rest_relative_position": edges.rest_vector,
            "rest_length": edges.rest_length,
        }
        features = torch.cat(_chosen(self.layout.mesh_edge, columns, duration), dim=1)
        return EdgeSet(kind, GARMENT, GARMENT, edges.senders, edges.receivers, features)

    def _found_edges(
        self, kind: str, pairs: FoundEdges, positions: Tensor, velocities: Tensor, duration: Columns
    ) -> EdgeSet:
        senders, receivers = pairs.senders, pairs.receivers
        sender, receiver, material = senders.index, receivers.index, self.static.node_material
        vector = positions.index_select(0, sender) - positions.index_select(0, receiver)
        velocity = velocities.index_select(0, sender) - velocities.index_select(0, receiver)
        columns = {
            "relative_position": vector,
            "length": vector.norm(dim=1, keepdim=True),
            "previous_relative_position": vector - velocity,
            "previous_length": (vector - velocity).norm(dim=1, keepdim=True),
            "relative_velocity": velocity,
            "relative_speed": velocity.norm(dim=1, keepdim=True),
            "future_pinned": vector.new_zeros(len(vector), 1) if pairs.future is None else pairs.future,
            "material": 0.5 * (material.index_select(0, sender) + material.index_select(0, receiver)),
        }
        features = torch.cat(_chosen(self.layout.found_edge, columns, duration), dim=1)
        return EdgeSet(kind, GARMENT, GARMENT, senders, receivers, features, "found_edge")

    def _add_body(
        self,
        nodes: dict[str, NodeSet],
        edges: dict[str, EdgeSet],
        collider: ColliderFrame,
        positions: Tensor,
        velocities: Tensor,
        origins: Tensor | None,
        duration: Columns,
    ) -> None:
        """Add the body vertices that a garment vertex sees, and the edges between them, where there are any."""
        origin = None if origins is None else origins[collider.colliders.vertex_world]
        now = self._localise(collider.now.positions, origin)
        capacities = collider.colliders.capacities
        garment, body, filled = self._near_pairs(positions, now, collider.colliders)
        if len(body) == 0:
            return
        if capacities is None:
            used, body_node = torch.unique(body, return_inverse=True)
        else:
            near = torch.zeros(len(now) + 1, dtype=torch.bool, device=body.device)
            near = near.index_fill(0, torch.where(filled, body, len(now)), True)[:-1]
            used, filled_nodes = found_rows(near, "body nodes", capacities)
            body_node = (near.cumsum(0)[body] - 1).clamp(0, len(used) - 1)
        before, here, after = (pose.positions[used] for pose in (collider.previous, collider.now, collider.following))
        velocity, ahead = (here - before).to(self.dtype), (after - here).to(self.dtype)
        normal = feature_normals(now, collider.colliders.faces)[used]
        world = collider.colliders.vertex_world[used]
        if capacities is not None:
            # What is only room is of no world.
            world = torch.where(filled_nodes, world, len(self.static.vertex_offsets) - 1)
        nodes[BODY] = self._body_nodes(velocity, ahead, normal, duration, world)

        now, following = now[used], self._localise(after, None if origin is None else origin[used])
        relative_now = positions.index_select(0, garment) - now.index_select(0, body_node)
        relative_next = positions.index_select(0, garment) - following.index_select(0, body_node)
        approach = velocities.index_select(0, garment) - (following - now).index_select(0, body_node)
        real = None if capacities is None else filled
        garments, bodies = incidence(garment, len(positions), real), incidence(body_node, len(used), real)
        features = self._world_features(relative_now, relative_next, approach, duration)
        edges["body_to_garment"] = EdgeSet("world", BODY, GARMENT, bodies, garments, features, "world_edge")
        order = bodies.order
        real = None if capacities is None else filled[order]
        garments, bodies = (
            incidence(garment[order], len(positions), real),
            incidence(body_node[order], len(used), real),
        )
        features = self._world_features(-relative_now[order], -relative_next[order], -approach[order], duration)
        edges["garment_to_body"] = EdgeSet("world", GARMENT, BODY, garments, bodies, features, "world_edge")

    def _body_nodes(
        self, velocity: Tensor, velocity_ahead: Tensor, normal: Tensor, duration: Columns, world: Tensor
    ) -> NodeSet:
        count, absent = len(velocity), velocity.new_full((1,), -1.0)
        columns = {
            "velocity": velocity,
            "velocity_ahead": velocity_ahead,
            "normal": normal,
            "areal_density": absent.expand(count, 1),
            "vertex_mass": absent.expand(count, 1),
            "mass": absent.expand(count, 1),
            "material": absent.expand(count, 3),
        }
        chosen = _chosen(self.layout.node, columns, duration)
        chosen += [velocity.new_zeros(count, feature.width) for feature in self.layout.extra]
        types = torch.full((count,), int(NodeType.BODY), device=velocity.device)
        return NodeSet(torch.cat(chosen, dim=1), types, world)

    def _near_pairs(self, positions: Tensor, body: Tensor, colliders: PackedColliders) -> tuple[Tensor, Tensor, Tensor]:
        """Garment vertex and body vertex, (pairs,) int64 each, of all pairs that the rule joins, world by world.

        And which of them are filled (pairs,) bool: all but those that are only room.
        """
        rule = self.world_edges
        batched = colliders.capacities is not None and isinstance(rule, WorldEdgeRule) and not rule.whole_body
        if batched and (groups := colliders.vertex_groups(body)) is not None:
            assert isinstance(rule, WorldEdgeRule)
            places, filled, _ = self.static.world_rows
            points = torch.where(filled[..., None], positions[places], torch.nan)
            row, near, real = rule.batched_pairs(points, body, groups, colliders.capacities)
            return places.reshape(-1)[row], near, real
        garment, targets = [], []
        offsets = self.static.world_offsets
        for world, (start, stop) in enumerate(list(pairwise(offsets))[: len(colliders.surfaces)]):
            rows, near = rule.pairs(positions[start:stop], body, colliders, world)
            allowed = colliders.contact[near]
            garment.append(rows[allowed] + start)
            targets.append(near[allowed])
        pairs = torch.cat(targets)
        return torch.cat(garment), pairs, torch.ones_like(pairs, dtype=torch.bool)

    def _world_features(
        self, relative_now: Tensor, relative_next: Tensor, approach: Tensor, duration: Columns
    ) -> Tensor:
        distance_now = relative_now.norm(dim=1, keepdim=True)
        columns = {
            "direction": -relative_now / distance_now.clamp_min(torch.finfo(self.dtype).eps),
            "relative_distance": distance_now / self.world_edges.radius,
            "relative_now": relative_now,
            "distance_now": distance_now,
            "relative_next": relative_next,
            "distance_next": relative_next.norm(dim=1, keepdim=True),
            "relative_velocity": approach,
            "relative_speed": approach.norm(dim=1, keepdim=True),
        }
        return torch.cat(_chosen(self.layout.world_edge, columns, duration), dim=1)


def _chosen(names: Sequence[str], columns: Columns, duration: Columns) -> list[Tensor]:
    """Columns (rows, width) of the given names, in order; those of `duration` are the same in every row."""
    rows = len(next(iter(columns.values())))
    return [columns[name] if name in columns else duration[name].expand(rows, 1) for name in names]
