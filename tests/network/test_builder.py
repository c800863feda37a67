"""The graph holds what its feature table promises."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.network_scenes import COTTON, DT, Moment, moment, placed, sheet

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.geometry.triangle_mesh import vertex_normals
from pb4u.network.graph.builder import GraphBuilder
from pb4u.network.graph.features import (
    MESH_EDGE_FEATURES,
    NODE_FEATURES,
    WORLD_EDGE_FEATURES,
    Feature,
    FeatureLayout,
    total_width,
)
from pb4u.network.graph.garment_graph import garment_graph
from pb4u.network.graph.graph import NodeType
from pb4u.network.graph.world_edges import WorldEdgeRule
from pb4u.network.registry import NETWORKS
from pb4u.scene.packed import pack


def built(at, layout=None, rule=None, **options):
    build_options = {key: options.pop(key) for key in ("origin", "extra") if key in options}
    dt = options.pop("dt", DT)
    layout = layout or FeatureLayout()
    builder = builder_of(at.garments, layout, rule or WorldEdgeRule(), **options)
    return builder.build(at.state, at.collider, dt, **build_options)


def builder_of(packed, layout, rule, further_edges=None):
    return GraphBuilder(garment_graph(packed, layout.material_range, torch.float64, further_edges), layout, rule)


def columns(features, layout_columns):
    """Features of a set by name."""
    parts = torch.split(features, [c.width for c in layout_columns], dim=1)
    return dict(zip([c.name for c in layout_columns], parts, strict=True))


def test_the_paper_layout_has_11_9_and_with_the_type_20_columns():
    layout = FeatureLayout()
    assert total_width(layout.columns("node")) + 9 == 20
    assert total_width(layout.columns("mesh_edge")) == 11
    assert total_width(layout.columns("world_edge")) == 9
    bare = FeatureLayout(mesh_edge=("direction", "rest_direction", "length_ratio"))
    assert total_width(bare.columns("mesh_edge")) == 7


def test_every_feature_of_the_tables_can_be_made_in_its_width():
    layout = FeatureLayout(tuple(NODE_FEATURES), tuple(MESH_EDGE_FEATURES), tuple(WORLD_EDGE_FEATURES))
    graph = built(moment([sheet(6, 7)]), layout)
    for node_set in graph.nodes.values():
        assert node_set.features.shape[1] == total_width(layout.columns("node"))
    assert graph.edges["mesh"].features.shape[1] == total_width(layout.columns("mesh_edge"))
    assert graph.edges["body_to_garment"].features.shape[1] == total_width(layout.columns("world_edge"))
    for table in (NODE_FEATURES, MESH_EDGE_FEATURES, WORLD_EDGE_FEATURES):
        assert all(feature.unit and feature.source and feature.typical > 0 for feature in table.values())


def test_node_features_are_what_they_say():
    at = moment([sheet(6, 7)])
    layout = FeatureLayout(node=tuple(NODE_FEATURES))
    graph = built(at, layout, dt=0.1)
    garment = columns(graph.nodes["garment"].features, layout.columns("node"))
    torch.testing.assert_close(garment["velocity"], at.state.velocities * 0.1)
    torch.testing.assert_close(garment["normal"], vertex_normals(at.state.positions, at.garments.faces))
    torch.testing.assert_close(garment["dt"], torch.full((42, 1), 3.0, dtype=torch.float64).log())
    torch.testing.assert_close(garment["vertex_mass"][:, 0], at.garments.vertex_masses.log())
    density = torch.tensor(COTTON.density / 0.0434, dtype=torch.float64).log() / torch.tensor(0.7 / 0.0434).log()
    torch.testing.assert_close(garment["areal_density"], density.expand(42, 1), rtol=1e-5, atol=0)
    body = columns(graph.nodes["body"].features, layout.columns("node"))
    for name in ("areal_density", "vertex_mass", "material"):
        assert bool((body[name] == -1).all())
    assert set(graph.nodes["body"].types.tolist()) == {NodeType.BODY}
    moves = at.collider.now.positions - at.collider.previous.positions
    assert all((moves - row).abs().sum(dim=1).min() == 0 for row in body["velocity"])


@pytest.mark.parametrize("position", [0, 1, 2])
def test_materials_run_from_0_to_1_over_the_training_range(position):
    name = ("bending", "lame_mu", "lame_lambda")[position]
    limits = getattr(FeatureLayout().material_range, name)
    for value, expected in ((limits[0], 0.0), (limits[1], 1.0)):
        at = moment([sheet(5, 5, material=Material.isotropic(**COTTON.five_numbers | {name: value}))])
        layout = FeatureLayout()
        for features, made in (
            (built(at).nodes["garment"].features, layout.columns("node")),
            (built(at).edges["mesh"].features, layout.columns("mesh_edge")),
        ):
            mapped = columns(features, made)["material"][:, position]
            torch.testing.assert_close(mapped, torch.full_like(mapped, expected), atol=1e-9, rtol=0)


def test_a_material_of_no_bending_at_all_still_gives_finite_features():
    graph = built(moment([sheet(5, 5, material=Material.isotropic(0.2, 23600.0, 0.0, 0.0))]))
    assert bool(torch.isfinite(graph.nodes["garment"].features).all())


def test_an_isolated_vertex_gets_finite_features_and_the_mean_scale():
    garment = sheet(5, 5)
    vertices = torch.cat([torch.as_tensor(garment.vertices), torch.tensor([[5.0, 5.0, 5.0]])]).numpy()
    packed = pack([Garment("sheet", vertices, garment.faces, garment.material)])
    builder = builder_of(packed, FeatureLayout(node=tuple(NODE_FEATURES)), WorldEdgeRule())
    for part in ("areal_density", "vertex_mass", "node_material", "incident_length"):
        assert bool(torch.isfinite(getattr(builder.static, part)).all()), part
    torch.testing.assert_close(builder.static.incident_length[-1], builder.static.incident_length[:-1].mean())


def test_mesh_edges_run_both_ways_and_ascend_by_receiver():
    at = moment([sheet(5, 6), sheet(4, 4)])
    mesh = built(at).edges["mesh"]
    pairs = set(zip(mesh.senders.index.tolist(), mesh.receivers.index.tolist(), strict=True))
    expected = {tuple(pair) for pair in at.garments.edges.tolist()}
    assert pairs == expected | {(b, a) for a, b in expected}
    assert bool((mesh.receivers.index.diff() >= 0).all())


def test_mesh_edge_features_are_what_they_say():
    at = moment([sheet(5, 6)])
    layout = FeatureLayout(mesh_edge=tuple(MESH_EDGE_FEATURES))
    mesh = built(at, layout).edges["mesh"]
    made = columns(mesh.features, layout.columns("mesh_edge"))
    s, r = mesh.senders.index, mesh.receivers.index
    now, rest = (x[s] - x[r] for x in (at.state.positions, at.garments.rest_positions))
    torch.testing.assert_close(made["relative_position"], now)
    torch.testing.assert_close(made["rest_relative_position"], rest)
    torch.testing.assert_close(made["direction"] * made["length"], now)
    torch.testing.assert_close(made["rest_direction"] * made["rest_length"], rest)
    torch.testing.assert_close(made["length_ratio"], now.norm(dim=1, keepdim=True) / rest.norm(dim=1, keepdim=True))


@pytest.mark.parametrize("neighbours", [1, 4])
def test_world_edges_join_the_nearest_body_vertices_in_reach_and_run_both_ways(neighbours):
    at = moment([sheet(6, 8), sheet(5, 5, edge=0.02)])
    layout = FeatureLayout()
    graph = built(at, rule=WorldEdgeRule(0.03, neighbours))
    before, now, following = (pose.positions for pose in (at.collider.previous, at.collider.now, at.collider.following))
    distance = torch.cdist(at.state.positions, now)
    distance[at.garments.vertex_world[:, None] != at.collider.colliders.vertex_world[None]] = torch.inf
    expected = set()
    for vertex, row in enumerate(distance):
        for target in row.argsort()[:neighbours].tolist():
            if row[target] <= 0.03:
                expected.add((vertex, target))
    assert expected
    body_vertex = {tuple(row): i for i, row in enumerate((now - before).tolist())}
    of_node = [body_vertex[tuple(row)] for row in graph.nodes["body"].features[:, :3].tolist()]
    into, back = graph.edges["body_to_garment"], graph.edges["garment_to_body"]
    assert {
        (g, of_node[b]) for b, g in zip(into.senders.index.tolist(), into.receivers.index.tolist(), strict=True)
    } == expected
    assert {
        (g, of_node[b]) for g, b in zip(back.senders.index.tolist(), back.receivers.index.tolist(), strict=True)
    } == expected
    for edges, sign in ((into, 1.0), (back, -1.0)):
        assert bool((edges.receivers.index.diff() >= 0).all())
        garment = edges.receivers.index if edges is into else edges.senders.index
        nodes = edges.senders.index if edges is into else edges.receivers.index
        vertex = torch.tensor(of_node)[nodes]
        made = columns(edges.features, layout.columns("world_edge"))
        torch.testing.assert_close(made["relative_now"], sign * (at.state.positions[garment] - now[vertex]))
        torch.testing.assert_close(made["relative_next"], sign * (at.state.positions[garment] - following[vertex]))
        torch.testing.assert_close(made["distance_now"], made["relative_now"].norm(dim=1, keepdim=True))


def test_body_vertices_out_of_contact_have_no_edges():
    at = moment([sheet(6, 8)])
    near = built(at).edges["body_to_garment"].edge_count
    bodies = at.collider.colliders
    none = placed(at.collider, bodies=replace(bodies, contact=torch.zeros_like(bodies.contact)))
    assert near > 0
    assert set(built(replace(at, collider=none)).edges) == {"mesh"}


def test_an_extra_feature_arrives_by_name():
    at = moment([sheet(5, 6)])
    layout = FeatureLayout(extra=(Feature("potential_gradient", 3, "m", True, 1e-3, "of the incremental potential"),))
    given = torch.randn(30, 3, dtype=torch.float64)
    graph = built(at, layout, extra={"potential_gradient": given})
    torch.testing.assert_close(graph.nodes["garment"].features[:, -3:], given)
    assert bool((graph.nodes["body"].features[:, -3:] == 0).all())
    for wrong in (None, {}, {"potential_gradient": given[:, :2]}):
        with pytest.raises(InputError, match=r"'potential_gradient' with 3 .*30 vertices"):
            built(at, layout, extra=wrong)


def test_an_unknown_feature_and_a_senseless_world_edge_rule_are_refused():
    with pytest.raises(InputError, match=r"'smell'.*direction"):
        FeatureLayout(world_edge=("smell",))
    for radius, neighbours in ((0.0, 1), (float("nan"), 1), (0.03, 0), (0.03, 1000)):
        with pytest.raises(InputError, match="World edges need"):
            WorldEdgeRule(radius, neighbours)


def test_edges_that_a_network_adds_carry_the_columns_of_mesh_edges():
    at = moment([sheet(5, 6)])
    pairs = torch.tensor([[0, 12], [3, 29]])
    builder = builder_of(at.garments, FeatureLayout(), WorldEdgeRule(), further_edges={"coarse": pairs})
    graph = builder.build(at.state, at.collider, DT)
    coarse = graph.edges["coarse"]
    assert (coarse.kind, coarse.senders.index.tolist(), coarse.receivers.index.tolist()) == (
        "coarse",
        [12, 29, 0, 3],
        [0, 3, 12, 29],
    )
    vector = at.state.positions[[12, 29, 0, 3]] - at.state.positions[[0, 3, 12, 29]]
    torch.testing.assert_close(coarse.features[:, :3], torch.nn.functional.normalize(vector))
    assert coarse.features.shape[1] == graph.edges["mesh"].features.shape[1]


def test_the_literal_layout_has_no_absolute_length():
    """Moved by 100 m, and at twice the size with twice the threshold, every edge looks the same."""
    layout, rule = NETWORKS["literal"].layout, NETWORKS["literal"].world_edges
    garment, shift = sheet(6, 5), torch.tensor([100.0, 0.0, -100.0], dtype=torch.float64)
    at = moment([garment])
    larger = replace(garment, vertices=2.0 * garment.vertices)
    state = replace(at.state, positions=2.0 * at.state.positions)
    double = Moment(pack([larger], dtype=torch.float64), state, placed(at.collider, lambda positions: 2.0 * positions))
    here = built(at, layout, rule)
    seen = built(at.shifted(shift), layout, rule), built(double, layout, replace(rule, radius=2.0 * rule.radius))
    assert set(here.edges) == {"mesh", "body_to_garment", "garment_to_body"}
    for other in seen:
        for name, edges in here.edges.items():
            assert torch.allclose(edges.features, other.edges[name].features, atol=1e-9), name


def test_relative_world_edges_point_at_the_sender_and_reach_to_one():
    at, names = moment([sheet(6, 5)]), ("direction", "relative_distance")
    layout = FeatureLayout(world_edge=(*names, "relative_now"))
    for edges in built(at, layout, WorldEdgeRule(radius=0.02, neighbours=64)).edges.values():
        if edges.kind != "world":
            continue
        seen = columns(edges.features, layout.columns("world_edge"))
        # The released columns are receiver - sender.
        assert torch.allclose(-0.02 * seen["relative_distance"] * seen["direction"], seen["relative_now"])
        assert 0.0 < float(seen["relative_distance"].min()) <= float(seen["relative_distance"].max()) <= 1.0
