"""A sewing pattern: flat panels, where each is placed around the body, and the seams that join their edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import comb

import numpy as np

from pb4u.errors import InputError

MOST_PANELS, MOST_EDGES = 500, 1000
"""Panels of a pattern and edges of a panel: the most elaborate of GarmentCodeData have some 40 and 30."""

MOST_EASE = 6.0
"""How many times longer one side of a seam may be than the other: full gathers take three."""

FALL = "fall"
"""Label of a panel that is turned over, outwards, along the seam that joins it to the others: the fall of a collar."""

_SAMPLES = 1025
"""Points of a curve between which its length is measured along chords: a quarter circle to a part in ten million."""

_CHECKED = 16
"""Chords by which a curved edge is checked for crossings."""

_BLOCK = 64
"""Chords that are compared with all others at once, which bounds memory."""

# Extent [m] of a pattern between which its unit may be the metre after scaling.
_SMALLEST, _LARGEST = 0.05, 10.0


@dataclass(frozen=True, eq=False)
class Curve:
    """Shape of an edge that is not straight: a Bezier curve, or a circular arc.

    Args:
        controls: (1 or 2, 2) Bezier control points in the panel's plane [m]; none for an arc.
        radius: of the arc [m]; 0 for a Bezier curve.
        large: whether the arc is the longer of the two.
        counter_clockwise: whether the arc turns counter-clockwise from its start to its end.
    """

    controls: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    radius: float = 0.0
    large: bool = False
    counter_clockwise: bool = True

    def at(self, start: np.ndarray, end: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Points (n, 2) [m] at parameters `t` (n,) in [0, 1] from `start` to `end`, both (2,) [m].

        Args:
            start: (2,) [m].
            end: (2,) [m].
            t: (n,) in [0, 1].
        """
        if self.radius > 0.0:
            return self._on_arc(start, end, t)
        points = np.stack([start, *self.controls, end])
        degree = len(points) - 1
        weights = [comb(degree, k) * t**k * (1.0 - t) ** (degree - k) for k in range(degree + 1)]
        return np.column_stack(weights) @ points

    def _on_arc(self, start: np.ndarray, end: np.ndarray, t: np.ndarray) -> np.ndarray:
        chord = end - start
        half = 0.5 * float(np.hypot(*chord))
        radius = max(self.radius, half)
        height = float(np.sqrt(radius**2 - half**2))
        left = np.array([-chord[1], chord[0]]) / (2.0 * half)
        centre = 0.5 * (start + end) + (height if self.counter_clockwise != self.large else -height) * left
        first, last = (float(np.arctan2(point[1] - centre[1], point[0] - centre[0])) for point in (start, end))
        turn = (last - first) % (2.0 * np.pi) if self.counter_clockwise else -((first - last) % (2.0 * np.pi))
        angle = first + t * turn
        return centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True, eq=False)
