"""Patterns in GarmentCode's JSON (Korosteleva et al.; also of GarmentCodeData, ChatGarment and Design2GarmentCode)."""

from __future__ import annotations

from operator import index
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.io.reading_limits import read_json, refusing
from pb4u.pattern.pattern import MOST_EDGES, MOST_PANELS, Curve, Panel, Pattern, Seam


def is_pattern(record: Any) -> bool:
    """Whether the data of a JSON file are a pattern.

    Args:
        record: data of the file.
    """
    return isinstance(record, dict) and isinstance(record.get("pattern"), dict)


def read_specification(path: str | Path) -> Pattern:
    """The pattern in a GarmentCode specification.

    Args:
        path: the `.json` file.

    Raises:
        InputError: the file is missing, too large, of another kind, or its pattern cannot be sewn; names the panel and
            the edge.
    """
    path = Path(path)
    with refusing(path, "is not JSON"):
        record = read_json(path)
    if not is_pattern(record):
        raise InputError(f'{path} is not a sewing pattern: GarmentCode\'s specification has an entry "pattern".')
    return pattern_of(record, path.name.removesuffix(".json").removesuffix("_specification"))


def pattern_of(record: dict[str, Any], name: str) -> Pattern:
    """The pattern of a parsed specification.

    Args:
        record: data of the JSON file.
        name: of the garment, for error messages.

    Raises:
        InputError: it is not a pattern, or one that cannot be sewn.
    """
    reader = _Reader(name, record.get("properties") or {})
    try:
        return reader.pattern(record["pattern"])
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        fault = f"has no {error}" if isinstance(error, KeyError) else f"is not as GarmentCode writes it ({error})"
        raise InputError(f"{name}: {reader.where} {fault}.") from None


def record_of(pattern: Pattern) -> dict[str, Any]:
    """Data of a GarmentCode specification of a pattern, in centimetres; `pattern_of` reads it.

    Args:
        pattern: to be written.
    """
    from scipy.spatial.transform import Rotation

    panels = {}
    for panel in pattern.panels:
        edges: list[dict[str, Any]] = []
        for k in range(panel.edge_count):
            edge: dict[str, Any] = {"endpoints": [k, (k + 1) % panel.edge_count]}
            if (curve := panel.curves.get(k)) is not None:
                edge["curvature"] = _curve_record(curve)
            if k in panel.edge_labels:
                edge["label"] = panel.edge_labels[k]
            edges.append(edge)
        panels[panel.name] = {
            "vertices": (100.0 * panel.corners).tolist(),
            "edges": edges,
            "translation": (100.0 * panel.position).tolist(),
            "rotation": Rotation.from_matrix(panel.rotation).as_euler("XYZ", degrees=True).tolist(),
            "label": panel.label,
        }
    stitches = []
    for seam in pattern.seams:
        sides: list[Any] = [{"panel": name, "edge": edge} for name, edge in (seam.first, seam.second)]
        stitches.append([*sides, "right_wrong"] if seam.same_way else sides)
    properties = {"curvature_coords": "absolute", "units_in_meter": 100}
    return {"pattern": {"panels": panels, "stitches": stitches}, "properties": properties}


def _curve_record(curve: Curve) -> dict[str, Any]:
    if curve.radius > 0.0:
        return {"type": "circle", "params": [100.0 * curve.radius, int(curve.large), int(curve.counter_clockwise)]}
    return {"type": ("quadratic", "cubic")[len(curve.controls) - 1], "params": (100.0 * curve.controls).tolist()}


class _Reader:
    """Reads one specification; `where` says what is being read, for refusals."""

    def __init__(self, name: str, properties: dict[str, Any]) -> None:
        self.name, self.where = name, "the specification"
        unit = properties.get("units_in_meter", 100)
        if isinstance(unit, bool) or not isinstance(unit, int | float) or not 0.1 <= unit <= 1e4:
            raise InputError(f"{name}: units_in_meter must be a number such as 100 for centimetres, not {unit!r}.")
        self.scale = 1.0 / unit
        self.relative = properties.get("curvature_coords", "relative") == "relative"

    def pattern(self, record: dict[str, Any]) -> Pattern:
        panels, stitches = record["panels"], record.get("stitches", [])
        if len(panels) > MOST_PANELS:
            raise InputError(f"{self.name} has {len(panels):,} panels; a pattern has 1 to {MOST_PANELS}.")
        self._order: dict[str, dict[int, int]] = {}
        return Pattern(
            self.name,
            [self.panel(name, panel) for name, panel in panels.items()],
            [self.seam(number, stitch) for number, stitch in enumerate(stitches)],
        )

    def panel(self, name: str, record: dict[str, Any]) -> Panel:
        from scipy.spatial.transform import Rotation

        self.where = f"panel {name}"
        vertices, edges = self._numbers(record["vertices"], 2), record["edges"]
        if len(edges) > MOST_EDGES:
            raise InputError(f"{self.name}: panel {name} has {len(edges):,} edges; a panel has 3 to {MOST_EDGES}.")
        ends = np.array([edge["endpoints"] for edge in edges], dtype=np.int64).reshape(-1, 2)
        if len(odd := ends[(ends < 0) | (ends >= len(vertices))]):
            raise InputError(f"{self.name}: panel {name} has no vertex {odd[0]}, which an edge of it names.")
        if len(broken := np.flatnonzero(ends[:, 1] != np.roll(ends[:, 0], -1))):
            raise InputError(
                f"{self.name}: the outline of panel {name} is open: edge {broken[0]} does not end where edge "
                f"{(broken[0] + 1) % len(ends)} starts."
            )
        corners = vertices[ends[:, 0]]
        curves, labels = {}, {}
        for k, edge in enumerate(edges):
            self.where = f"edge {k} of panel {name}"
            if edge.get("curvature") is not None:
                curves[k] = self.curve(edge["curvature"], corners[k], corners[(k + 1) % len(ends)])
            if edge.get("label"):
                labels[k] = str(edge["label"])
        self.where = f"panel {name}"
        angles = np.array(record.get("rotation", (0, 0, 0)), dtype=np.float64)
        rotation = Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()
        position = self._numbers([record["translation"]], 3)[0]
        return Panel(name, corners, position, rotation, curves, str(record.get("label", "")), labels)

    def curve(self, record: Any, start: np.ndarray, end: np.ndarray) -> Curve:
        """A curve; older files give the one control point alone, relative to the edge."""
        old = isinstance(record, list)
        kind, params = ("quadratic", [record]) if old else (str(record["type"]), list(record["params"]))
        if kind == "circle":
            radius, large, sweep = params
            return Curve(radius=float(radius) * self.scale, large=bool(large), counter_clockwise=bool(sweep))
        if kind not in ("quadratic", "cubic") or len(params) != (1 if kind == "quadratic" else 2):
            raise ValueError(f"a curve of {len(params)} parameters called {kind}")
        controls = np.array(params, dtype=np.float64).reshape(-1, 2)
        if not self.relative:
            return Curve(controls * self.scale)
        along = end - start
        return Curve(start + controls @ np.array([along, [-along[1], along[0]]]))

    def seam(self, number: int, record: Any) -> Seam:
        self.where = f"stitch {number}"
        first, second = ((str(side["panel"]), index(side["edge"])) for side in record[:2])
        return Seam(first, second, same_way="right_wrong" in record[2:])

    def _numbers(self, values: Any, columns: int) -> np.ndarray:
        return np.array(values, dtype=np.float64).reshape(-1, columns) * self.scale
