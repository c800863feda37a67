"""What the loops of a step compute is, to the bit or nearly, what their readable twins do array by array."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.laws.test_energies import crumpled
from tests.laws.test_self_contact import PAIRED, touching
from tests.physics.shapes import packed, sheet, tube
from tests.scene.test_soft_folds import pressed

from pb4u.collision.collision_free import smallest_gaps
from pb4u.geometry.triangle_mesh import area_weighted_normals
from pb4u.physics.contact.contact_set import MOTION_REACH, ContactPlanes, nearest_planes
from pb4u.physics.contact.obstacle import sags
from pb4u.physics.solver.world_sums import each_vertex, factors, norm, squared_ratios
from pb4u.physics.terms.element_loops import rows
from pb4u.physics.terms.stiffness_matrix import StiffnessPattern
from pb4u.scene.soft_folds import _met, _normals


def planes_of(body_moves: bool = True) -> tuple[ContactPlanes, object]:
    step, _ = crumpled()
    assert step.contacts.now is not None
    return step.contacts.now, step.step.bodies


def test_all_terms_together_are_each_by_itself() -> None:
    step, x = touching()
    near = step.potential.self_contact.pairs(step.step.garments, x, None, step.step.state.positions)
    at = step.with_cloth(near)
    energies, gradient = at.energies_and_gradient(x)
    alone = {t.name: t.energies_and_gradient(at.step, at.contacts, x) for t in at.potential.terms}
    assert {"self_contact", "self_friction", "stretch"} <= alone.keys()
    assert list(energies.terms) == list(alone)
    for name, (values, _) in alone.items():
        torch.testing.assert_close(energies.terms[name], values, rtol=0.0, atol=0.0)
        torch.testing.assert_close(at.energies(x).terms[name], values, rtol=0.0, atol=0.0)
    assert float(alone["self_friction"][1].abs().max()) > 0.0
    torch.testing.assert_close(gradient, sum(slope for _, slope in alone.values()), rtol=0.0, atol=0.0)
    torch.testing.assert_close(energies.per_garment, torch.stack([v for v, _ in alone.values()]).sum(0))


def test_the_law_of_near_pairs_is_that_of_arrays() -> None:
    step, x = touching(gap=1.2e-4)
    garments, before = step.step.garments, step.step.state.positions
    cloth = PAIRED.self_contact.pairs(garments, x, None, before)
    pairs, tree, areas = cloth.pairs, garments.surface_tree, garments.vertex_areas.numpy()
    assert len(pairs) > 100
    gaps = smallest_gaps(pairs, before.numpy())
    assert (gaps < gaps.max()).any(), "some are nearer than a gap"
    np.testing.assert_array_equal(cloth.gaps, gaps)
    reaches = np.maximum(np.minimum(2e-3, 0.5 * pairs.rest_distance), 2.0 * gaps)
    np.testing.assert_array_equal(cloth.reaches, reaches)
    np.testing.assert_allclose(cloth.areas, 0.25 * areas[pairs.corners].mean(axis=1), rtol=1e-15)
    ends = tree.rest[pairs.corners]
    lengths = ((ends[:, [1, 3]] - ends[:, [0, 2]]) ** 2).sum(axis=2)
    parallels = np.where(np.arange(len(pairs)) < pairs.vertex_faces, 0.0, 1e-3 * lengths.prod(axis=1))
    np.testing.assert_allclose(cloth.parallels, parallels, rtol=1e-14)


def test_points_and_normals_are_carried_as_torch_carries_them() -> None:
    planes, bodies = planes_of()
    pose, faces = bodies.following, bodies.colliders.contact_faces
    corners = pose.positions[faces[planes.triangle]]
    points = (planes.barycentric[:, :, None] * corners).sum(1)
    torch.testing.assert_close(planes.transported(pose), points, rtol=0.0, atol=0.0)
    cross = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = cross / cross.norm(dim=1, keepdim=True)
    torch.testing.assert_close(planes.transported_normals(pose), normals, rtol=0.0, atol=0.0)


def test_a_first_search_that_is_led_finds_what_one_that_is_not_does() -> None:
    step, x = crumpled()
    bodies, garments = step.step.bodies, step.step.garments
    assert garments in bodies.following.found, "contacts at the start lead the search at the end"
    led, exact = (
        nearest_planes(p, garments, x) for p in (bodies.following, bodies.colliders.pose(bodies.following.positions))
    )
    torch.testing.assert_close(led.points, exact.points, rtol=0.0, atol=1e-12)
    torch.testing.assert_close(led.distance, exact.distance, rtol=0.0, atol=1e-12)
    assert bool(torch.equal(led.touchable, exact.touchable))


def test_sags_are_those_of_arrays() -> None:
    planes, _ = planes_of()
    garments = packed(tube(12, 6, 0.155, 0.5))
    a, b = garments.edges.T
    chords = planes.points[b] - planes.points[a]
    near = planes.touchable & (planes.distance < MOTION_REACH)
    bend = ((planes.normals[b] - planes.normals[a]) * chords).sum(1) / 6.0
    rests = chords.norm(dim=1) < 1.5 * garments.edge_lengths
    dip = torch.where(near[a] & near[b] & rests, bend - 1e-3, 0.0).clamp(0.0, 4e-3)
    expected = torch.zeros_like(planes.distance)
    for ends in (a, b):
        expected = expected.scatter_reduce(0, ends, dip, "amax")
    assert float(expected.max()) > 1e-4
    torch.testing.assert_close(sags(garments, planes), expected, rtol=0.0, atol=0.0)


def test_sums_and_moves_of_worlds_are_those_of_torch() -> None:
    garments = packed(sheet(4, 4), sheet(5, 3), worlds=(0, 1))
    moves = torch.randn((garments.vertex_count, 3), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    longest = torch.stack([moves[rows].norm(dim=1).max() for rows in garments.world_vertices])
    torch.testing.assert_close(factors(moves, 0.2, garments), 0.2 / longest, rtol=1e-15, atol=0.0)
    masses, some = garments.vertex_masses, torch.arange(3, garments.vertex_count)
    expected = (moves[some] / masses[some, None]).square().sum(1)
    found = squared_ratios(moves.numpy(), masses.numpy(), some.numpy())
    torch.testing.assert_close(torch.from_numpy(found), expected, rtol=0.0, atol=0.0)
    expected = (moves.square().sum(1) / masses).sum().sqrt()
    assert norm(moves.numpy(), masses.numpy()) == pytest.approx(float(expected), rel=1e-13)
    values = torch.tensor([2.0, 3.0])
    torch.testing.assert_close(each_vertex(values, garments)[:, 0], values[garments.vertex_world])


def test_a_matrix_that_is_brought_up_to_date_is_the_one_made_anew() -> None:
    step, x = crumpled()
    pattern = StiffnessPattern(step.step.garments, step.elements())
    stiffness, extra = step.with_contact_at(x).stiffness(x, pattern), np.arange(pattern.vertex_count, dtype=float)
    assert np.abs(stiffness.compressive).max() > 0.0
    before = stiffness.matrix(0.8, extra, np.float32)
    stiffness.positive[pattern.starts[:-1]] *= 1.7
    after = stiffness.matrix(0.8, extra, np.float32, before)
    np.testing.assert_array_equal(after.blocks, stiffness.matrix(0.8, extra, np.float32).blocks)


def test_numbers_stand_side_by_side() -> None:
    found = rows(2, 3.0, np.array([1.0, 2.0]), np.array([[4.0, 5.0], [6.0, 7.0]]))
    np.testing.assert_array_equal(found, [[3.0, 1.0, 4.0, 5.0], [3.0, 2.0, 6.0, 7.0]])


def test_places_of_skin_that_met_are_all_that_did() -> None:
    body = pressed(0.09)
    rest, posed, faces = body.rest_vertices, body.positions(0, 1)[0].double().numpy(), body.faces
    normals = _normals(posed, faces)
    np.testing.assert_array_equal(normals, area_weighted_normals(posed, faces))
    offsets = posed[None] - posed[:, None]
    squared = (offsets**2).sum(axis=2)
    facing = normals @ normals.T <= -0.3
    closer = squared <= 0.49 * ((rest[None] - rest[:, None]) ** 2).sum(axis=2)
    expected = np.argwhere(np.tril((squared <= 0.04) & facing & closer, -1))
    found = _met(posed, normals, rest)
    assert len(found) > 500
    np.testing.assert_array_equal(found, expected)
