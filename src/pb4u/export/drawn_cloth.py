"""Cloth as it is drawn: coarse garments smoothed by one subdivision. What is written of a trajectory stays as it is."""

from __future__ import annotations

import numpy as np

from pb4u.export.sewing_lines import SewingLines
from pb4u.geometry.subdivision import loop_weights, split_faces
from pb4u.scene.trajectory import TrajectoryHeader

_COARSE = 8000
"""Triangles of a garment whose edges are a few pixels long in a picture."""


class DrawnCloth:
    """The garments of a trajectory on the mesh that they are drawn on.

    Args:
        header: of the trajectory.
        coarse: number of triangles from which on a garment is drawn without subdivision.

    Attributes:
        faces: (drawn faces, 3) int64.
        parent: (drawn faces,) int64 the face of the trajectory that contains each.
        uv_faces: (drawn faces, 3) int64 UV points of each, or None.
    """

    def __init__(self, header: TrajectoryHeader, coarse: int = _COARSE) -> None:
        vertices = len(header.rest_positions)
        owner = np.asarray(header.vertex_garment)[header.faces[:, 0]]
        chosen = np.bincount(owner)[owner] < coarse
        self._coarse, self._split = header.faces, split_faces(header.faces, vertices, chosen)
        self.faces, self.parent = self._split.faces, self._split.parent
        loop = loop_weights(self._split, header.faces, vertices)
        # Moved outward first by as much as it shrinks: else skin would show where cloth lies on it.
        self._weights = (2.0 * loop - loop @ loop[:vertices]).astype(np.float32)
        self._flat, self.uv_faces = None, None
        if header.uvs is not None and header.uv_faces is not None:
            self._flat = split_faces(header.uv_faces, len(header.uvs), chosen)
            self.uv_faces = self._flat.faces

    def uvs(self, values: np.ndarray | None) -> np.ndarray | None:
        """Values (drawn UV points, 2) interpolated linearly from those of the UV points; None without UVs.

        Args:
            values: (uv points, 2), or None.
        """
        return None if values is None or self._flat is None else self._flat.between(values)

    def at(self, positions: np.ndarray) -> np.ndarray:
        """Drawn vertices (drawn vertices, 3) float32 [m] of a frame.

        Args:
            positions: (vertices, 3) float32 [m] of the trajectory.
        """
        return np.asarray(self._weights @ positions)

    def lines(self, lines: SewingLines) -> SewingLines:
        """The sewing lines on the drawn surface, divided where they cross its edges.

        Args:
            lines: on the trajectory's own.
        """
        middles = self._split.middles[lines.face]
        uncut, cut = lines.at(middles[:, 0] < 0), lines.at(middles[:, 0] >= 0)
        corners, middles = self._coarse[cut.face], middles[middles[:, 0] >= 0]
        # Barycentric coordinates of both ends; a piece lies between two crossings of the lines on which one is a half.
        ends, share = cut.ends.reshape(-1, 2, 2), cut.share.reshape(-1, 2, 1)
        first, second = (corners[:, None] == ends[..., k, None] for k in (0, 1))
        at = (1 - share) * first + share * second
        start, step = at[:, 0], at[:, 1] - at[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            crossed = np.nan_to_num((0.5 - start) / step, nan=0.0)
        inner = np.sort(np.where((crossed > 0) & (crossed < 1), crossed, 0.0), axis=1)
        stops = np.column_stack([np.zeros(len(inner)), inner, np.ones(len(inner))])
        piece, number = np.nonzero(np.diff(stops, axis=1) > 1e-9)
        along = np.column_stack([stops[piece, number], stops[piece, number + 1]])
        points = start[piece, None] + along[..., None] * step[piece, None]
        fine, shares = _on_edges(
            points.reshape(-1, 3), np.repeat(corners[piece], 2, axis=0), np.repeat(middles[piece], 2, axis=0)
        )
        starts = np.searchsorted(self.parent, cut.face[piece])
        middle = points.mean(axis=1)
        child = np.where(middle.max(axis=1) >= 0.5, middle.argmax(axis=1), 3)
        uncut = uncut._replace(face=np.searchsorted(self.parent, uncut.face))
        pieces = SewingLines(fine, shares, starts + child, cut.width[piece], cut.shade[piece])
        return SewingLines(*(np.concatenate(rows) for rows in zip(uncut, pieces, strict=True)))


def _on_edges(at: np.ndarray, corners: np.ndarray, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both vertices of the drawn edge that each point is on, and the share of the second.

    Args:
        at: (points, 3) barycentric coordinates, on an edge of a face or where one of them is a half.
        corners: (points, 3) int64 vertices of that face.
        middles: (points, 3) int64 new vertices on its edges 01, 12 and 20.
    """
    row, least = np.arange(len(at)), at.argmin(axis=1)
    # On the edge from b to c of the face, nearer b.
    on_edge = at[row, least] < 1e-9
    near = at.argmax(axis=1)
    far = 3 - least - near
    between = np.array([[-1, 0, 2], [0, -1, 1], [2, 1, -1]])
    half_edge = np.column_stack([corners[row, near], middles[row, between[near, far]]])
    # Else on the line between the middles of the two edges of the corner whose coordinate is a half.
    half = np.abs(at - 0.5).argmin(axis=1)
    b, c = (half + 1) % 3, (half + 2) % 3
    inner = np.column_stack([middles[row, between[half, b]], middles[row, between[half, c]]])
    ends = np.where(on_edge[:, None], half_edge, inner)
    share = np.where(on_edge, 2.0 * at[row, far], 2.0 * at[row, c])
    return ends, np.clip(share, 0.0, 1.0)
