"""Colours that tell garments apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pb4u.export.shading import CLOTH, cloth_parts, garment_colours
from pb4u.scene.trajectory import Trajectory


def test_each_of_five_garments_has_a_colour_of_its_own_and_the_first_keeps_the_usual() -> None:
    colours = garment_colours(7)
    np.testing.assert_array_equal(colours[0], CLOTH)
    assert len(np.unique(colours[:5], axis=0)) == 5
    np.testing.assert_array_equal(colours[5:], colours[1:3])
    np.testing.assert_array_equal(garment_colours(7, [(0.1, 0.2, 0.3)])[:2, 0], [0.1, colours[1, 0]])


def test_parts_are_the_faces_of_one_garment_each(trajectory: Trajectory) -> None:
    upper = trajectory.positions[0][:, 1] > 0.9
    parts = cloth_parts(replace(trajectory.header, vertex_garment=upper.astype(np.int32)))
    assert [part.name for part in parts] == ["garment 1", "garment 2"]
    for part, expected in zip(parts, (False, True), strict=True):
        np.testing.assert_array_equal(part.faces, np.flatnonzero(upper[trajectory.faces[:, 0]] == expected))
