"""Drafting: the left half of a garment drawn as it is seen from the front of a resting body, mirrored to the right.

Panels are drawn where they are placed around the body, in front of it or behind it. An outline is a list of edges, each
its name, its start and maybe one or two Bezier control points; it ends at the start of the next one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.pattern.pattern import Curve, Panel, Pattern, Seam, signed_area

Point: TypeAlias = tuple[float, float]
Edge: TypeAlias = tuple[Any, ...]
"""Name of an edge, its start and its control points."""

FOLD = "fold"
"""Last edge of a panel that is cut on the fold of the cloth: both its halves are one."""

_BOW = 1e-3
"""Distance [m] by which the ends of a fold are moved outwards."""

_SIDES = {1: "left", -1: "right"}


class Draft:
    """A pattern that is being drawn; edges are called `panel.edge`, on both sides.

    Args:
        name: of the garment.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._panels: dict[str, Panel] = {}
        self._edges: dict[tuple[str, int], tuple[str, int]] = {}
        self._seams: list[Seam] = []

    def cut(
        self, name: str, *outline: Edge, depth: float, place: Point = (0.0, 0.0), turn: float = 0.0, tilt: float = 0.0,
        azimuth: float = 0.0, label: str = "",
    ) -> None:  # fmt: skip
        """Cut a panel for the left and its mirror image for the right, or one on the fold.

        Args:
            name: of the panel.
            outline: edges in order, in the panel's axes, y along the grain [m].
            depth: how far before the middle of the body it is placed, negative behind it [m].
            place: position of its origin, to the left and upwards [m].
            turn: of its axes, counter-clockwise as seen from the front [rad].
            tilt: of its lower end away from the body [rad].
            azimuth: direction of the depth, from the front to the left [rad].
            label: of the panel.
        """
        on_fold = outline[-1][0] == FOLD
        for side in (1,) if on_fold else (1, -1):
            edges, sides = _mirrored(outline, side), [side] * len(outline)
            if on_fold:
                # Of two edges in one line the triangles at their corner would have no area.
                bow = np.copysign(_BOW, edges[0][1][1] - edges[-1][1][1])
                for k, up in ((0, bow), (-1, -bow)):
                    edge, (x, y), *controls = edges[k]
                    edges[k] = (edge, (x, y + up), *controls)
                other = _reversed(_mirrored(edges, -1))
                edges, sides = [*edges[:-1], *other[1:]], [1] * (len(outline) - 1) + [-1] * (len(outline) - 1)
            if signed_area(np.array([edge[1] for edge in edges])) * depth < 0.0:
                edges, sides = _reversed(edges), sides[::-1]
            axes = Rotation.from_euler("YXZ", [side * azimuth, -tilt, side * turn])
            away = Rotation.from_euler("Y", side * azimuth).apply([0.0, 0.0, depth])
            position = np.add(away, [side * place[0], place[1], 0.0])
            panel = name if on_fold else f"{name}_{_SIDES[side]}"
            self._panels[panel] = Panel(
                panel, np.array([edge[1] for edge in edges]), position, axes.as_matrix(),
                {k: Curve(np.array(edge[2:])) for k, edge in enumerate(edges) if edge[2:]}, label,
            )  # fmt: skip
            for k, (edge, sign) in enumerate(zip(edges, sides, strict=True)):
                self._edges[f"{name}.{edge[0]}", sign] = panel, k

    def length(self, *edges: str) -> float:
        """Total length [m] of edges of one side.

        Args:
            edges: their names.
        """
        return sum(float(self._panels[panel].edge_lengths[k]) for panel, k in (self._edges[edge, 1] for edge in edges))

    def sew(self, *pairs: tuple[str, str]) -> None:
        """Sew edges together on both sides; an edge to itself is sewn to its mirror image.

        Args:
            pairs: names of edges.
        """
        for one, other in pairs:
            for side in (1,) if one == other else (1, -1):
                first, second = self._edges[one, side], self._edges[other, -1 if one == other else side]
                a, b = self._ends(*first), self._ends(*second)
                along, against = np.linalg.norm(a - b, axis=1).sum(), np.linalg.norm(a - b[::-1], axis=1).sum()
                self._seams.append(Seam(first, second, same_way=bool(along < against)))

    def pattern(self) -> Pattern:
        """The pattern as it is drawn so far."""
        return Pattern(self.name, list(self._panels.values()), self._seams)

    def _ends(self, panel: str, edge: int) -> np.ndarray:
        cut_panel = self._panels[panel]
        return cut_panel.placed(cut_panel.corners[[edge, (edge + 1) % cut_panel.edge_count]])


def arc(radius: float, start: float, end: float) -> tuple[Point, Point, Point]:
    """Start and two control points of an arc about the origin, of a quarter of a circle at most.

    Args:
        radius: [m].
        start: angle at its start, from the first axis [rad].
        end: angle at its end [rad].
    """
    reach = 4.0 / 3.0 * np.tan(0.25 * (end - start))
    (x, y), (u, v) = ((radius * np.cos(angle), radius * np.sin(angle)) for angle in (start, end))
    return (x, y), (x - reach * y, y + reach * x), (u + reach * v, v - reach * u)


def _mirrored(edges: Sequence[Edge], side: int) -> list[Edge]:
    return [(name, *((side * x, y) for x, y in points)) for name, *points in edges]


def _reversed(edges: Sequence[Edge]) -> list[Edge]:
    """The same loop run the other way."""
    starts = [edge[1] for edge in edges]
    ends = starts[1:] + starts[:1]
    return [(edge[0], end, *edge[:1:-1]) for edge, end in zip(edges, ends, strict=True)][::-1]
