"""What elastic in a waist does on a body that walks, and on meshes of any size."""

from __future__ import annotations

import numpy as np
import pytest
from tests.physics.shapes import packed, potential_of

import pb4u
from pb4u.body.library import load_body
from pb4u.garment.garment import Garment
from pb4u.garment.library import build_garment
from pb4u.garment.material import MATERIALS
from pb4u.garment.parts import Parts, with_parts
from pb4u.run import WornGarment


@pytest.mark.slow
@pytest.mark.parametrize(("elastic", "falls"), [({"waist": 0.8}, False), ({}, True)])
def test_a_skirt_stays_up_by_its_elastic_alone(elastic: dict, falls: bool) -> None:
    worn = WornGarment("skirt", triangles=1200, pins="none", elastic=elastic)
    scene = pb4u.make_scene(worn, motion="walk", frames=20, lead_in=20)
    (dressed,) = scene.garments
    waist = np.unique(Parts(dressed.garment).borders["waist"])
    walked = pb4u.load_simulator("quick-solver").simulate(scene).positions[:, waist, 1]
    skinned = dressed.placement.positions(scene.lead_in, scene.total_frames).numpy()[:, waist, 1]
    sunk = (skinned - walked).mean(axis=1)
    if falls:
        # The skirt hangs on the hips.
        assert sunk[-1] > 0.03
    else:
        assert np.abs(sunk).max() < 0.010
        assert np.ptp(sunk) < 0.004


def test_elastic_closes_over_other_cloth() -> None:
    worn = [WornGarment(name, "denim", triangles=1500) for name in ("tshirt", "skirt")]
    shape = {"height": 0.2, "weight": 0.33, "muscle": 0.57}
    scene = pb4u.make_scene(worn, motion="turn", body_shape=shape, frames=1, lead_in=0)
    first = pb4u.load_simulator("quick-solver").simulate(scene).positions[0]
    assert np.isfinite(first).all()


def pull(garment: Garment) -> float:
    """Tension of the cloth round the body times its length [J], where it is worn."""
    garments = packed(garment)
    x = garments.rest_positions.clone().requires_grad_(True)
    potential_of(garments).energies(x).terms["stretch"].sum().backward()
    assert x.grad is not None
    level = garment.vertices[:, ::2] - garment.vertices[:, ::2].mean(axis=0)
    return float((x.grad.numpy()[:, ::2] * level).sum())


@pytest.mark.slow
def test_bands_weigh_and_pull_the_same_on_coarse_and_fine_meshes() -> None:
    found = []
    for triangles in (2500, 11000, 25000):
        plain = build_garment("skirt", load_body("woman"), triangles)
        banded = with_parts(plain, {"hem": MATERIALS["denim"]}, {}, {"hem": 2}, {}, {"waist": 0.8})
        found.append([banded.vertex_masses.sum(), pull(banded) - pull(plain)])
    (mass, tension), *finer = found
    assert np.array(finer)[:, 0] == pytest.approx(mass, rel=5e-4)
    assert np.array(finer)[:, 1] == pytest.approx(tension, rel=5e-3)
