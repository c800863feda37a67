from __future__ import annotations

import json
import re
import tracemalloc

import numpy as np
import pytest
from tests.pattern.patterns import gathered, record, square

from pb4u.errors import InputError
from pb4u.pattern.files import read_pattern
from pb4u.pattern.garmentcode import pattern_of, record_of
from pb4u.pattern.pattern import Curve, Panel, Pattern, Seam, first_crossing, signed_area


def test_a_specification_is_read_to_scale_and_in_place():
    pattern = pattern_of(record(), "two")
    panel = pattern.panels[0]
    assert panel.placed(np.array([[0.4, 0.0]])) == pytest.approx(np.array([[0.0, 1.4, 0.2]]))
    # The control point lies half way along the edge, a quarter of its length to its right: below the square.
    assert panel.curves[0].controls == pytest.approx(np.array([[0.2, -0.1]]))
    # A parabola over a chord holds two thirds of its triangle with the control point.
    assert panel.area == pytest.approx(0.16 + 2 / 3 * 0.5 * 0.4 * 0.1, rel=1e-5)


def test_inches_are_read_to_scale():
    pattern = pattern_of(record() | {"properties": {"units_in_meter": 39.37}}, "two")
    assert pattern.panels[1].area == pytest.approx((40 * 0.0254) ** 2, rel=1e-5)


@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("counter_clockwise", [False, True])
def test_arcs_have_their_length_and_side(large: bool, counter_clockwise: bool):
    curve = Curve(radius=0.5, large=large, counter_clockwise=counter_clockwise)
    start, end = np.array([0.0, 0.0]), np.array([0.5, 0.0])
    points = curve.at(start, end, np.linspace(0.0, 1.0, 2001))
    assert points[[0, -1]] == pytest.approx(np.array([start, end]), abs=1e-12)
    angle = 5 * np.pi / 3 if large else np.pi / 3
    assert np.hypot(*np.diff(points, axis=0).T).sum() == pytest.approx(0.5 * angle, rel=1e-5)
    assert (signed_area(points) > 0) == counter_clockwise


def test_an_edge_is_divided_by_its_length():
    panel = gathered().panels[1]
    points = panel.edge_points(0, np.linspace(0.0, 1.0, 11))
    pieces = np.hypot(*np.diff(points, axis=0).T)
    assert pieces.max() / pieces.min() < 1.01


def test_what_is_written_is_read_again():
    pattern = gathered()
    again = pattern_of(json.loads(json.dumps(record_of(pattern))), pattern.name)
    assert [panel.area for panel in again.panels] == pytest.approx([panel.area for panel in pattern.panels])
    assert again.seams == pattern.seams
    assert again.panels[1].edge_lengths == pytest.approx(pattern.panels[1].edge_lengths)


def _panels(**changes: object) -> dict:
    changed = record()
    changed["pattern"]["panels"]["a"] |= changes
    return changed


def _stitched(*stitches: object) -> dict:
    changed = record()
    changed["pattern"]["stitches"] = [[{"panel": a, "edge": k}, {"panel": b, "edge": n}] for a, k, b, n in stitches]
    return changed


def _curved(kind: str, *params: object) -> dict:
    curve = {"type": kind, "params": list(params)}
    return _panels(edges=[{**edge, "curvature": curve} if not k else edge for k, edge in enumerate(PLAIN)])


PLAIN = [{"endpoints": [k, (k + 1) % 4]} for k in range(4)]
CROSSED = [[0, 0], [40, 40], [40, 0], [0, 40]]


