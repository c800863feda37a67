from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.pattern.patterns import DRAWN_PANELS, DRAWN_SEAMS

from pb4u.errors import InputError
from pb4u.pattern.files import read_pattern
from pb4u.pattern.mesh import mesh_pattern


def drawn(folder: Path, panels: bytes = DRAWN_PANELS, seams: bytes = DRAWN_SEAMS) -> Path:
    (folder / "skirt.svg").write_bytes(panels)
    (folder / "skirt.toml").write_bytes(seams)
    return folder / "skirt.toml"


def test_panels_are_read_to_scale_as_seen_from_outside(tmp_path: Path):
    front, back = read_pattern(drawn(tmp_path)).panels
    # Counter-clockwise from the first point of the path, which runs clockwise; the origin is the middle.
    wanted = np.array([[-0.19, 0.25], [-0.32, -0.25], [0.32, -0.25], [0.19, 0.25]])
    assert front.corners == pytest.approx(wanted, abs=1e-6)
    assert front.label == "leg"
    assert front.area == pytest.approx(0.5 * (0.38 + 0.64) * 0.5, rel=1e-5)
    # From behind, the first corner of the back lies to the right of the body.
    assert back.placed(back.corners)[0] == pytest.approx(np.array([0.32, 0.61, -0.22]), abs=0.02)
    assert back.edge_labels == {2: "waist"}
    assert list(back.curves) == [0, 2]
    # The hem of the back bulges down by the rise of its arc, and its waist is cut in.
    rise = 1.2 - np.sqrt(1.2**2 - 0.32**2)
    hem = back.edge_points(0, np.array([0.0, 0.5]))
    assert hem[0, 1] - hem[1, 1] == pytest.approx(rise, rel=1e-4)
    waist = back.edge_points(2, np.array([0.0, 0.5]))
    assert waist[0, 1] - waist[1, 1] == pytest.approx(0.01, rel=1e-3)


def test_a_path_drawn_the_other_way_round_is_the_same_panel(tmp_path: Path):
    turned = DRAWN_PANELS.replace(
        b"M 0 1100 A 1200 1200 0 0 0 640 1100 L 510 600 Q 320 620 130 600 Z",
        b"M 0 1100 L 130 600 Q 320 620 510 600 L 640 1100 A 1200 1200 0 0 1 0 1100 Z",
    )
    one = read_pattern(drawn(tmp_path)).panels[1]
    other = read_pattern(drawn(tmp_path, turned)).panels[1]
    assert other.corners == pytest.approx(one.corners)
    assert other.area == pytest.approx(one.area)
    assert other.edge_lengths == pytest.approx(one.edge_lengths)


def test_drawn_panels_are_sewn(tmp_path: Path):
    mesh = mesh_pattern(read_pattern(drawn(tmp_path)), 200)
    ends = mesh.placed[[mesh.sides[0][0][0], mesh.sides[0][1][0]]]
    # Waist to waist: both at one height, on one side.
    assert abs(ends[0] - ends[1])[:2].max() < 0.03


def test_paths_in_a_layer_keep_their_names(tmp_path: Path):
    group = b'<g inkscape:groupmode="layer" id="layer1" inkscape:label="Layer 1">'
    start = DRAWN_PANELS.index(b"<g")
    layered = DRAWN_PANELS[:start] + group + DRAWN_PANELS[start:].replace(b"</svg>", b"</g></svg>")
    assert [panel.name for panel in read_pattern(drawn(tmp_path, layered)).panels] == ["front", "back"]


def test_a_drawing_of_illustrator_is_in_points(tmp_path: Path):
    wanted = read_pattern(drawn(tmp_path)).panels[0].corners
    root = DRAWN_PANELS[DRAWN_PANELS.index(b"<svg") : DRAWN_PANELS.index(b">", DRAWN_PANELS.index(b"<svg")) + 1]
    # Its user unit is a point, in which 1 mm is 2.83465.
    points = b'<svg version="1.1" x="0px" y="0px" xmlns="http://www.w3.org/2000/svg" '
    points += b'xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"><g transform="scale(2.83465)">'
    made = b"<!-- Generator: Adobe Illustrator 27.0.0, SVG Export Plug-In -->" + DRAWN_PANELS.replace(root, points)
    found = read_pattern(drawn(tmp_path, made.replace(b"</svg>", b"</g></svg>"))).panels[0].corners
    assert found == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize(
    ("panels", "seams", "sentence"),
    [
        (DRAWN_PANELS, DRAWN_SEAMS.replace(b"panels.back", b"panels.rear"), "back"),
        (DRAWN_PANELS, DRAWN_SEAMS.replace(b"skirt.svg", b"coat.svg"), "coat.svg cannot be read"),
        (DRAWN_PANELS, DRAWN_SEAMS.replace(b"seams =", b"seam ="), "seams"),
        (DRAWN_PANELS, DRAWN_SEAMS.replace(b"svg =", b"# svg ="), "must name its drawing"),
        (DRAWN_PANELS, DRAWN_SEAMS.replace(b"position = [0, 0.85, 0.25]", b""), "[panels.front] must say where"),
        (DRAWN_PANELS, DRAWN_SEAMS.replace(b"[0, 0.85, 0.25]", b"[0, 0.85]"), "panel front must be three numbers"),
        (DRAWN_PANELS, DRAWN_SEAMS.replace(b'"front", 0, ', b'"front", '), "seam 0 must be [panel, edge, panel, edge]"),
        (DRAWN_PANELS, DRAWN_SEAMS.replace(b'"front", 0, ', b'"front", 4, '), "edge 4 of front, which has 0 to 3"),
        (
            DRAWN_PANELS.replace(b"</svg>", b'<rect id="front" width="9" height="9"/></svg>'),
            DRAWN_SEAMS,
            "two paths called",
        ),
        (DRAWN_PANELS.replace(b"L 0 500 Z", b"L 0 500"), DRAWN_SEAMS, "front is not a closed loop"),
        (DRAWN_PANELS.replace(b"A 1200 1200", b"A 1200 900"), DRAWN_SEAMS, "edge 0 is part of an ellipse"),
        (DRAWN_PANELS.replace(b"<path", b"<use"), DRAWN_SEAMS, "contains references"),
        (DRAWN_PANELS.replace(b"L 640 500", b"L wide"), DRAWN_SEAMS, "front is not a closed loop"),
        (DRAWN_PANELS[:200], DRAWN_SEAMS, "cannot be read as SVG"),
        (DRAWN_PANELS.replace(b"mm", b"in"), DRAWN_SEAMS, "spans 16.3 m, which no garment does"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_sentence(tmp_path: Path, panels: bytes, seams: bytes, sentence: str):
    with pytest.raises(InputError, match=re.escape(sentence)):
        read_pattern(drawn(tmp_path, panels, seams))
