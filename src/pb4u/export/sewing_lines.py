"""Lines that sewing leaves on cloth: turned edges, the stitches of hems, and seams between panels."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pb4u.export.panels import SewnPanels
from pb4u.export.shading import ClothPart, Colour, cloth_parts
from pb4u.garment.cuts import CUTS
from pb4u.geometry.topology import Topology, uv_islands
from pb4u.scene.trajectory import TrajectoryHeader

HEM = 0.02
"""Distance [m] of a hem's stitches from the edge of the cloth, on the rest shape; as usual on shirts."""
_SAMPLED = 0.005

THREAD = 0.6
"""Colour of thread over that of the cloth."""

_EDGE, _STITCH = (0.005, 0.75), (0.0015, THREAD)
"""Width [m] of turned edges and of stitches, and their colour over that of the cloth."""

ABOVE = 0.001
"""Height [m] of lines above the cloth that they are on, where they are drawn as lines."""

_PIXELS = 2048
"""Sides of an image of the lines: 1.5 mm a pixel where panels that are 3 m wide together fill it."""


class SewingLines(NamedTuple):
    """Segments on a surface, each point between two vertices; points 2 k and 2 k + 1 are the ends of segment k.

    Args:
        ends: (points, 2) int64 vertices.
        share: (points,) of the second vertex [1].
        face: (segments,) int64 the face that the segment lies on.
        width: (segments,) [m].
        shade: (segments,) colour over that of the cloth [1].
    """

    ends: np.ndarray
    share: np.ndarray
    face: np.ndarray
    width: np.ndarray
    shade: np.ndarray

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values (points, 3) of the points from those of the vertices (vertices, 3)."""
        share = self.share[:, None].astype(values.dtype)
        return (1 - share) * values[self.ends[:, 0]] + share * values[self.ends[:, 1]]

    def at(self, chosen: np.ndarray) -> SewingLines:
        """Some of the segments; `chosen` (segments,) bool."""
        points = np.repeat(chosen, 2)
        return SewingLines(
            self.ends[points], self.share[points], self.face[chosen], self.width[chosen], self.shade[chosen]
        )

    def colours(self, parts: Sequence[ClothPart], parent: np.ndarray) -> np.ndarray:
        """Colours (segments, 3) uint8 sRGB [0 to 255].

        Args:
            parts: of the garments.
            parent: (faces,) int64 the face of the parts that each face under the lines is a piece of.
        """
        of_face = np.empty((sum(len(part.faces) for part in parts), 3))
        for part in parts:
            of_face[part.faces] = part.colour
        return (255 * self.shade[:, None] * of_face[parent[self.face]]).round().astype(np.uint8)

    def drawn_on(self, header: TrajectoryHeader, part: ClothPart) -> bytes | None:
        """Grey PNG of the sewing lines of a part in its UV space; None where its UVs leave the unit square.

        Args:
            header: of the surface, with UVs.
            part: the faces to draw on.
        """
        from PIL import Image, ImageDraw

        assert header.uvs is not None
        assert header.uv_faces is not None
        uvs = header.uvs[header.uv_faces]
        if uvs[part.faces].min() < 0.0 or uvs[part.faces].max() > 1.0:
            return None
        face = np.repeat(self.face, 2)
        at = [uvs[face, (header.faces[face] == end[:, None]).argmax(axis=1)] for end in self.ends.T]
        points = (1 - self.share[:, None]) * at[0] + self.share[:, None] * at[1]
        points = (_PIXELS * (points * (1.0, -1.0) + (0.0, 1.0))).reshape(-1, 4)
        corners = np.asarray(header.rest_positions)[header.faces[part.faces]]
        double = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
        (ax, ay), (bx, by) = (uvs[part.faces, k].T - uvs[part.faces, 0].T for k in (1, 2))
        pixels_a_metre = _PIXELS * np.sqrt(np.abs(ax * by - ay * bx).sum() / double)
        image = Image.new("L", (_PIXELS, _PIXELS), 255)
        draw = ImageDraw.Draw(image)
        for segment in np.flatnonzero(np.isin(self.face, part.faces)).tolist():
            width = max(round(self.width[segment] * pixels_a_metre), 1)
            draw.line(points[segment].tolist(), round(255 * self.shade[segment]), width)
        written = io.BytesIO()
        image.save(written, "PNG")
        return written.getvalue()


def sewn_parts(header: TrajectoryHeader, chosen: Sequence[Colour] = ()) -> tuple[list[ClothPart], SewingLines]:
    """The garments with their lines as an image where they have UVs and no image or colour of their author's.

    Args:
        header: of the surface.
        chosen: colours of the first garments, as `cloth_parts` takes them.

    Returns:
        The parts, and the lines that are in no image.
    """
    parts, lines = cloth_parts(header, chosen), sewing_lines(header)
    if header.uvs is None or header.appearances is not None:
        return parts, lines
    sewn = [replace(part, image=lines.drawn_on(header, part)) for part in parts]
    drawn = [part.faces for part in sewn if part.image]
    return sewn, lines.at(~np.isin(lines.face, np.concatenate(drawn))) if drawn else lines


def sewing_lines(header: TrajectoryHeader) -> SewingLines:
    """Turned edges and stitches of hems, and the seams of built-in garments and of those that were sewn of a pattern.

    Args:
        header: of the surface.
    """
    faces = header.faces
    # Other garments are far away, so that the hem of one leaves no line on another.
    rest = np.asarray(header.rest_positions, dtype=np.float64) + 1e3 * np.asarray(header.vertex_garment)[:, None]
    kinds = [(line, _STITCH) for line in _seams(header)]
    topology = Topology(faces, len(rest))
    edges = topology.edges[topology.edge_face_counts == 1]
    if len(edges):
        a, b = rest[edges[:, 0]], rest[edges[:, 1]]
        count = int(np.ceil(np.linalg.norm(b - a, axis=1).max() / _SAMPLED)) + 1
        away = cKDTree(np.concatenate([a + t * (b - a) for t in np.linspace(0.0, 1.0, count)])).query(rest)[0]
        # The middle of a turned edge, which would stick out beyond the cloth if it lay on its very end.
        kinds += [(_level(faces, away - 0.5 * _EDGE[0]), _EDGE), (_level(faces, away - HEM), _STITCH)]
    lines = [(*line, *(np.full(len(line[2]), value) for value in kind)) for line, kind in kinds]
    empty = (np.zeros((0, 2), np.int64), np.zeros(0), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    return SewingLines(*(np.concatenate(rows) for rows in zip(empty, *lines, strict=True)))


def _level(faces: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where values (vertices,) change their sign on faces: ends, share and face of `SewingLines`."""
    near = values[faces] < 0.0
    crossed = np.flatnonzero(near.any(axis=1) & ~near.all(axis=1))
    near = near[crossed]
    # One corner lies on its own side of the line.
    lone = np.where(near.sum(axis=1) == 1, near.argmax(axis=1), near.argmin(axis=1))
    corners = [faces[crossed, (lone + k) % 3] for k in range(3)]
    ends = np.stack([np.column_stack([corners[0], corners[k]]) for k in (1, 2)], axis=1).reshape(-1, 2)
    return ends, values[ends[:, 0]] / (values[ends[:, 0]] - values[ends[:, 1]]), crossed


