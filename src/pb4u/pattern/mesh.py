"""A pattern as one triangle mesh: panels triangulated, seam vertices matched one to one and welded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pb4u.errors import InputError
from pb4u.geometry.topology import Topology, connected_labels
from pb4u.pattern.layout import laid_out
from pb4u.pattern.pattern import Panel, Pattern, Seam
from pb4u.pattern.triangulation import triangulate_loop

_COUNT_TOLERANCE, _TRIES = 0.02, 6
"""Relative deviation from the wanted number of triangles at which the edge length is adjusted no more, and how often it
is at most."""

_BULGE = 1e-3
"""Slope by which a straight edge is bent outwards while its triangles are chosen."""

_MOST_SPLITS = 20
"""Rounds of splits of edges that welding would join to others; one or two are needed."""


@dataclass(frozen=True, eq=False)
class PatternMesh:
    """The panels of a pattern as triangles, and the vertices of the garment that they are sewn to.

    Args:
        pattern: the meshed pattern.
        points: (points, 2) of all panels, each in its panel's plane [m].
        panel: (points,) int64 panel of each.
        faces: (faces, 3) int64 into the points, counter-clockwise from outside.
        vertex: (points,) int64 garment vertex that each point is sewn to.
        sides: of each seam the points (n,) int64 of its two sides, which are sewn together pairwise.
    """

    pattern: Pattern
    points: np.ndarray
    panel: np.ndarray
    faces: np.ndarray
    vertex: np.ndarray
    sides: tuple[tuple[np.ndarray, np.ndarray], ...]

    @cached_property
    def vertex_count(self) -> int:
        """Number of vertices of the garment."""
        return int(self.vertex.max()) + 1

    @cached_property
    def sewn_faces(self) -> np.ndarray:
        """Faces (faces, 3) int64 of the garment."""
        return self.vertex[self.faces]

    @property
    def rest_uv(self) -> np.ndarray:
        """Flat rest shape (faces, 3, 2) [m] of the faces."""
        return self.points[self.faces]

    @cached_property
    def face_panel(self) -> np.ndarray:
        """Panel (faces,) int64 of each face."""
        return self.panel[self.faces[:, 0]]

    @cached_property
    def uvs(self) -> np.ndarray:
        """Texture coordinates (points, 2) in [0, 1]: the panels laid out side by side, all at one scale."""
        rows = [self.points[self.panel == number] for number in range(len(self.pattern.panels))]
        moves, side = laid_out([(cloud.min(axis=0), cloud.max(axis=0)) for cloud in rows])
        return (self.points + moves[self.panel]) / side

    @cached_property
    def seam_lengths(self) -> np.ndarray:
        """Lengths (seams, 2) [m] of both sides of each seam, along the edges of the triangles."""
        lengths = [np.hypot(*np.diff(self.points[side], axis=0).T).sum() for pair in self.sides for side in pair]
        return np.array(lengths).reshape(-1, 2)

    @cached_property
    def placed(self) -> np.ndarray:
        """Positions (points, 3) [m] of the points around the body, with open seams."""
        placed = np.empty((len(self.points), 3))
        for number, panel in enumerate(self.pattern.panels):
            rows = self.panel == number
            placed[rows] = panel.placed(self.points[rows])
        return placed

    def sewn(self, places: np.ndarray) -> np.ndarray:
        """Means (vertices, ...) of values (points, ...) over the points that are sewn to each vertex.

        Args:
            places: (points, ...).
        """
        sums = np.zeros((self.vertex_count, *places.shape[1:]))
        np.add.at(sums, self.vertex, places)
        counts = np.bincount(self.vertex, minlength=self.vertex_count)
        return sums / counts.reshape(-1, *[1] * (places.ndim - 1))


def mesh_pattern(pattern: Pattern, triangles: int) -> PatternMesh:
    """The pattern with about `triangles` even triangles (within 5 %, as far as its shortest edges allow).

    Args:
        pattern: to mesh.
        triangles: wanted number of triangles.

    Raises:
        InputError: so few triangles cannot mesh it, or edges of a panel touch.
    """
    if triangles < 4 * len(pattern.panels):
        raise InputError(f"{triangles} triangles are too few for the {len(pattern.panels)} panels of {pattern.name}.")
    length = 0.985 * float(np.sqrt(4.0 / np.sqrt(3.0) * pattern.area / triangles))
    tries = []
    for _ in range(_TRIES):
        tries.append(mesh := _meshed(pattern, length))
        ratio = len(mesh.faces) / triangles
        if abs(ratio - 1.0) <= _COUNT_TOLERANCE:
            break
        length *= float(np.clip(np.sqrt(ratio), 0.7, 1.4))
    return min(tries, key=lambda mesh: abs(len(mesh.faces) - triangles))


def _meshed(pattern: Pattern, length: float) -> PatternMesh:
    """The pattern with edges of about `length` [m]."""
    segments = [np.maximum(np.rint(panel.edge_lengths / length).astype(int), 1) for panel in pattern.panels]
    for seam in pattern.seams:
        mean = max(round(0.5 * sum(pattern.seam_lengths(seam)) / length), 1)
        for name, edge in (seam.first, seam.second):
            segments[pattern.index[name]][edge] = mean
    points, faces, starts, total = [], [], [], 0
    for panel, counts in zip(pattern.panels, segments, strict=True):
        panel_points, triangles = _in_loop(panel, counts, length)
        starts.append(total + np.append(0, np.cumsum(counts)))
        points.append(panel_points)
        faces.append(triangles + total)
        total += len(panel_points)
    panel_of = np.repeat(np.arange(len(points)), [len(rows) for rows in points])
    sides = tuple(_sides(pattern, seam, starts) for seam in pattern.seams)
    return _welded(pattern, np.concatenate(points), panel_of, np.concatenate(faces), sides)


def _in_loop(panel: Panel, counts: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles within a panel whose edges are cut into `counts` (edges,) parts; they run as it does."""
    loop, bulge = [], []
    for k, count in enumerate(counts.tolist()):
        shares = np.arange(count) / count
        points = panel.edge_points(k, np.append(shares, 1.0))
        chord = points[-1] - points[0]
        loop.append(points[:-1])
        bulge.append(_BULGE * (shares * (1.0 - shares))[:, None] * np.array([chord[1], -chord[0]]))
    flip = np.array([np.sign(panel.area), 1.0])
    outwards = np.concatenate(bulge) * np.sign(panel.area)
    points, faces = triangulate_loop(np.concatenate(loop) * flip, length, outwards * flip)
    areas = np.linalg.det(points[faces[:, 1:]] - points[faces[:, :1]])
    if areas.min() < 1e-9 * length**2:
        edge_of, corners = np.repeat(np.arange(len(counts)), counts), faces[areas.argmin()]
        touched = np.unique(edge_of[corners[corners < len(edge_of)]])
        raise InputError(
            f"Panel {panel.name}: its edges {' and '.join(map(str, touched))} touch, or leave no room for a triangle "
            "between them; move them apart."
        )
    return points * flip, faces


