"""From the state of garments and bodies to the graph of one time step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.geometry.triangle_mesh import vertex_normals
from pb4u.graph.features import FeatureLayout
from pb4u.graph.garment_graph import GarmentEdges, GarmentGraph, garment_graph
from pb4u.graph.graph import BODY, GARMENT, EdgeSet, Graph, NodeSet, NodeType, receiver_runs
from pb4u.graph.incidence import incidence
from pb4u.graph.world_edges import WorldEdgeRule, nearest_within
from pb4u.scene.packed import ColliderFrame, PackedGarments
from pb4u.scene.state import State

REFERENCE_DT = 1.0 / 30.0


class EdgeFinder(Protocol):
    """Finds edges between garment vertices anew at every step, such as those of cloth that comes near itself."""

    def find(self, positions: Tensor) -> Mapping[str, Tensor]:
        """Undirected edges (edges, 2) int64 between vertices of a garment at `positions` (vertices, 3) [m], by kind.

        Every kind is always there, without edges where none is found.
        """


class NoFoundEdges:
    """Finds nothing."""

    def find(self, positions: Tensor) -> Mapping[str, Tensor]:
        return {}


@dataclass(frozen=True, eq=False)
class GraphBuilder:
    """Makes the graph of each step; everything that does not change was computed when the builder was made.

    Args:
        static: mesh edges and rest-state features.
        layout: which columns to make.
        world_edges: which body vertices a garment vertex sees.
        fixed_shapes: keep absent world edges, masked, and all body vertices, so that shapes never change (a captured
            accelerator step); else only what is near.
        finder: edges that change from step to step.
        rest: handed on to every graph (`Graph.rest`).

    Raises InputError where shapes are to be fixed and a finder changes them.
    """

    static: GarmentGraph
    layout: FeatureLayout
    world_edges: WorldEdgeRule
    fixed_shapes: bool = False
    finder: EdgeFinder = field(default_factory=NoFoundEdges)
    rest: Mapping[str, Tensor] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.fixed_shapes and not isinstance(self.finder, NoFoundEdges):
            raise InputError("This network finds edges anew at every step; its graphs cannot have fixed shapes.")

    @property
    def dtype(self) -> torch.dtype:
        return self.static.incident_length.dtype

    def build(
        self,
        state: State,
        collider: ColliderFrame | None,
        dt: float,
        origin: Tensor | None = None,
        extra: Mapping[str, Tensor] | None = None,
    ) -> Graph:
        """The graph at `state`.

        Args:
            state: packed garments at time t.
            collider: bodies around t; None where there are none.
            dt: time step [s].
            origin: (3,) [m] subtracted from all positions before they are rounded to the graph's precision.
            extra: (vertices, width) node features that the layout names as `extra`.

        Raises InputError where an extra feature of the layout is absent or of another width.
        """
        positions = self._localise(state.positions, origin)
        step_dt = positions.new_full((1,), math.log(dt / REFERENCE_DT))
        nodes = {GARMENT: self._garment_nodes(state, positions, dt, step_dt, extra or {})}
        edges = {name: self._garment_edges(name, of, positions, step_dt) for name, of in self.static.edges.items()}
        for name, pairs in self.finder.find(positions).items():
            edges[name] = self._found_edges(name, pairs, positions, (state.velocities * dt).to(self.dtype), step_dt)
        if collider is not None:
            self._add_body(nodes, edges, collider, positions, state.velocities * dt, origin, step_dt)
        return Graph(nodes, edges, self.static.vertex_offsets, self.rest)

    def _localise(self, positions: Tensor, origin: Tensor | None) -> Tensor:
        return (positions if origin is None else positions - origin.to(positions)).to(self.dtype)

    def _garment_nodes(
        self, state: State, positions: Tensor, dt: float, step_dt: Tensor, extra: Mapping[str, Tensor]
    ) -> NodeSet:
        static = self.static
        columns = {
            "velocity": (state.velocities * dt).to(self.dtype),
            "normal": vertex_normals(positions, static.faces),
            "dt": step_dt.expand(len(positions), 1),
            "areal_density": static.areal_density,
            "vertex_mass": static.vertex_mass,
            "material": static.node_material,
        }
        chosen = [columns[name] for name in self.layout.node]
        for feature in self.layout.extra:
            given = extra.get(feature.name)
            if given is None or given.shape != (len(positions), feature.width):
                raise InputError(
                    f"The network needs the extra node feature {feature.name!r} with {feature.width} columns for "
                    f"{len(positions)} vertices; it got {'nothing' if given is None else tuple(given.shape)}."
                )
            chosen.append(given.to(self.dtype))
        return NodeSet(torch.cat(chosen, dim=1), static.node_types, static.node_owner)

    def _garment_edges(self, kind: str, edges: GarmentEdges, positions: Tensor, step_dt: Tensor) -> EdgeSet:
        vector = positions.index_select(0, edges.senders.index) - positions.index_select(0, edges.receivers.index)
        length = vector.norm(dim=1, keepdim=True)
        columns = {
            "direction": vector / length.clamp_min(torch.finfo(self.dtype).eps),
            "rest_direction": edges.rest_direction,
            "length_ratio": length * edges.inverse_rest_length,
            "dt": step_dt.expand(len(vector), 1),
            "material": edges.material,
            "relative_position": vector,
            "length": length,
            "rest_relative_position": edges.rest_vector,
            "rest_length": edges.rest_length,
        }
        features = torch.cat([columns[name] for name in self.layout.mesh_edge], dim=1)
        return EdgeSet(kind, GARMENT, GARMENT, edges.senders, edges.receivers, features, runs=edges.runs)

    def _found_edges(self, kind: str, pairs: Tensor, positions: Tensor, velocities: Tensor, step_dt: Tensor) -> EdgeSet:
        count, material = len(positions), self.static.node_material
        both = torch.cat([pairs, pairs.flip(1)])
        both = both[torch.argsort(both[:, 1] * count + both[:, 0])]
        sender, receiver = both[:, 0].contiguous(), both[:, 1].contiguous()
        vector = positions.index_select(0, sender) - positions.index_select(0, receiver)
        velocity = velocities.index_select(0, sender) - velocities.index_select(0, receiver)
        columns = {
            "relative_position": vector,
            "length": vector.norm(dim=1, keepdim=True),
            "previous_relative_position": vector - velocity,
            "previous_length": (vector - velocity).norm(dim=1, keepdim=True),
            "relative_velocity": velocity,
            "relative_speed": velocity.norm(dim=1, keepdim=True),
            "dt": step_dt.expand(len(both), 1),
            "material": 0.5 * (material.index_select(0, sender) + material.index_select(0, receiver)),
        }
        features = torch.cat([columns[name] for name in self.layout.found_edge], dim=1)
        receivers = incidence(receiver, count)
        return EdgeSet(
            kind,
            GARMENT,
            GARMENT,
            incidence(sender, count),
            receivers,
            features,
            runs=receiver_runs(receivers.offsets),
            columns="found_edge",
        )

    def _add_body(
        self,
        nodes: dict[str, NodeSet],
        edges: dict[str, EdgeSet],
        collider: ColliderFrame,
        positions: Tensor,
        velocities: Tensor,
        origin: Tensor | None,
        step_dt: Tensor,
    ) -> None:
        now = self._localise(collider.now.positions, origin)
        following = self._localise(collider.following.positions, origin)
        near, found = self._nearest(positions, now, collider)
        garment = torch.arange(len(positions), device=near.device).repeat_interleave(near.shape[1])
        body, mask = near.reshape(-1), found.reshape(-1)
        if self.fixed_shapes:
            # Absent edges are spread over the body: heaped on one vertex they would be one long sum.
            body = torch.where(mask, body, torch.arange(len(body), device=body.device) % max(len(now), 1))
        else:
            garment, body, mask = garment[mask], body[mask], mask[mask]
        kept, body_node = self._kept_body_vertices(body, len(now))
        if len(kept) == 0 or len(body) == 0:
            return

        active = _any_at(body_node, mask, len(kept)) if self.fixed_shapes else None
        nodes[BODY] = self._body_nodes(collider, now, kept, step_dt, active)

        relative_now = positions.index_select(0, garment) - now.index_select(0, body)
        relative_next = positions.index_select(0, garment) - following.index_select(0, body)
        approach = velocities.to(self.dtype).index_select(0, garment) - (following - now).index_select(0, body)
        edge_mask = mask[:, None].to(self.dtype) if self.fixed_shapes else None
        to_garment = incidence(garment, len(positions))
        from_body = incidence(body_node, len(kept))
        features = self._world_features(relative_now, relative_next, approach, step_dt)
        edges["body_to_garment"] = EdgeSet(
            "world",
            BODY,
            GARMENT,
            from_body,
            to_garment,
            features,
            edge_mask,
            receiver_runs(to_garment.offsets),
            "world_edge",
        )
        order = from_body.order
        to_body = incidence(body_node[order], len(kept))
        edges["garment_to_body"] = EdgeSet(
            "world",
            GARMENT,
            BODY,
            incidence(garment[order], len(positions)),
            to_body,
            self._world_features(-relative_now[order], -relative_next[order], -approach[order], step_dt),
            None if edge_mask is None else edge_mask[order],
            receiver_runs(to_body.offsets),
            "world_edge",
        )

    def _body_nodes(
        self, collider: ColliderFrame, now: Tensor, kept: Tensor, step_dt: Tensor, active: Tensor | None
    ) -> NodeSet:
        velocity = (collider.now.positions - collider.previous.positions).to(self.dtype)[kept]
        absent = velocity.new_full((1,), -1.0)
        columns = {
            "velocity": velocity,
            "normal": vertex_normals(now, collider.colliders.faces)[kept],
            "dt": step_dt.expand(len(kept), 1),
            "areal_density": absent.expand(len(kept), 1),
            "vertex_mass": absent.expand(len(kept), 1),
            "material": absent.expand(len(kept), 3),
        }
        chosen = [columns[name] for name in self.layout.node]
        chosen += [velocity.new_zeros(len(kept), feature.width) for feature in self.layout.extra]
        types = torch.full((len(kept),), int(NodeType.BODY), device=kept.device)
        return NodeSet(torch.cat(chosen, dim=1), types, collider.colliders.vertex_world[kept], active)

    def _nearest(self, positions: Tensor, body: Tensor, collider: ColliderFrame) -> tuple[Tensor, Tensor]:
        """Packed body vertices (vertices, neighbours) near each garment vertex, of its own body and in contact only."""
        near, found = [], []
        offsets = self.static.world_offsets
        for world, allowed in enumerate(collider.colliders.touchable):
            points = positions[offsets[world] : offsets[world + 1]]
            index, exists = nearest_within(points, body[allowed], self.world_edges)
            near.append(allowed[index] if len(allowed) else index)
            found.append(exists)
        return torch.cat(near), torch.cat(found)

    def _kept_body_vertices(self, body: Tensor, count: int) -> tuple[Tensor, Tensor]:
        if self.fixed_shapes:
            return torch.arange(count, device=body.device), body
        kept, position = torch.unique(body, return_inverse=True)
        return kept, position

    def _world_features(self, relative_now: Tensor, relative_next: Tensor, approach: Tensor, step_dt: Tensor) -> Tensor:
        columns = {
            "relative_now": relative_now,
            "distance_now": relative_now.norm(dim=1, keepdim=True),
            "relative_next": relative_next,
            "distance_next": relative_next.norm(dim=1, keepdim=True),
            "relative_velocity": approach,
            "relative_speed": approach.norm(dim=1, keepdim=True),
            "dt": step_dt.expand(len(relative_now), 1),
        }
        return torch.cat([columns[name] for name in self.layout.world_edge], dim=1)


def _any_at(index: Tensor, mask: Tensor, count: int) -> Tensor:
    """(count,) bool, whether any row of `index` whose `mask` is set names the entry."""
    votes = torch.zeros(count, dtype=torch.int64, device=index.device)
    return votes.index_add(0, index, mask.to(torch.int64)) > 0


def graph_builder(
    garments: PackedGarments,
    layout: FeatureLayout,
    world_edges: WorldEdgeRule,
    dtype: torch.dtype = torch.float32,
    fixed_shapes: bool = False,
    further_edges: Mapping[str, Tensor] | None = None,
    finder: EdgeFinder | None = None,
    rest: Mapping[str, Tensor] | None = None,
) -> GraphBuilder:
    """A builder for `garments`, on their device, making features in `dtype`; `further_edges` as in `garment_graph`.

    Raises InputError where shapes are to be fixed and a finder changes them.
    """
    static = garment_graph(garments, layout.material_range, dtype, further_edges)
    return GraphBuilder(
        static, layout, world_edges, fixed_shapes, finder=finder or NoFoundEdges(), rest=dict(rest or {})
    )