def _seams(header: TrajectoryHeader) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Seams along the edges of meshes that were cut for them, and smooth ones of built-in garments, which were not."""
    faces, uv_faces = header.faces, header.uv_faces
    if panels := SewnPanels.of(header):
        halves = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        at = np.flatnonzero(np.isin(halves @ [1 << 32, 1], np.sort(panels.seams, axis=1) @ [1 << 32, 1]))
        yield np.repeat(halves[at].reshape(-1, 1), 2, axis=1), np.zeros(2 * len(at)), at // 3
    if uv_faces is None or header.polygons is not None:
        return
    for k, garment in enumerate(header.garments):
        rows = np.flatnonzero(np.asarray(header.vertex_garment)[faces[:, 0]] == k)
        if garment.get("source") not in CUTS or not len(rows):
            continue
        panel = uv_islands(uv_faces[rows])
        on_face = np.eye(panel.max() + 1)[panel]
        for _ in range(3):
            on_vertex = np.zeros((len(header.rest_positions), on_face.shape[1]))
            for corner in faces[rows].T:
                np.add.at(on_vertex, corner, on_face)
            on_vertex /= np.maximum(on_vertex.sum(axis=1, keepdims=True), 1e-9)
            on_face = on_vertex[faces[rows]].mean(axis=1)
        for label in range(panel.max()):
            others = np.delete(on_vertex, label, axis=1).max(axis=1)
            ends, share, crossed = _level(faces[rows], on_vertex[:, label] - others)
            yield ends, share, rows[crossed]