def _sides(pattern: Pattern, seam: Seam, starts: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    sides = []
    for name, edge in (seam.first, seam.second):
        border = starts[pattern.index[name]]
        side = np.arange(border[edge], border[edge + 1] + 1)
        side[-1] = border[0] if edge == len(border) - 2 else side[-1]
        sides.append(side)
    return sides[0], sides[1] if seam.same_way else sides[1][::-1]


def _welded(pattern: Pattern, points: np.ndarray, panel: np.ndarray, faces: np.ndarray, sides: tuple) -> PatternMesh:
    """The mesh with the sides of its seams welded.

    Edges within a panel that welding would lay on each other, as at the tip of a dart, are split.
    """
    for _ in range(_MOST_SPLITS):
        pairs = np.concatenate([np.column_stack(pair) for pair in sides]) if sides else np.zeros((0, 2), dtype=int)
        vertex = connected_labels(len(points), *pairs.T)
        order = np.unique(vertex, return_index=True)[1]
        renamed = np.empty(len(order), dtype=np.int64)
        renamed[np.argsort(order)] = np.arange(len(order))
        mesh = PatternMesh(pattern, points, panel, faces, renamed[vertex].astype(np.int64), sides)
        crowded = _crowded(mesh)
        if not len(crowded):
            return mesh
        points, panel, faces = _split(points, panel, faces, crowded)
    raise InputError(f"{pattern.name} cannot be sewn with so few triangles; ask for more.")


def _crowded(mesh: PatternMesh) -> np.ndarray:
    """Edges (n, 2) of points within panels that welding lays on other edges."""
    flat, sewn = Topology(mesh.faces, len(mesh.points)), Topology(mesh.sewn_faces, mesh.vertex_count)
    ends = np.sort(mesh.vertex[flat.edges], axis=1)
    keys = ends[:, 0] * mesh.vertex_count + ends[:, 1]
    where = np.minimum(np.searchsorted(sewn.edge_keys, keys), len(sewn.edge_keys) - 1)
    within = flat.edge_face_counts == 2
    return flat.edges[within & ((sewn.edge_face_counts[where] > 2) | (ends[:, 0] == ends[:, 1]))]


def _split(
    points: np.ndarray, panel: np.ndarray, faces: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mesh with the given inner edges split at their middle, those of a triangle one at a time."""
    topology = Topology(faces, len(points))
    keys = edges.min(axis=1) * len(points) + edges.max(axis=1)
    chosen, busy = [], np.zeros(len(faces), dtype=bool)
    for edge in np.searchsorted(topology.edge_keys, keys).tolist():
        both = topology.edge_faces[edge]
        if not busy[both].any():
            busy[both] = True
            chosen.append(edge)
    new_points, new_panel, new_faces = [points], [panel], [faces[~busy]]
    for number, edge in enumerate(chosen, len(points)):
        ends = topology.edges[edge]
        new_points.append(points[ends].mean(axis=0)[None])
        new_panel.append(panel[ends[:1]])
        for face in faces[topology.edge_faces[edge]]:
            new_faces += [np.where(face == end, number, face)[None] for end in ends]
    return np.concatenate(new_points), np.concatenate(new_panel), np.concatenate(new_faces)
