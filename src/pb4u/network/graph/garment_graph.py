"""The part of the graph that never changes during a simulation: a garment's mesh edges and rest-state features."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pb4u.network.graph.features import MaterialRange, map_linear, map_log
from pb4u.network.graph.graph import NodeType
from pb4u.network.graph.incidence import Incidence, both_directions
from pb4u.scene.packed import PackedGarments


@dataclass(frozen=True, eq=False)
class GarmentEdges:
    """Edges between garment vertices, both directions, in ascending order of receiver.

    Args:
        senders: vertex at the start of each directed edge.
        receivers: vertex at the end of each.
        rest_vector: (edges, 3) sender - receiver at rest [m].
        rest_length: (edges, 1) [m].
        inverse_rest_length: (edges, 1) [1/m].
        rest_direction: (edges, 3) unit vectors.
        material: (edges, 3) mean of both ends' bending, mu, lambda mapped to [0, 1].
    """

    senders: Incidence
    receivers: Incidence
    rest_vector: Tensor
    rest_length: Tensor
    inverse_rest_length: Tensor
    rest_direction: Tensor
    material: Tensor


@dataclass(frozen=True, eq=False)
class GarmentGraph:
    """Static nodes and edges of packed garments.

    Args:
        edges: edges by kind; "mesh" always, and kinds that a network adds, such as "coarse".
        node_types: (vertices,) int64 `NodeType`.
        node_owner: (vertices,) int64 garment.
        node_world: (vertices,) int64 world.
        areal_density: (vertices, 1) log areal density mapped to [0, 1].
        vertex_mass: (vertices, 1) log of the vertex mass [kg].
        mass: (vertices, 1) vertex mass [kg].
        node_material: (vertices, 3) bending, mu, lambda mapped to [0, 1].
        incident_length: (vertices,) mean rest length of the mesh edges at each vertex [m].
        mean_edge_lengths: mean rest edge length of each garment [m].
        vertex_offsets: first vertex of each garment, and the total.
        world_offsets: first vertex of each world, and the total.
        faces: (faces, 3) int64 vertex indices.
        world_rows: rows of all worlds side by side, as in `PackedGarments`.
    """

    edges: dict[str, GarmentEdges]
    node_types: Tensor
    node_owner: Tensor
    node_world: Tensor
    areal_density: Tensor
    vertex_mass: Tensor
    mass: Tensor
    node_material: Tensor
    incident_length: Tensor
    mean_edge_lengths: tuple[float, ...]
    vertex_offsets: tuple[int, ...]
    world_offsets: tuple[int, ...]
    faces: Tensor
    world_rows: tuple[Tensor, Tensor, Tensor]


def garment_graph(
    garments: PackedGarments,
    material_range: MaterialRange,
    dtype: torch.dtype = torch.float32,
    further_edges: Mapping[str, Tensor] | None = None,
) -> GarmentGraph:
    """Static graph of garments, on their device.

    Args:
        garments: the pack.
        material_range: ranges of material parameters that are mapped to [0, 1].
        dtype: data type of the floating arrays.
        further_edges: undirected edges (edges, 2) int64 vertex indices within one garment beyond its mesh, by name.
    """
    material = _vertex_material(garments, material_range)
    pairs = {"mesh": garments.edges, **(further_edges or {})}
    mass = garments.vertex_masses.to(torch.float64)
    density = _known_or_mean(mass / garments.vertex_areas.to(torch.float64), garments)
    return GarmentGraph(
        edges={name: _garment_edges(garments, edges, material, dtype) for name, edges in pairs.items()},
        node_types=torch.where(garments.pinned, int(NodeType.PINNED), int(NodeType.GARMENT)),
        node_owner=garments.vertex_garment,
        node_world=garments.vertex_world,
        areal_density=map_log(density, material_range.density, material_range.margin)[:, None].to(dtype),
        vertex_mass=_known_or_mean(mass.log(), garments)[:, None].to(dtype),
        mass=mass[:, None].to(dtype),
        node_material=material.to(dtype),
        incident_length=incident_lengths(garments).to(dtype),
        mean_edge_lengths=garments.mean_edge_lengths,
        vertex_offsets=garments.vertex_offsets,
        world_offsets=garments.world_offsets,
        faces=garments.faces,
        world_rows=garments.world_rows,
    )


def incident_lengths(garments: PackedGarments) -> Tensor:
    """Mean rest length (vertices,) float64 of the mesh edges at each vertex [m].

    Args:
        garments: the packed garments.
    """
    return _mean_at(garments.edges.reshape(-1), garments.edge_lengths.repeat_interleave(2), garments)


def _garment_edges(garments: PackedGarments, pairs: Tensor, material: Tensor, dtype: torch.dtype) -> GarmentEdges:
    senders, receivers = both_directions(pairs, garments.vertex_count)
    rest = garments.rest_positions.to(torch.float64)
    vector = rest[senders.index] - rest[receivers.index]
    length = vector.norm(dim=1, keepdim=True)
    inverse_length = 1.0 / length.clamp_min(torch.finfo(dtype).eps)
    return GarmentEdges(
        senders=senders,
        receivers=receivers,
        rest_vector=vector.to(dtype),
        rest_length=length.to(dtype),
        inverse_rest_length=inverse_length.to(dtype),
        rest_direction=(vector * inverse_length).to(dtype),
        material=(0.5 * (material[senders.index] + material[receivers.index])).to(dtype),
    )


def _vertex_material(garments: PackedGarments, limits: MaterialRange) -> Tensor:
    """(vertices, 3) float64 bending, mu, lambda: means over the elements at a vertex, mapped to [0, 1]."""
    corners = garments.faces.reshape(-1)
    mu = _mean_at(corners, garments.lame_mu.repeat_interleave(3), garments)
    lam = _mean_at(corners, garments.lame_lambda.repeat_interleave(3), garments)
    bending = _mean_at(garments.hinges[:, :2].reshape(-1), garments.bending.repeat_interleave(2), garments)
    return torch.stack(
        [
            map_log(bending, limits.bending, limits.margin),
            map_log(mu, limits.lame_mu, limits.margin),
            map_linear(lam, limits.lame_lambda, limits.margin),
        ],
        dim=1,
    )


def _mean_at(vertices: Tensor, values: Tensor, garments: PackedGarments) -> Tensor:
    """(vertices,) float64 mean of the `values` that name each vertex; the garment's mean where none does."""
    values = values.to(torch.float64)
    zeros = torch.zeros(garments.vertex_count, dtype=torch.float64, device=values.device)
    total = zeros.index_add(0, vertices, values)
    return _known_or_mean(total / zeros.index_add(0, vertices, torch.ones_like(values)), garments)


def _known_or_mean(values: Tensor, garments: PackedGarments) -> Tensor:
    """`values` (vertices,), what is not finite (an isolated vertex) replaced by the mean over its garment."""
    finite, owner, zeros = torch.isfinite(values), garments.vertex_garment, values.new_zeros(garments.garment_count)
    total = zeros.index_add(0, owner, torch.where(finite, values, 0.0))
    mean = total / zeros.index_add(0, owner, finite.to(values)).clamp_min(1.0)
    return torch.where(finite, values, mean[owner])
