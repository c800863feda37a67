"""A dress that hangs lengthens by what hangs below over the modulus of its threads, and by no more."""

from __future__ import annotations

import numpy as np
import pytest

from pb4u.body.library import load_body
from pb4u.environment import Environment
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.garment.garment import Garment
from pb4u.garment.library import build_garment
from pb4u.garment.material import FABRICS
from pb4u.scene.packed import inverse_rest_shapes
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.simulation.models import load_simulator

GRAVITY, LITTLE = 9.81, 0.01
HELD = 1.15
"""Height [m] above which the dress is held, and share of gravity that it is compared with."""

BANDS = 16


def warp_stretches(garment: Garment, gravity: float) -> np.ndarray:
    """Stretch (faces,) of the warp where the dress has come to rest."""
    frames = 40
    placement = PrescribedPlacement(np.broadcast_to(garment.vertices, (frames, *garment.vertices.shape)))
    environment = Environment(ground=None, gravity=(0.0, -gravity, 0.0))
    # Long steps of implicit Euler damp what swings.
    scene = Scene((DressedGarment(garment, placement),), (), frames, fps=5.0, environment=environment)
    simulator = load_simulator("solver", first_frame="placed", self_contact=False, time_integration="implicit-euler")
    corners = simulator.simulate(scene).positions[-1].astype(np.float64)[garment.faces]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
    gradient = sides @ inverse_rest_shapes(garment.rest_shape)
    return np.asarray(np.linalg.norm(gradient[:, :, 1], axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("fabric", ["denim-11oz"])
def test_a_dress_lengthens_by_its_weight_over_its_modulus(fabric: str) -> None:
    material = FABRICS[fabric]
    dress = build_garment("dress", load_body("woman"), 1200).with_material(material)
    dress = dress.with_pins(dress.vertices[:, 1] > HELD)
    longer = warp_stretches(dress, GRAVITY) - warp_stretches(dress, LITTLE * GRAVITY)

    weft, warp, coupling, _ = material.membrane
    modulus = warp - coupling**2 / weft
    middles, areas, heights = dress.vertices[dress.faces].mean(axis=1), dress.face_areas, dress.rest_shape[:, :, 1]
    lengthening = expected = 0.0
    for panel in (middles[:, 2] > 0.0, middles[:, 2] <= 0.0):
        free = panel & (middles[:, 1] < HELD)
        at = heights.mean(axis=1)
        edges = np.linspace(at[free].min(), at[free].max(), BANDS + 1)
        band, wide = np.clip(np.digitize(at, edges) - 1, 0, BANDS - 1), edges[1] - edges[0]
        for b in range(BANDS):
            here = free & (band == b)
            below = areas[free & (band < b)].sum() + 0.5 * areas[here].sum()
            tension = material.density * (1.0 - LITTLE) * GRAVITY * below / (areas[here].sum() / wide)
            lengthening += wide * np.average(longer[here], weights=areas[here])
            expected += wide * tension / modulus
    assert lengthening == pytest.approx(expected, rel=0.1)
    assert 1e-4 < lengthening < 4e-3, "a denim of rubber gave nine centimetres"
