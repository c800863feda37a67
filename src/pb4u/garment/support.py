"""Whether the resting body holds a garment up without pins."""

from __future__ import annotations

import numpy as np

from pb4u.garment.fit import RestBody
from pb4u.geometry.triangle_mesh import face_areas

LEAST_HEIGHT = 0.6
"""Share of the body's height above which cloth counts: feet face up as well, but a garment that lies there fell."""
FACING_UP = 0.75
"""Least upward part of the skin's unit normal where cloth can lie; hips and chest slope more than that."""
NEAR = 0.1
"""Greatest distance [m] between the skin and the cloth that comes to lie on it."""
LEAST_AREA = 5e-4
"""Cloth [m^2] over such skin that is a rest: a few square centimetres, as of a strap."""


def resting_area(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> float:
    """Area [m^2] of the cloth that lies on the body's shoulders, or on other skin of its upper part that faces up.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the resting body.
    """
    ground, top = float(body.vertices[:, 1].min()), float(body.vertices[:, 1].max())
    centres = vertices[faces].mean(axis=1)
    high = centres[:, 1] > ground + LEAST_HEIGHT * (top - ground)
    if not high.any():
        return 0.0
    below = body.surface.nearest(centres[high])
    rests = (below.normals.numpy()[:, 1] > FACING_UP) & (np.abs(below.signed_distance.numpy()) < NEAR)
    return float(face_areas(vertices, faces[high])[rests].sum())


def is_held_up(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> bool:
    """Whether enough cloth lies on the shoulders to carry a garment; arguments as for `resting_area`.

    Cloth stretches over hips that are wider than the waist, so a waist alone is not taken to hold. A bodice that fits
    closely far above the waist can hold without shoulders all the same; that is not seen here.
    """
    return resting_area(vertices, faces, body) >= LEAST_AREA
