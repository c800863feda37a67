"""Look-ups that keep what they can against exact ones: over bodies that move, no contact is missed."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from tests.physics.shapes import capsule, collider, colliders, packed, sheet

from pb4u.collision.nearest_points import Found, update_closest
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.collision.wide_tree import fit, fit_again
from pb4u.physics.contact.contact_set import CONTACT_REACH, nearest_planes
from pb4u.scene.colliders import ColliderPose

FRAMES, LOOKS = 6, 8


def bent(vertices: np.ndarray, frame: int) -> np.ndarray:
    """A body that walks, turns and bends: 4 cm and 5 degrees a frame."""
    angle = 0.09 * frame
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    swayed = vertices + 0.05 * np.sin(3.0 * vertices[:, 1:2] + 0.4 * frame) * [1.0, 0.0, 0.0]
    return np.asarray(swayed @ turn.T + [0.04 * frame, 0.0, 0.0])


def test_no_contact_is_missed_and_what_is_out_of_reach_is_kept() -> None:
    body, other = capsule(), trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    shapes = [(np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in (body, other)]
    packed_bodies = colliders(shapes, [0, 1]).colliders
    garments = packed(sheet(20, 20, 0.6, 0.6), sheet(12, 12, 0.5, 0.5))
    rng = np.random.default_rng(3)
    x = garments.rest_positions.numpy() + [-0.3, -0.3, 0.16]
    kept, near, inside = 0, 0, 0
    for frame in range(FRAMES):
        moved = torch.from_numpy(np.concatenate([bent(vertices, frame) for vertices, _ in shapes]))
        pose = packed_bodies.pose(moved)
        for _ in range(LOOKS):
            # From rounding to three centimetres, some of them into the body.
            x = x + 10.0 ** rng.uniform(-12.0, -1.5, (len(x), 1)) * rng.standard_normal(x.shape) / 2.0
            at = torch.from_numpy(x)
            found, exact = nearest_planes(pose, garments, at), nearest_planes(packed_bodies.pose(moved), garments, at)
            reached = exact.distance < CONTACT_REACH
            torch.testing.assert_close(found.distance[reached], exact.distance[reached], rtol=0, atol=1e-8)
            torch.testing.assert_close(
                found.signed_distance(at)[reached], exact.signed_distance(at)[reached], rtol=0, atol=1e-8
            )
            assert bool((found.distance[~reached] >= CONTACT_REACH).all())
            assert bool((found.signed_distance(at)[~reached] >= CONTACT_REACH - 1e-8).all())
            left = (found.points != exact.points).any(1) & ~reached
            kept, near, inside = (
                kept + int(left.sum()),
                near + int(reached.sum()),
                inside + int((exact.distance < 0).sum()),
            )
        x = x + [0.04, 0.0, 0.0]
    assert min(kept, near, inside) > 500, "vertices out of reach, in reach and inside were all seen"


def test_what_stands_still_is_not_searched_for_again() -> None:
    mesh = capsule()
    surface = TriangleSurface(np.asarray(mesh.faces), len(mesh.vertices)).at(np.asarray(mesh.vertices))
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (300, 3))
    found = Found.nothing(len(points))
    assert surface.update_closest(points, found) == 300
    assert surface.update_closest(points, found) == 0
    far = int((found.distances - 2e-3 * np.sqrt(3.0) >= 0.05).sum())
    assert 0 < far < 300
    assert surface.update_closest(points + 2e-3, found, within=0.05) == 300 - far
    assert surface.update_closest(points + 2.5e-3, found, patience=1e-3) == far
    assert surface.update_closest(points + 3e-3, found) == 300


def test_by_the_border_of_an_open_body_nothing_counts_as_out_of_reach() -> None:
    """Cloth that comes in by an open end is inside without having come near the surface."""
    pipe = trimesh.creation.cylinder(radius=0.1, height=0.6, sections=48)
    around = np.abs(np.asarray(pipe.face_normals)[:, 2]) < 0.5
    frame = collider(np.asarray(pipe.vertices), np.asarray(pipe.faces)[around])
    garments = packed(sheet(3, 3, 0.02, 0.02))
    before = garments.rest_positions + torch.tensor([-0.01, -0.01, 0.32], dtype=torch.float64)
    assert bool((nearest_planes(frame.now, garments, before).distance > 0.05).all())
    after = before - torch.tensor([0.0, 0.0, 0.05], dtype=torch.float64)
    found = nearest_planes(frame.now, garments, after)
    assert bool((found.distance < -0.05).all())


@pytest.mark.parametrize("distance", [0.3, 0.02, 1e-4])
def test_a_bound_that_nothing_lies_within_loses_no_face(distance: float) -> None:
    """A place that is said to be of the surface and is not: the nearest face is still found."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    surface = TriangleSurface(np.asarray(mesh.faces), len(mesh.vertices)).at(np.asarray(mesh.vertices))
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (200, 3))
    found, exact = Found.nothing(200, points + [distance, 0.0, 0.0]), surface.nearest(points)
    assert surface.update_closest(points, found) == 200
    np.testing.assert_allclose(found.distances, exact.signed_distance.numpy(), rtol=0, atol=1e-12)


def test_only_nearer_faces_are_taken_and_only_those_asked_for() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    faces, vertices = np.asarray(mesh.faces), np.asarray(mesh.vertices).copy()
    surface = TriangleSurface(faces, len(vertices))
    points = np.random.default_rng(2).uniform(-0.4, 0.4, (400, 3))
    found = Found.nothing(400)
    surface.at(vertices.copy()).update_closest(points, found)
    undented, tree = surface.at(vertices.copy()).searched, surface.tree(vertices)
    dented = (vertices[:, 1] > 0.1)[:, None]
    vertices[dented[:, 0]] *= 1.3
    went = dented[faces, 0].any(axis=1)
    alone = fit_again(vertices, faces, went, tree.order, tree.levels, undented.corners, undented.boxes)
    fitted = fit(vertices, faces, tree.order, tree.levels)
    for again, anew in zip((undented.corners, undented.boxes), fitted, strict=True):
        np.testing.assert_array_equal(again, anew)
    exact = surface.at(vertices).nearest(points)
    on_others = ~went[found.triangle]
    before = found.copy()
    update_closest(undented._replace(vertices=vertices, boxes=alone), surface.names, points, np.inf, -1.0, True, found)
    np.testing.assert_allclose(found.distances[on_others], exact.signed_distance.numpy()[on_others], rtol=0, atol=1e-12)
    changed = found.triangle != before.triangle
    assert (on_others & changed).any()
    assert (on_others & ~changed).any()


def test_a_pose_without_a_body_of_a_world_has_no_plane_there() -> None:
    body = capsule()
    frame = collider(np.asarray(body.vertices), np.asarray(body.faces))
    garments = packed(sheet(3, 3, 0.1, 0.1), sheet(3, 3, 0.1, 0.1))
    pose: ColliderPose = frame.now
    for shift in (0.0, 0.01):
        x = garments.rest_positions + shift
        planes = nearest_planes(pose, garments, x)
        alone = garments.vertex_world == 1
        assert not planes.touchable[alone].any()
        assert bool(torch.isinf(planes.distance[alone]).all())
        assert bool(torch.isfinite(planes.points).all())
        assert bool(planes.touchable[~alone].all())
