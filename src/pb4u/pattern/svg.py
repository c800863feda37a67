"""Patterns drawn in an SVG: each panel is a closed path, and a TOML beside it says how they are sewn and placed.

svg = "skirt.svg"
seams = [["front", 1, "back", 1], ["front", 3, "back", 3]]
[panels.front]
position = [0, 0.85, 0.25]
[panels.back]
position = [0, 0.85, -0.22]
rotation = [0, 180, 0]
"""

from __future__ import annotations

import io
import re
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError, extra, on_disk, refuse_unknown
from pb4u.io.toml_file import read_tables
from pb4u.pattern.pattern import Curve, Panel, Pattern, Seam, signed_area

_PIXEL = 0.0254 / 96.0
"""Length [m] of a user unit of an SVG that states no other."""

_TOUCHES = 1e-6
"""Distance [m] between points of a path that are one."""

_LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"

_KEYS = ("svg", "seams", "panels")
_PANEL_KEYS = ("position", "rotation", "label", "edge_labels")


def read_drawn(path: str | Path) -> Pattern:
    """The pattern of a TOML file and the SVG that it names.

    A panel is seen from the outside of the cloth. Its edges are counted counter-clockwise from the first point of its
    path. `position` [m] is where the middle of its bounding box is placed, `rotation` XYZ Euler angles [degrees];
    without a rotation the panel lies in the frontal plane and faces forwards. A seam names two panels with an edge
    each; the start of one edge meets the end of the other, unless a fifth entry says "same way".

    Args:
        path: the `.toml` file.

    Raises:
        InputError: a file cannot be read, or its pattern cannot be sewn; names the panel and the edge.
        MissingExtraError: the extra `svg` is not installed.
    """
    path = Path(path)
    record = read_tables(path, "a pattern drawn in an SVG")
    refuse_unknown("entry", record, _KEYS, str(path))
    entries, seams = record.get("panels"), record.get("seams", [])
    if not isinstance(record.get("svg"), str) or not isinstance(entries, dict) or not isinstance(seams, list):
        raise InputError(
            f'{path} must name its drawing (svg = "FILE.svg"), list its seams (seams = [["front", 1, "back", 1]]) and '
            "have a table [panels.NAME] for each panel."
        )
    outlines = _outlines(path.parent / record["svg"], entries)
    panels = []
    for name, entry in entries.items():
        refuse_unknown("path", [name], tuple(outlines), record["svg"])
        panels.append(_panel(path, name, entry, outlines[name]))
    return Pattern(path.stem, panels, [_seam(path, number, seam) for number, seam in enumerate(seams)])


def _panel(path: Path, name: str, entry: Any, outline: list[Any]) -> Panel:
    from scipy.spatial.transform import Rotation

    if not isinstance(entry, dict) or "position" not in entry:
        raise InputError(f"{path}: [panels.{name}] must say where the panel is placed: position = [x, y, z] in metres.")
    refuse_unknown("entry", entry, _PANEL_KEYS, f"[panels.{name}] of {path}")
    try:
        angles = np.array(entry.get("rotation", (0, 0, 0)), dtype=np.float64).reshape(3)
        position = np.array(entry["position"], dtype=np.float64).reshape(3)
        labels = {int(k): str(label) for k, label in dict(entry.get("edge_labels", {})).items()}
    except (TypeError, ValueError):
        raise InputError(f"{path}: position and rotation of panel {name} must be three numbers each.") from None
    rotation = Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()
    corners, curves = _edges(name, outline)
    ends = np.roll(corners, -1, axis=0)
    outline_points = [
        curves[k].at(corners[k], ends[k], np.linspace(0.0, 1.0, 33)) if k in curves else corners[k : k + 1]
        for k in range(len(corners))
    ]
    reached = np.concatenate(outline_points)
    middle = 0.5 * (reached.min(axis=0) + reached.max(axis=0))
    curves = {k: replace(curve, controls=curve.controls - middle) for k, curve in curves.items()}
    return Panel(name, corners - middle, position, rotation, curves, str(entry.get("label", "")), labels)


