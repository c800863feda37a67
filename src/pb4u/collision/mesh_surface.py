"""A triangle mesh as a shape to keep to: nearest points on it and on its border."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import torch

from pb4u.collision.nearest_surface import PosedSurface, TriangleSurface
from pb4u.geometry.closest_point import closest_barycentric
from pb4u.geometry.topology import Topology, ranges
from pb4u.geometry.triangle_mesh import edge_lengths

# Faces with the nearest centres among which one that looks the right way is searched for; else the nearest point stays.
_CANDIDATES = 24


class MeshSurface:
    """Nearest-point queries on one triangle mesh.

    Args:
        vertices: (vertices, 3) float64 [m].
        faces: (faces, 3) int64.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices = np.asarray(vertices, dtype=np.float64)
        self.faces = np.asarray(faces, dtype=np.int64)

    @cached_property
    def _posed(self) -> PosedSurface:
        return TriangleSurface(self.faces, len(self.vertices)).at(self.vertices)

    def project(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Nearest points of the surface whose side agrees with the normals, where there is one near.

        Args:
            points: (n, 3) [m].
            normals: (n, 3) unit normals of the points' own surface.

        Returns:
            (n, 3) [m].
        """
        if not len(points):
            return points
        near = self._posed.nearest(points)
        reached = near.positions.numpy().copy()
        face_normals = self._posed.batch.face_normals.numpy()
        facing = np.einsum("nd,nd->n", face_normals[near.triangle.numpy()], normals)
        # Two layers of cloth may lie closer together than a triangle is long: stay on one's own.
        astray = np.flatnonzero(facing < -0.2)
        if len(astray):
            reached[astray] = self._nearest_facing(points[astray], normals[astray], reached[astray])
        return reached

    def _nearest_facing(self, points: np.ndarray, normals: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
        corners = self.vertices[self.faces]
        _, near = self._centre_tree.query(points, k=min(_CANDIDATES, len(corners)))
        near = near.reshape(len(points), -1)
        a, b, c = (torch.from_numpy(corners[near][:, :, k]) for k in range(3))
        spread = torch.from_numpy(points)[:, None].expand_as(a)
        barycentric = closest_barycentric(spread, a, b, c).numpy()
        reached = np.einsum("nck,nckd->ncd", barycentric, corners[near])
        distance = np.linalg.norm(reached - points[:, None], axis=2)
        facing = np.einsum("ncd,nd->nc", self._posed.batch.face_normals.numpy()[near], normals)
        distance = np.where(facing > 0.0, distance, np.inf)
        rows, best = np.arange(len(points)), np.argmin(distance, axis=1)
        return np.where(np.isfinite(distance[rows, best])[:, None], reached[rows, best], otherwise)

    @cached_property
    def _centre_tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.vertices[self.faces].mean(axis=1))

    @cached_property
    def _border(self) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
        """KD-tree of points along the border edges, the edge of each, and both ends of the edges."""
        from scipy.spatial import cKDTree

        edges = Topology(self.faces, len(self.vertices)).boundary_edges
        lengths = edge_lengths(self.vertices, edges)
        parts = np.clip(np.ceil(lengths / max(float(np.median(lengths)), 1e-12)), 1, 50).astype(int)
        owner = np.repeat(np.arange(len(edges)), parts)
        place = (ranges(np.zeros_like(parts), parts) + 0.5) / parts[owner]
        start, end = self.vertices[edges[:, 0]], self.vertices[edges[:, 1]]
        samples = start[owner] + place[:, None] * (end - start)[owner]
        return cKDTree(samples), owner, start, end

    def project_border(self, points: np.ndarray) -> np.ndarray:
        """Nearest points (n, 3) [m] on the border edges, of `points` (n, 3) [m].

        Args:
            points: (n, 3) [m].
        """
        tree, owner, start, end = self._border
        _, index = tree.query(points, k=min(6, len(owner)))
        candidates = owner[index.reshape(len(points), -1)]
        begin, way = start[candidates], (end - start)[candidates]
        along = np.einsum("nkd,nkd->nk", points[:, None] - begin, way)
        along /= np.maximum(np.einsum("nkd,nkd->nk", way, way), 1e-300)
        reached = begin + np.clip(along, 0.0, 1.0)[..., None] * way
        best = np.argmin(np.linalg.norm(reached - points[:, None], axis=2), axis=1)
        return reached[np.arange(len(points)), best]
