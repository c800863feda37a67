"""Cloth far beyond the stretch at which its threads stiffen is told of."""

from dataclasses import replace

import numpy as np
import pytest
from ball_scene import ball_scene
from tests.physics.shapes import sheet

from pb4u.garment.material import Material
from pb4u.measures.overstretch import overstretched_sentences
from pb4u.scene.scene import DressedGarment
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

CLOTH = Material(0.2, 1000.0, 800.0, 50.0, 30.0, 1e-5, stiffening_strain=0.02, stiffening_stiffness=1e5)


def stretched(material: Material, along: float, across: float) -> Trajectory:
    """Two frames of a sheet whose upper half is stretched in the second."""
    garment = sheet(4, 4, material=material)
    garment = replace(garment, rest_uv=garment.vertices[garment.faces][..., :2])
    scene = replace(ball_scene(2), garments=(DressedGarment(garment, ball_scene(2).garments[0].placement),))
    header, still = TrajectoryHeader.of(scene, {}), np.zeros_like(garment.vertices)
    moved = garment.vertices.copy()
    moved[:, 0] *= across
    moved[:, 1] = np.where(moved[:, 1] > 0.5, 0.5 + along * (moved[:, 1] - 0.5), moved[:, 1])
    body = scene.colliders[0].rest_vertices
    return Trajectory.collect(header, [Frame(x, still, body) for x in (garment.vertices, moved)])


def test_a_sheet_stretched_to_twice_its_limit_is_told_of_by_its_share() -> None:
    (said,) = overstretched_sentences(stretched(CLOTH, 1.05, 1.0))
    assert said.startswith("sheet: 50 % of it is stretched by more than 4 %")
    assert "frame 1" in said


@pytest.mark.parametrize(
    ("material", "along", "across"),
    [(CLOTH, 1.035, 1.0), (replace(CLOTH, stiffening_stiffness=0.0), 1.2, 1.2), (CLOTH, 1.0, 0.9)],
)
def test_cloth_within_its_limit_or_without_one_is_not(material: Material, along: float, across: float) -> None:
    assert overstretched_sentences(stretched(material, along, across)) == []
