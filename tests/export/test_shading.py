"""Colours that tell garments apart."""

from __future__ import annotations

import numpy as np

from pb4u.export.shading import CLOTH, face_colours


def test_each_of_five_garments_has_a_colour_of_its_own_and_the_first_keeps_the_usual() -> None:
    vertex_garment = np.repeat(np.arange(7), 3)
    faces = np.arange(21).reshape(7, 3)
    colours = face_colours(faces, vertex_garment)
    np.testing.assert_array_equal(colours[0], CLOTH)
    assert len(np.unique(colours[:5], axis=0)) == 5
    np.testing.assert_array_equal(colours[5:], colours[1:3])
    np.testing.assert_array_equal(face_colours(faces, vertex_garment, [(0.1, 0.2, 0.3)])[:2, 0], [0.1, colours[1, 0]])
