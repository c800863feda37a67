"""Panels and seams of garments that were sewn of a pattern, found in what is written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pb4u.geometry.topology import uv_islands
from pb4u.scene.trajectory import TrajectoryHeader


@dataclass(frozen=True, eq=False)
class SewnPanels:
    """The panels that triangles were cut from.

    Args:
        names: of the panels.
        of_face: (faces,) int64 panel of each triangle; -1 of garments that were not sewn of a pattern.
        seams: (edges, 2) int64 vertices of the edges at which panels, or two edges of one panel, are sewn together.
    """

    names: tuple[str, ...]
    of_face: np.ndarray
    seams: np.ndarray

    @staticmethod
    def of(header: TrajectoryHeader) -> SewnPanels | None:
        """Panels of the garments of a trajectory; None where no garment was sewn of a pattern.

        Args:
            header: of the trajectory to write.
        """
        if header.uv_faces is None or header.polygons is not None:
            return None
        sewn = [k for k, garment in enumerate(header.garments) if garment.get("panels")]
        names: list[str] = []
        of_face = np.full(len(header.faces), -1)
        for k in sewn:
            faces = np.flatnonzero(header.vertex_garment[header.faces[:, 0]] == k)
            panels, islands = header.garments[k]["panels"], uv_islands(header.uv_faces[faces])
            if islands.max(initial=-1) + 1 == len(panels):
                of_face[faces] = len(names) + islands
                names += panels if len(sewn) == 1 else [f"{header.garments[k]['name']} {name}" for name in panels]
        if not names:
            return None
        rows = of_face >= 0
        return SewnPanels(tuple(names), of_face, seam_edges(header.faces[rows], header.uv_faces[rows]))


def seam_edges(faces: np.ndarray, uv_faces: np.ndarray) -> np.ndarray:
    """Edges (edges, 2) int64 at which the two faces have different UV points.

    Args:
        faces: (faces, 3) int64 vertices.
        uv_faces: (faces, 3) int64 UV points.
    """
    ends = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    points = np.concatenate([uv_faces[:, [k, (k + 1) % 3]] for k in range(3)])
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], points[turned] = ends[turned, ::-1], points[turned, ::-1]
    edges, first, of_edge = np.unique(ends, axis=0, return_index=True, return_inverse=True)
    differs = (points != points[first][of_edge.reshape(-1)]).any(axis=1)
    return np.asarray(edges[np.unique(of_edge.reshape(-1)[differs])], dtype=np.int64)
