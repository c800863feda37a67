"""Lines that sewing leaves on cloth: turned edges, the stitches of hems, and seams between panels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pb4u.export.panels import SewnPanels
from pb4u.geometry.topology import Topology
from pb4u.scene.trajectory import TrajectoryHeader

HEM = 0.02
"""Distance [m] of a hem's stitches from the edge of the cloth, on the rest shape; as usual on shirts."""
_SAMPLED = 0.005


class SewingLines(NamedTuple):
    """Segments on a surface, each point between two vertices; points 2 k and 2 k + 1 are the ends of segment k.

    Args:
        ends: (points, 2) int64 vertices.
        share: (points,) of the second vertex [1].
        face: (segments,) int64 a face that the segment lies on.
    """

    ends: np.ndarray
    share: np.ndarray
    face: np.ndarray

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values (points, 3) of the points from those of the vertices (vertices, 3)."""
        share = self.share[:, None].astype(values.dtype)
        mixed: np.ndarray = (1 - share) * values[self.ends[:, 0]] + share * values[self.ends[:, 1]]
        return mixed


def turned_edges(header: TrajectoryHeader) -> SewingLines:
    """The edges at which cloth ends."""
    return _along(header.faces, _borders(header))


def stitches(header: TrajectoryHeader) -> SewingLines:
    """The stitches of hems, `HEM` from where cloth ends, and the seams of garments that were sewn of a pattern."""
    faces = header.faces
    # Other garments are far away, so that the hem of one leaves no line on another.
    rest = np.asarray(header.rest_positions, dtype=np.float64) + 1e3 * header.vertex_garment[:, None]
    panels = SewnPanels.of(header)
    seams = _along(faces, np.zeros((0, 2), dtype=np.int64) if panels is None else panels.seams)
    edges = _borders(header)
    if not len(edges):
        return seams
    a, b = rest[edges[:, 0]], rest[edges[:, 1]]
    count = int(np.ceil(np.linalg.norm(b - a, axis=1).max() / _SAMPLED)) + 1
    away = cKDTree(np.concatenate([a + t * (b - a) for t in np.linspace(0.0, 1.0, count)])).query(rest)[0] - HEM
    near = away[faces] < 0.0
    crossed = np.flatnonzero(near.any(axis=1) & ~near.all(axis=1))
    near = near[crossed]
    # One corner lies on its own side of the line.
    lone = np.where(near.sum(axis=1) == 1, near.argmax(axis=1), near.argmin(axis=1))
    corners = [faces[crossed, (lone + k) % 3] for k in range(3)]
    ends = np.stack([np.column_stack([corners[0], corners[k]]) for k in (1, 2)], axis=1).reshape(-1, 2)
    share = away[ends[:, 0]] / (away[ends[:, 0]] - away[ends[:, 1]])
    return SewingLines(*(np.concatenate(each) for each in zip(seams, SewingLines(ends, share, crossed), strict=True)))


def _borders(header: TrajectoryHeader) -> np.ndarray:
    """Edges (edges, 2) int64 of one face."""
    topology = Topology(header.faces, len(header.rest_positions))
    return np.asarray(topology.edges[topology.edge_face_counts == 1])


def _along(faces: np.ndarray, edges: np.ndarray) -> SewingLines:
    """Segments along edges (edges, 2) of a mesh."""
    ends = np.repeat(edges.reshape(-1, 1), 2, axis=1)
    owner = np.zeros(int(faces.max(initial=-1)) + 1, dtype=np.int64)
    owner[faces.ravel()] = np.repeat(np.arange(len(faces)), 3)
    return SewingLines(ends, np.zeros(len(ends)), owner[edges[:, 0]])
