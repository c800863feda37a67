"""Bands: elastic on a cylinder, by the laws of a ring under tension, and a stiffened hem that is bent."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial import Delaunay
from tests.physics.shapes import packed, potential_of, tube

from pb4u.garment.garment import Garment
from pb4u.garment.material import FABRICS, Material
from pb4u.run import WornGarment
from pb4u.scene.loaded_garments import load_garment

RADIUS, HEIGHT = 0.1, 0.04
CLOTH = Material(0.2, 900.0, 400.0, 150.0, 60.0, 1e-5)


def radial_force(garment: Garment, flattening: float) -> float:
    """Sum [N] of the outward pull of the cloth on a cylinder, its height times `flattening`."""
    garments = packed(garment)
    x = garments.rest_positions.clone()
    x[:, 1] *= flattening
    x.requires_grad_(True)
    potential_of(garments).energies(x).terms["stretch"].sum().backward()
    pull = x.grad.numpy()
    outward = garment.vertices * [1.0, 0.0, 1.0]
    return float((pull * outward).sum() / RADIUS)


def banded(shape: Garment, **trims: dict) -> Garment:
    own = {name: shape.material for name in trims.get("elastic", {})}
    return load_garment(WornGarment(shape, grain=(0.0, 1.0, 0.0), pins="none", **{"material": own, **trims}), None)


@pytest.mark.parametrize("stretch", [1.02, 1.10, 1.25, 1.40])
@pytest.mark.parametrize("rows", [1, 3])
def test_an_elastic_ring_presses_by_its_tension(stretch: float, rows: int) -> None:
    ring = banded(tube(96, rows, RADIUS, HEIGHT, CLOTH), elastic={"waist": 1.0 / stretch}, band_width={"waist": HEIGHT})
    strain = 0.5 * (stretch**2 - 1.0)
    # Free to narrow, it has no stress along its axis.
    narrowed = math.sqrt(1.0 - 2.0 * CLOTH.coupling_stiffness / CLOTH.warp_stiffness * strain)
    modulus = CLOTH.weft_stiffness - CLOTH.coupling_stiffness**2 / CLOTH.warp_stiffness
    tension = HEIGHT * modulus * strain * stretch
    assert radial_force(ring, narrowed) == pytest.approx(2.0 * math.pi * tension, rel=0.02)


@pytest.mark.parametrize("band", [Material(0.2, 900.0, 400.0, 0.0, 60.0, 1e-5), None])
@pytest.mark.parametrize("rows", [3, 8, 20, 41])
def test_a_band_pulls_alike_on_coarse_and_fine_meshes(rows: int, band: Material | None) -> None:
    # Of threads that do not narrow, so that the band and what it is sewn to keep their heights.
    cloth = Material(0.2, 900.0, 400.0, 0.0, 60.0, 1e-5)
    own = {"material": {} if band is None else {"waist": band}}
    skirt = banded(tube(96, rows, RADIUS, 0.2, cloth), elastic={"waist": 0.8}, band_width={"waist": 0.03}, **own)
    # Without a fabric of its own elastic is webbing.
    tension = 0.03 * (band or FABRICS["elastic"]).weft_stiffness * 0.5 * (1.25**2 - 1.0) * 1.25
    assert radial_force(skirt, 1.0) == pytest.approx(2.0 * math.pi * tension, rel=0.02)


def test_elastic_at_its_rest_length_pulls_nothing_and_does_not_lock_cloth() -> None:
    locking = Material(0.2, 900.0, 400.0, 0.0, 60.0, 1e-5, stiffening_strain=0.01, stiffening_stiffness=1e5)
    ring = banded(tube(96, 2, RADIUS, HEIGHT, locking), elastic={"waist": 0.8}, band_width={"waist": HEIGHT})
    tension = HEIGHT * locking.weft_stiffness * 0.5 * (1.25**2 - 1.0) * 1.25
    # As long as the cloth, its threads are not yet stretched.
    assert radial_force(ring, 1.0) == pytest.approx(2.0 * math.pi * tension, rel=0.02)
    gathered = Garment("ring", ring.vertices * [0.8, 1.0, 0.8], ring.faces, locking, rest_uv=ring.rest_uv)
    assert abs(radial_force(gathered, 1.0)) < 1e-3 * tension
    assert np.isclose(ring.vertex_masses.sum(), tube(96, 2, RADIUS, HEIGHT, locking).vertex_masses.sum(), rtol=1e-12)


def lattice(count: int) -> Garment:
    """A sheet of 0.4 m in the x-y plane, of triangles with nearly equal sides."""
    rows = round(count * 2.0 / math.sqrt(3.0))
    x = np.linspace(0.0, 0.4, count + 1)
    between = np.concatenate([[0.0], 0.5 * (x[1:] + x[:-1]), [0.4]])
    lines = [(x if row % 2 == 0 else between, 0.4 * row / rows) for row in range(rows + 1)]
    points = np.concatenate([np.column_stack([line, np.full(len(line), y)]) for line, y in lines])
    faces = Delaunay(points).simplices.astype(np.int64)
    (ax, ay), (bx, by) = (points[faces[:, k]].T - points[faces[:, 0]].T for k in (1, 2))
    doubled = ax * by - ay * bx
    faces = np.where(doubled[:, None] < 0.0, faces[:, ::-1], faces)[np.abs(doubled) > 1e-9]
    return Garment("sheet", np.column_stack([points, np.zeros(len(points))]), faces, CLOTH)


@pytest.mark.parametrize("count", [8, 14, 28, 56])
def test_a_stiffened_hem_resists_waves_alike_on_coarse_and_fine_meshes(count: int) -> None:
    radius, added = 0.3, 2e-4

    def energy(garment: Garment) -> float:
        garments = packed(garment)
        x = garments.rest_positions.clone()
        x[:, 0], x[:, 2] = radius * torch.sin(x[:, 0] / radius), radius * (1.0 - torch.cos(x[:, 0] / radius))
        return float(potential_of(garments).energies(x).terms["bending"].sum())

    plain = lattice(count)
    stiff = banded(plain, interfacing={"hem": added})
    of_band = 0.02 * 0.4 * added / (2.0 * radius**2)
    # Borders have no hinges, neither those of the sheet nor those of its band.
    of_sheet = energy(plain) / (0.4**2 * CLOTH.bending / (8.0 * radius**2))
    assert (energy(stiff) - energy(plain)) / of_band == pytest.approx(of_sheet, rel=0.1)
