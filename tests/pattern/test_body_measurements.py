from __future__ import annotations

import pytest

from pb4u.body.library import load_body
from pb4u.pattern.body_measurements import body_measurements, measurements_yaml

# fmt: off
NAMES = {
    "arm_length", "arm_pose_angle", "armscye_depth", "back_width", "bum_points", "bust", "bust_line", "bust_points",
    "crotch_hip_diff", "head_l", "height", "hip_back_width", "hip_inclination", "hips", "hips_line", "leg_circ",
    "neck_w", "shoulder_incl", "shoulder_w", "underbust", "vert_bust_line", "waist", "waist_back_width", "waist_line",
    "waist_over_bust_line", "wrist",
}
# fmt: on


@pytest.mark.parametrize("name", ["woman", "man"])
def test_a_body_has_the_26_measures_of_garmentcode(name: str):
    body = load_body(name, {})
    measures = body_measurements(body)
    assert set(measures) == NAMES
    assert measures["height"] == pytest.approx(100 * body.height, abs=0.01)
    assert measures["waist"] < measures["underbust"] < measures["bust"]
    assert measures["waist"] < measures["hips"]
    assert measures["vert_bust_line"] < measures["bust_line"] < measures["waist_over_bust_line"]
    # What lies across the back is about half of the girth.
    for part, whole in (("waist_back_width", "waist"), ("hip_back_width", "hips"), ("back_width", "bust")):
        assert 0.4 < measures[part] / measures[whole] < 0.6
    text = measurements_yaml(body_measurements(body))
    assert text.startswith("body:\n  arm_length: ")
    assert text.count("\n") == 27


def test_a_heavier_body_has_larger_girths():
    slim, heavy = (body_measurements(load_body("woman", {"weight": weight})) for weight in (0.3, 0.8))
    assert all(slim[name] < heavy[name] for name in ("waist", "hips", "bust", "leg_circ"))