def _edges(name: str, outline: list[Any]) -> tuple[np.ndarray, dict[int, Curve]]:
    """Corners (n, 2) [m], y up and counter-clockwise, and the curves of the edges between them."""
    from svgelements import Arc, CubicBezier, Move, QuadraticBezier

    def at(point: Any) -> np.ndarray:
        return _PIXEL * np.array([point.x, -point.y])

    starts: list[np.ndarray] = []
    ends: list[np.ndarray] = []
    curves: list[Curve | None] = []
    for segment in outline:
        if isinstance(segment, Move) or segment.start is None or segment.end is None:
            continue
        start, end = at(segment.start), at(segment.end)
        curve = None
        if isinstance(segment, QuadraticBezier):
            curve = Curve(at(segment.control)[None])
        elif isinstance(segment, CubicBezier):
            curve = Curve(np.stack([at(segment.control1), at(segment.control2)]))
        elif isinstance(segment, Arc):
            if abs(segment.rx - segment.ry) > 1e-6 * abs(segment.rx):
                raise InputError(f"Panel {name}: edge {len(starts)} is part of an ellipse; make it a Bezier curve.")
            sweep = float(segment.sweep)
            curve = Curve(radius=_PIXEL * float(segment.rx), large=abs(sweep) > np.pi, counter_clockwise=sweep < 0.0)
        if curve is None and np.hypot(*(end - start)) < _TOUCHES:
            continue  # closes what is closed
        starts.append(start)
        ends.append(end)
        curves.append(curve)
    gaps = [k for k in range(len(starts)) if np.hypot(*(ends[k] - starts[(k + 1) % len(starts)])) > _TOUCHES]
    if gaps or len(starts) < 3:
        where = f"edge {gaps[0]} does not end where the next one starts" if gaps else f"it has {len(starts)} edges"
        raise InputError(f"The outline of panel {name} is not a closed loop of 3 edges or more: {where}.")
    loop = [
        start[None] if curve is None else curve.at(start, end, np.linspace(0.0, 1.0, 33))[:-1]
        for start, end, curve in zip(starts, ends, curves, strict=True)
    ]
    corners = np.array(starts)
    if signed_area(np.concatenate(loop)) < 0.0:
        corners = np.concatenate([corners[:1], corners[:0:-1]])
        curves = [None if curve is None else _reversed(curve) for curve in curves[::-1]]
    return corners, {k: curve for k, curve in enumerate(curves) if curve is not None}


def _reversed(curve: Curve) -> Curve:
    return Curve(curve.controls[::-1], curve.radius, curve.large, not curve.counter_clockwise)


def _outlines(path: Path, labels: Collection[str]) -> dict[str, list[Any]]:
    """Segments [user units] of the paths of an SVG by their ids, or the labels that Inkscape shows.

    Each of the `labels` names may be that of one path alone.
    """
    with extra("svg", "Reading a pattern drawn in an SVG"):
        from svgelements import SVG, Matrix, Path as Outline, Shape

    with on_disk(f"The drawing {path} cannot be read"):
        content = path.read_bytes()
    # In UTF-16 every other byte is zero.
    if any(word in content.replace(b"\0", b"") for word in (b"<!ENTITY", b"<use")):
        raise InputError(f"{path} contains references (<use> or entities): unlink clones before saving it.")
    try:
        drawing = SVG.parse(io.BytesIO(content), reify=True, ppi=96.0)
        shapes = [element for element in drawing.elements() if isinstance(element, Shape) and element.id]
        # Other values of a shape are those of the layer that it lies in.
        names = [shape.values["attributes"].get(_LABEL) or shape.id for shape in shapes]
        # Illustrator's user unit is a point.
        head = content.partition(b"<svg")
        in_points = b"Adobe Illustrator" in head[0] and not re.search(rb"^[^>]*(width|height)=\S*(mm|cm|in)\b", head[2])
        scale = Matrix.scale(96.0 / 72.0 if in_points else 1.0)
        outlines = [list(abs(Outline(shape) * scale)) for shape in shapes]
    except (ValueError, TypeError, SyntaxError, IndexError, KeyError, AttributeError, ZeroDivisionError) as error:
        raise InputError(f"{path} cannot be read as SVG: {error}.") from None
    if repeated := next((name for name in labels if names.count(name) > 1), None):
        raise InputError(f"{path} has two paths called {repeated}; give each a name of its own.")
    return dict(zip(names, outlines, strict=True))


def _seam(path: Path, number: int, record: Any) -> Seam:
    sound = isinstance(record, list) and len(record) in (4, 5) and record[4:] in ([], ["same way"])
    if not sound or not all(isinstance(record[k], kind) for k, kind in ((0, str), (1, int), (2, str), (3, int))):
        raise InputError(
            f'{path}: seam {number} must be [panel, edge, panel, edge], such as ["front", 1, "back", 1], with "same '
            'way" as a fifth entry if the starts of the two edges meet.'
        )
    return Seam((record[0], record[1]), (record[2], record[3]), same_way=len(record) == 5)