class Panel:
    """A flat piece of cloth. Edge k runs from corner k to the next; the last one closes the loop.

    Counter-clockwise corners show the outside of the cloth, clockwise ones its inside.

    Args:
        name: unique in the pattern.
        corners: (corners, 2) in its own plane, y along the grain [m].
        position: (3,) where its origin is placed around the resting body, feet on y = 0, facing +Z [m].
        rotation: (3, 3) from its plane's axes, and their normal, to the world's.
        curves: edge -> its curve; other edges are straight.
        label: the part that it covers, such as "body", "arm" or "leg".
        edge_labels: edge -> its label, such as "collar".

    Raises:
        InputError: numbers that are not finite, fewer than 3 corners, an edge without length, edges that cross.
    """

    name: str
    corners: np.ndarray
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    curves: Mapping[int, Curve] = field(default_factory=dict)
    label: str = ""
    edge_labels: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, shape in (("corners", (-1, 2)), ("position", (3,)), ("rotation", (3, 3))):
            try:
                values = np.array(getattr(self, name), dtype=np.float64)
                object.__setattr__(self, name, values.reshape(shape) if values.size else values.reshape(0, 2))
            except (TypeError, ValueError):
                raise InputError(f"Panel {self.name}: its {name} must be numbers of shape {shape}.") from None
        if not all(np.isfinite(values).all() for values in (self.corners, self.position, self.rotation)):
            raise InputError(f"Panel {self.name}: its corners and placement must be finite numbers.")
        curves = {k: _as_curve(self.name, k, curve) for k, curve in self.curves.items()}
        object.__setattr__(self, "curves", curves)
        if not 3 <= len(self.corners) <= MOST_EDGES:
            raise InputError(f"Panel {self.name} has {len(self.corners)} corners; a panel has 3 to {MOST_EDGES}.")
        if odd := [k for k in (*curves, *self.edge_labels) if not 0 <= k < self.edge_count]:
            raise InputError(f"Panel {self.name} has no edge {odd[0]}; its edges are 0 to {self.edge_count - 1}.")
        short = np.flatnonzero(np.hypot(*(np.roll(self.corners, -1, axis=0) - self.corners).T) < 1e-5)
        if len(short):
            raise InputError(f"Panel {self.name}: edge {short[0]} has no length; leave one of its two corners out.")
        self._refuse_crossing_edges()

    @property
    def edge_count(self) -> int:
        """Number of edges, which is that of the corners."""
        return len(self.corners)

    @cached_property
    def edge_lengths(self) -> np.ndarray:
        """Lengths (edges,) [m] of the edges, along their curves."""
        return np.array([self._along(edge)[1][-1] for edge in range(self.edge_count)])

    @cached_property
    def area(self) -> float:
        """Area [m^2] within the edges, positive where the corners run counter-clockwise."""
        return signed_area(np.concatenate([self._along(edge)[2][:-1] for edge in range(self.edge_count)]))

    def edge_points(self, edge: int, shares: np.ndarray) -> np.ndarray:
        """Points (n, 2) [m] of an edge.

        Args:
            edge: its number.
            shares: (n,) of its length from its start, in [0, 1].
        """
        start, end = self._ends(edge)
        t, lengths, _ = self._along(edge)
        points = (self.curves.get(edge) or Curve()).at(start, end, np.interp(shares * lengths[-1], lengths, t))
        points[shares <= 0.0], points[shares >= 1.0] = start, end
        return points

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Positions (n, 3) [m] around the body of `points` (n, 2) [m] of the panel.

        Args:
            points: (n, 2) [m].
        """
        return points @ self.rotation[:, :2].T + self.position

    def _ends(self, edge: int) -> tuple[np.ndarray, np.ndarray]:
        return self.corners[edge], self.corners[(edge + 1) % self.edge_count]

    def _along(self, edge: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Parameters (n,), lengths (n,) [m] from the start and points (n, 2) [m] along an edge."""
        curve = self.curves.get(edge)
        t = np.linspace(0.0, 1.0, 2 if curve is None else _SAMPLES)
        points = (curve or Curve()).at(*self._ends(edge), t)
        return t, np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))), points

    def _refuse_crossing_edges(self) -> None:
        edge, points = [], []
        for k in range(self.edge_count):
            shares = np.linspace(0.0, 1.0, (_CHECKED if k in self.curves else 1) + 1)[:-1]
            edge += [k] * len(shares)
            points.append(self.edge_points(k, shares))
        loop = np.concatenate(points)
        crossing = first_crossing(loop)
        if crossing is not None:
            one, other = sorted(edge[k] for k in crossing)
            fault = f"edge {one} crosses itself" if one == other else f"edges {one} and {other} cross"
            raise InputError(f"Panel {self.name}: {fault}; a panel is one piece of cloth within a loop of edges.")
        if abs(self.area) < 1e-6:
            raise InputError(
                f"Panel {self.name} has an area of {1e4 * abs(self.area):.2g} cm^2, too small for a piece of cloth."
            )


def _as_curve(panel: str, edge: int, curve: Curve | np.ndarray) -> Curve:
    if not isinstance(curve, Curve):
        curve = Curve(np.array(curve, dtype=np.float64).reshape(-1, 2))
    is_drawn = curve.radius > 0.0 if not len(curve.controls) else len(curve.controls) <= 2
    if not is_drawn or not np.isfinite([curve.radius, *curve.controls.ravel()]).all():
        raise InputError(
            f"Panel {panel}: the curve of edge {edge} must be one or two control points, or an arc of a positive "
            "radius, in finite numbers."
        )
    return curve


