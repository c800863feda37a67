"""Built-in garments that are drafted from measures, sewn around the body that wears them, and hang there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.garment.drafted import DRAFTED
from pb4u.garment.garment import Garment
from pb4u.garment.material import FABRICS
from pb4u.garment.parts import with_parts
from pb4u.garment.pins import resolve_pins
from pb4u.geometry.topology import uv_islands
from pb4u.pattern.body_measurements import tailors_measures
from pb4u.pattern.drafts import drafted
from pb4u.pattern.files import dressed_once


def drafted_garment(name: str, body: ShapedBody, triangles: int) -> Garment:
    """A drafted garment on a resting body, with its parts.

    Args:
        name: one of `DRAFTED`.
        body: the body that wears it.
        triangles: wanted number of triangles.

    Raises:
        InputError: it cannot be drafted from the body's measures, or cannot be put on the body.
    """
    kind = DRAFTED[name]
    garment = dressed_once(drafted(name, tailors_measures(body)), body, FABRICS[kind.fabric], triangles)
    if kind.parts:
        assert garment.uv_faces is not None
        of_panel = [
            next((k for k, part in enumerate(kind.parts) if panel.startswith(part)), -1) for panel in garment.panels
        ]
        of_face = np.array(of_panel)[uv_islands(garment.uv_faces)]
        garment = replace(garment, pieces=tuple(kind.parts), piece_of_face=of_face)
        layers = dict.fromkeys(kind.parts, 2)
        garment = with_parts(garment, {}, {}, layers, kind.parts, {})
    return garment if kind.pins == "none" else garment.with_pins(resolve_pins(kind.pins, garment))