@pytest.mark.parametrize(
    ("specification", "sentence"),
    [
        (_stitched(("a", 1, "b", 9)), "names edge 9 of b, which has 0 to 3"),
        (_stitched(("a", 1, "c", 0)), "names edge 0 of the panel c, which it does not have"),
        (_stitched(("a", 1, "b", 3), ("a", 1, "b", 1)), "edge 1 of a is sewn twice"),
        (_stitched(), "is in 2 parts: no seam joins b to a"),
        (_panels(vertices=CROSSED), "Panel a: edges 0 and 2 cross"),
        (_panels(vertices=[[0, 0], [1, 0], [1, 0], [0, 0]]), "Panel a: edge 1 has no length"),
        (_panels(vertices=[[0, 0], [20, 0], [60, 0], [20, 1e-5]], edges=PLAIN), "too small for a piece of cloth"),
        (_panels(edges=[{"endpoints": [0, 1]}, {"endpoints": [2, 3]}]), "the outline of panel a is open: edge 0"),
        (_panels(edges=[{"endpoints": [0, 7]}]), "panel a has no vertex 7"),
        (_panels(vertices=[[0, 0], [4, 0], [4, 3], [0, 3]]), "gathers can take up at most 6 to 1"),
        (_panels(vertices=[["x", 0]]), "panel a is not as GarmentCode writes it"),
        (_panels(vertices=[[0, 0], [np.nan, 0], [4, 3], [0, 3]]), "must be finite numbers"),
        (_stitched(("a", 1.5, "b", 3)), "stitch 0 is not as GarmentCode writes it"),
        (_curved("circle", np.inf, 0, 1), "Panel a: the curve of edge 0 must be"),
        (_curved("circle", -30, 0, 1), "Panel a: the curve of edge 0 must be"),
        (_curved("quadratic", [np.nan, 0.5]), "Panel a: the curve of edge 0 must be"),
        (_curved("spline", [0.5, 0.5]), "edge 0 of panel a is not as GarmentCode writes it"),
        (record() | {"properties": {"units_in_meter": 1}}, "spans 40 m, which no garment does; check the unit"),
        (record() | {"properties": {"units_in_meter": "cm"}}, "units_in_meter must be a number"),
        (record() | {"pattern": {"panels": {str(k): {} for k in range(10_000)}}}, "has 10,000 panels"),
        (record() | {"pattern": {}}, "has no 'panels'"),
        (
            record() | {"pattern": {"panels": {"a": {"vertices": CROSSED, "edges": PLAIN}}}},
            "panel a has no 'translation'",
        ),
    ],
)
def test_what_cannot_be_sewn_is_refused_in_one_sentence(specification: dict, sentence: str):
    with pytest.raises(InputError, match=re.escape(sentence)):
        pattern_of(specification, "shirt")


def test_crossings_of_long_outlines_are_found_in_little_memory():
    angle = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    loop = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    tracemalloc.start()
    try:
        assert first_crossing(loop) is None
        loop[[1500, 1503]] = loop[[1503, 1500]]
        assert first_crossing(loop) == (1499, 1503)
        assert tracemalloc.get_traced_memory()[1] < 2e7
    finally:
        tracemalloc.stop()


def test_a_curve_that_crosses_another_edge_is_refused():
    with pytest.raises(InputError, match="edges 0 and 2 cross"):
        square("a", curves={0: np.array([[0.2, 1.2]])})


def test_other_json_is_no_pattern(tmp_path):
    file = tmp_path / "cloth.json"
    file.write_text('{"density": 0.2}')
    with pytest.raises(InputError, match="is not a sewing pattern"):
        read_pattern(file)
    file.write_text("{")
    with pytest.raises(InputError, match="is not JSON"):
        read_pattern(file)
    with pytest.raises(InputError, match="There is no pattern"):
        read_pattern(tmp_path / "none.json")


def test_records_from_python_are_checked():
    with pytest.raises(InputError, match="a panel has 3 to 1000"):
        Panel("a", [(0, 0), (1, 0)])
    with pytest.raises(InputError, match="corners must be numbers"):
        Panel("a", [(0, 0), (1, 0), (1,)])
    with pytest.raises(InputError, match="two panels called a"):
        Pattern("two", [square("a"), square("a")], [Seam(("a", 0), ("a", 1))])