def signed_area(loop: np.ndarray) -> float:
    """Area [m^2] within a closed loop of points (n, 2) [m], positive where it runs counter-clockwise.

    Args:
        loop: (n, 2) [m].
    """
    x, y = (loop - loop.mean(axis=0)).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def first_crossing(loop: np.ndarray) -> tuple[int, int] | None:
    """Two segments of a closed loop of points (n, 2) that cross; None where none do.

    Args:
        loop: (n, 2).
    """
    following = np.roll(loop, -1, axis=0)
    places = np.arange(len(loop))

    def side(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
        return (b[:, None, 0] - a[:, None, 0]) * (p[None, :, 1] - a[:, None, 1]) - (b[:, None, 1] - a[:, None, 1]) * (
            p[None, :, 0] - a[:, None, 0]
        )

    def across(lines: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Whether the ends of a segment lie on both sides of a line."""
        one, other = loop[lines], following[lines]
        return side(one, other, loop[ends]) * side(one, other, following[ends]) < 0.0

    for start in range(0, len(loop), _BLOCK):
        rows = places[start : start + _BLOCK]
        apart = np.abs(rows[:, None] - places)
        meets = across(rows, places) & across(places, rows).T & (apart > 1) & (apart < len(loop) - 1)
        if meets.any():
            first, second = np.argwhere(meets)[0].tolist()
            return start + first, second
    return None


@dataclass(frozen=True)
class Seam:
    """Two edges sewn together.

    Args:
        first: panel and edge.
        second: panel and edge.
        same_way: whether the starts of the two edges meet; by default the start of each meets the end of the other, as
            for two panels with their outsides up.
    """

    first: tuple[str, int]
    second: tuple[str, int]
    same_way: bool = False


@dataclass(frozen=True, eq=False)
class Pattern:
    """Panels and seams of one garment.

    Args:
        name: of the garment.
        panels: the panels.
        seams: the seams; an edge is sewn once, or left open.

    Raises:
        InputError: repeated names, seams of edges that do not exist, are sewn twice or differ too much in length,
            panels without a seam to the others, or an impossible size.
    """

    name: str
    panels: Sequence[Panel]
    seams: Sequence[Seam]

    def __post_init__(self) -> None:
        object.__setattr__(self, "panels", tuple(self.panels))
        object.__setattr__(self, "seams", tuple(self.seams))
        if not 1 <= len(self.panels) <= MOST_PANELS:
            raise InputError(f"{self.name} has {len(self.panels)} panels; a pattern has 1 to {MOST_PANELS}.")
        names = [panel.name for panel in self.panels]
        if repeated := next((name for k, name in enumerate(names) if name in names[:k]), None):
            raise InputError(f"{self.name} has two panels called {repeated}; give each a name of its own.")
        extent = max(float(np.ptp(panel.corners, axis=0).max()) for panel in self.panels)
        if not _SMALLEST <= extent <= _LARGEST:
            raise InputError(
                f"The largest panel of {self.name} spans {extent:.3g} m, which no garment does; check the unit of the "
                "pattern (`units_in_meter` of the file: 100 for centimetres, 39.37 for inches)."
            )
        self._check_seams()
        self._refuse_parts()

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Number of each panel by its name."""
        return {panel.name: k for k, panel in enumerate(self.panels)}

    @property
    def area(self) -> float:
        """Area of all panels [m^2]."""
        return sum(abs(panel.area) for panel in self.panels)

    def seam_lengths(self, seam: Seam) -> tuple[float, float]:
        """Lengths [m] of the two sides of a seam.

        Args:
            seam: one of the pattern's.
        """
        first, second = (float(self.panels[self.index[name]].edge_lengths[k]) for name, k in (seam.first, seam.second))
        return first, second

    def _check_seams(self) -> None:
        sewn: dict[tuple[str, int], Seam] = {}
        for seam in self.seams:
            for side in (seam.first, seam.second):
                name, edge = side
                if name not in self.index:
                    raise InputError(
                        f"A seam of {self.name} names edge {edge} of the panel {name}, which it does not have."
                    )
                count = self.panels[self.index[name]].edge_count
                if not 0 <= edge < count:
                    raise InputError(f"A seam of {self.name} names edge {edge} of {name}, which has 0 to {count - 1}.")
                if side in sewn:
                    raise InputError(f"{self.name}: edge {edge} of {name} is sewn twice; an edge has one seam.")
                sewn[side] = seam
            one, other = self.seam_lengths(seam)
            if max(one, other) > MOST_EASE * min(one, other):
                raise InputError(
                    f"{self.name}: edge {seam.first[1]} of {seam.first[0]} is {100 * one:.1f} cm long and edge "
                    f"{seam.second[1]} of {seam.second[0]}, to which it is sewn, {100 * other:.1f} cm; gathers can "
                    f"take up at most {MOST_EASE:g} to 1."
                )

    def _refuse_parts(self) -> None:
        part = list(range(len(self.panels)))
        for seam in self.seams:
            one, other = part[self.index[seam.first[0]]], part[self.index[seam.second[0]]]
            part = [one if number == other else number for number in part]
        if loose := [panel.name for panel, number in zip(self.panels, part, strict=True) if number != part[0]]:
            raise InputError(
                f"{self.name} is in {len(set(part))} parts: no seam joins {loose[0]} to {self.panels[0].name}; give "
                "each part as a garment of its own."
            )
