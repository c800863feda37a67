"""Patterns that tests are made of."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

from pb4u.pattern.pattern import Curve, Panel, Pattern, Seam

ROOT = Path(__file__).parents[2]


def skirt() -> Pattern:
    """The skirt of the example."""
    specification = importlib.util.spec_from_file_location("sew_a_skirt", ROOT / "examples" / "14_sew_a_skirt.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.skirt()


DRAWN_PANELS = b"""<svg xmlns="http://www.w3.org/2000/svg" width="800mm" height="1200mm" viewBox="0 0 800 1200"
 xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape">
<g transform="translate(30, 20)"><path id="path1" inkscape:label="front" d="M 130 0 H 510 L 640 500 L 0 500 Z"/></g>
<path id="back" d="M 0 1100 A 1200 1200 0 0 0 640 1100 L 510 600 Q 320 620 130 600 Z"/>
</svg>"""

DRAWN_SEAMS = b"""svg = "skirt.svg"
seams = [["front", 0, "back", 1], ["front", 2, "back", 3]]
[panels.front]
position = [0, 0.85, 0.25]
label = "leg"
[panels.back]
position = [0, 0.85, -0.22]
rotation = [0, 180, 0]
edge_labels = {2 = "waist"}
"""


def square(name: str, size: float = 0.4, **given: object) -> Panel:
    """A square whose edges are 0 bottom, 1 right, 2 top, 3 left."""
    return Panel(name, [(0, 0), (size, 0), (size, size), (0, size)], **given)


def vest(height: float) -> Pattern:
    """A wide vest whose hem is placed at a `height` [m]."""
    half = [(0.25, 0.0), (0.25, 0.3), (0.18, 0.52), (0.09, 0.55)]
    corners = [*half, (0.0, 0.45), *((-x, y) for x, y in reversed(half))]
    front = Panel("front", corners, position=(0.0, height, 0.25))
    back = Panel("back", corners[::-1], position=(0.0, height, -0.22))
    return Pattern("vest", [front, back], [Seam(("front", k), ("back", 7 - k)) for k in (0, 2, 5, 7)])


def trousers(height: float) -> Pattern:
    """Wide trousers of four panels whose crotch is placed at a `height` [m]."""
    corners = np.array([(0.0, -0.6), (0.27, -0.6), (0.27, 0.3), (0.0, 0.3), (0.0, 0.0)])
    panels, edges = [], {}
    for half, z in (("front", 0.2), ("back", -0.2)):
        for side in (1, -1):
            as_is, name = (side > 0) == (half == "front"), f"{half} {side}"
            outline = corners * (side, 1)
            panels.append(Panel(name, outline if as_is else outline[::-1], position=(0, height, z)))
            edges[half, side] = dict(zip(("side", "centre", "inseam"), (1, 3, 4) if as_is else (2, 0, 4), strict=True))

    def end(half: str, side: int, edge: str) -> tuple[str, int]:
        return f"{half} {side}", edges[half, side][edge]

    seams = [Seam(end("front", k, edge), end("back", k, edge)) for k in (1, -1) for edge in ("side", "inseam")]
    seams += [Seam(end(half, 1, "centre"), end(half, -1, "centre")) for half in ("front", "back")]
    return Pattern("trousers", panels, seams)


def gathered() -> Pattern:
    """A strip sewn along its bottom to the longer top of another, which has a dart and a curved hem."""
    lower = Panel(
        "lower",
        [(0, 0), (0.6, 0), (0.6, 0.3), (0, 0.3), (0, 0.18), (0.12, 0.15), (0, 0.12)],
        curves={0: Curve(np.array([[0.3, -0.1]])), 1: Curve(radius=0.4)},
    )
    return Pattern(
        "gathered",
        [Panel("band", [(0, 0), (0.4, 0), (0.4, 0.05), (0, 0.05)]), lower],
        [Seam(("band", 0), ("lower", 2)), Seam(("lower", 4), ("lower", 5))],
    )


def record() -> dict:
    """A GarmentCode specification of two squares in centimetres, sewn along one edge."""

    def panel(curvature: object = None) -> dict:
        edges = [{"endpoints": [k, (k + 1) % 4]} for k in range(4)]
        if curvature is not None:
            edges[0]["curvature"] = curvature
        return {"vertices": [[0, 0], [40, 0], [40, 40], [0, 40]], "edges": edges, "translation": [0, 100, 20],
                "rotation": [0, 0, 90], "label": "body"}  # fmt: skip

    curve = {"type": "quadratic", "params": [[0.5, -0.25]]}
    stitches = [[{"panel": "a", "edge": 1}, {"panel": "b", "edge": 3}]]
    return {
        "pattern": {"panels": {"a": panel(curve), "b": panel()}, "stitches": stitches},
        "properties": {"units_in_meter": 100, "curvature_coords": "relative"},
    }
