"""Closest points in tensors alone, as on an accelerator, against the compiled search."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from tests.physics.shapes import capsule, colliders, packed, sheet

from pb4u.collision.capacities import Capacities
from pb4u.physics.contact.contact_set import ContactPlanes, nearest_planes
from pb4u.scene.colliders import PackedColliders
from pb4u.scene.packed import PackedGarments

CPU = torch.device("cpu")


def scene(worlds: list[int]) -> tuple[PackedGarments, PackedColliders, torch.Tensor, torch.Tensor]:
    """Sheets of different size around a capsule and a ball; positions of the bodies and of the sheets."""
    other = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    shapes = [(np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in (capsule(), other)]
    bodies = colliders(shapes, worlds)
    garments = packed(sheet(20, 20, 0.6, 0.6), sheet(12, 12, 0.5, 0.5), sheet(5, 5, 0.2, 0.2))
    rng = np.random.default_rng(3)
    x = garments.rest_positions + torch.tensor([-0.3, -0.3, 0.16])
    return garments, bodies.colliders, bodies.now.positions, x + 0.05 * torch.from_numpy(rng.standard_normal(x.shape))


def same(found: ContactPlanes, exact: ContactPlanes, rows: torch.Tensor) -> None:
    for name in ("points", "normals", "distance"):
        torch.testing.assert_close(getattr(found, name)[rows], getattr(exact, name)[rows], rtol=0, atol=1e-8)
    assert torch.equal(found.touchable, exact.touchable)


@pytest.mark.parametrize("worlds", [[0, 1], [0, 2]])
def test_the_search_in_tensors_finds_what_the_compiled_one_finds(worlds: list[int]) -> None:
    garments, bodies, body, x = scene(worlds)
    exact = nearest_planes(bodies.pose(body), garments, x)
    capacities = Capacities()
    on_device = bodies.to(CPU, capacities)
    found = nearest_planes(on_device.pose(body), garments, x)
    same(found, exact, exact.touchable)
    body_points = found.interpolated(body, bodies.contact_faces)
    torch.testing.assert_close(body_points[exact.touchable], exact.points[exact.touchable], rtol=0, atol=1e-8)
    assert not capacities.grow(*capacities.taken())


def test_too_little_room_is_noticed_and_mended() -> None:
    garments, bodies, body, x = scene([0, 1])
    capacities = Capacities()
    capacities.sizes = {"groups of faces": 700, "faces": 900}
    pose = bodies.to(CPU, capacities).pose(body)
    tries, short = 0, True
    while short:
        found, tries = nearest_planes(pose, garments, x), tries + 1
        short = capacities.grow(*capacities.taken())
    assert tries in (2, 3)
    exact = nearest_planes(bodies.pose(body), garments, x)
    same(found, exact, exact.touchable)


def test_a_point_that_is_not_finite_spoils_no_other() -> None:
    garments, bodies, body, x = scene([0, 1])
    exact = nearest_planes(bodies.pose(body), garments, x)
    spoilt = x.clone()
    spoilt[5], spoilt[7, 1] = torch.nan, torch.inf
    found = nearest_planes(bodies.to(CPU, Capacities()).pose(body), garments, spoilt)
    rows = exact.touchable.clone()
    rows[[5, 7]] = False
    torch.testing.assert_close(found.points[rows], exact.points[rows], rtol=0, atol=1e-8)
