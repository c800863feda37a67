"""Nearest points on a triangle mesh and on its border."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import edge_lengths


def closest_on_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (..., 3) of the point of each triangle `corners` (..., 3, 3) nearest to `points` (..., 3).

    Every Voronoi region of the triangle is handled (Ericson, Real-Time Collision Detection, 5.1.5).
    """
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    ab, ac = b - a, c - a

    def dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.einsum("...i,...i->...", x, y)

    d1, d2 = dot(ab, points - a), dot(ac, points - a)
    d3, d4 = dot(ab, points - b), dot(ac, points - b)
    d5, d6 = dot(ab, points - c), dot(ac, points - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    tiny = 1e-300

    def ratio(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
        return np.clip(numerator / np.where(np.abs(denominator) < tiny, tiny, denominator), 0.0, 1.0)

    zero, one = np.zeros_like(d1), np.ones_like(d1)
    on_ab, on_ac, on_bc = ratio(d1, d1 - d3), ratio(d2, d2 - d6), ratio(d4 - d3, (d4 - d3) + (d5 - d6))
    total = np.where(np.abs(va + vb + vc) < tiny, tiny, va + vb + vc)
    inside = np.stack([va / total, vb / total, vc / total], axis=-1)
    conditions = [
        (d1 <= 0) & (d2 <= 0),
        (d3 >= 0) & (d4 <= d3),
        (d6 >= 0) & (d5 <= d6),
        (vc <= 0) & (d1 >= 0) & (d3 <= 0),
        (vb <= 0) & (d2 >= 0) & (d6 <= 0),
        (va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0),
    ]
    choices = [
        np.stack([one, zero, zero], -1),
        np.stack([zero, one, zero], -1),
        np.stack([zero, zero, one], -1),
        np.stack([1 - on_ab, on_ab, zero], -1),
        np.stack([1 - on_ac, zero, on_ac], -1),
        np.stack([zero, 1 - on_bc, on_bc], -1),
    ]
    result = inside
    for condition, choice in reversed(list(zip(conditions, choices, strict=True))):
        result = np.where(condition[..., None], choice, result)
    return result


class MeshSurface:
    """Nearest-point queries on one triangle mesh, exact among the faces whose centres are nearest.

    Args:
        vertices: (vertices, 3) float64 [m].
        faces: (faces, 3) int64.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, neighbours: int = 16) -> None:
        self.vertices = np.asarray(vertices, dtype=np.float64)
        self.faces = np.asarray(faces, dtype=np.int64)
        self._neighbours = neighbours

    @cached_property
    def _corners(self) -> np.ndarray:
        return self.vertices[self.faces]

    @cached_property
    def _samples(self) -> tuple[object, np.ndarray]:
        """KD-tree of points spread over the faces, and the face of each: large faces get more points."""
        from scipy.spatial import cKDTree

        corners = self._corners
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        wanted = np.clip(np.ceil(sides / max(float(np.median(sides)), 1e-12)), 1, 12).astype(int)
        points, owners = [], []
        for parts in np.unique(wanted).tolist():
            owned = np.flatnonzero(wanted == parts)
            grid = [(i, j) for i in range(parts) for j in range(parts - i)]
            weights = np.array([[(3 * i + 1), (3 * j + 1)] for i, j in grid]) / (3 * parts)
            weights = np.column_stack([1 - weights.sum(axis=1), weights])
            points.append(np.einsum("sk,fkd->fsd", weights, corners[owned]).reshape(-1, 3))
            owners.append(np.repeat(owned, len(weights)))
        return cKDTree(np.concatenate(points)), np.concatenate(owners)

    @cached_property
    def face_normals(self) -> np.ndarray:
        """(faces, 3) unit normals."""
        a, b, c = self._corners[:, 0], self._corners[:, 1], self._corners[:, 2]
        cross = np.cross(b - a, c - a)
        return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    def nearest(self, points: np.ndarray, normals: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Nearest face (n,) and barycentric coordinates (n, 3) for `points` (n, 3).

        With `normals` (n, 3), faces that look the other way are passed over where another one is near.
        """
        faces = np.empty(len(points), dtype=np.int64)
        weights = np.empty((len(points), 3))
        tree, owners = self._samples
        k = min(self._neighbours, len(owners))
        for begin in range(0, len(points), 16384):
            part = slice(begin, begin + 16384)
            _, index = tree.query(points[part], k=k)  # type: ignore[attr-defined]
            candidates = owners[index.reshape(len(index), -1)]
            barycentric = closest_on_triangles(points[part, None, :], self._corners[candidates])
            reached = np.einsum("nck,nckd->ncd", barycentric, self._corners[candidates])
            distance = np.linalg.norm(reached - points[part, None, :], axis=2)
            if normals is not None:
                facing = np.einsum("ncd,nd->nc", self.face_normals[candidates], normals[part])
                distance = distance + np.where(facing < 0.0, 1e6, 0.0)
            best = np.argmin(distance, axis=1)
            rows = np.arange(len(best))
            faces[part] = candidates[rows, best]
            weights[part] = barycentric[rows, best]
        return faces, weights

    def project(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """The nearest points (n, 3) of the surface whose side agrees with `normals` (n, 3)."""
        faces, weights = self.nearest(points, normals)
        return np.einsum("nk,nkd->nd", weights, self._corners[faces])

    @cached_property
    def _border(self) -> tuple[object, np.ndarray, np.ndarray, np.ndarray]:
        """KD-tree of points along the border edges, the edge of each, and both ends of the edges."""
        from scipy.spatial import cKDTree

        edges = Topology(self.faces, len(self.vertices)).boundary_edges
        lengths = edge_lengths(self.vertices, edges)
        parts = np.clip(np.ceil(lengths / max(float(np.median(lengths)), 1e-12)), 1, 50).astype(int)
        owner = np.repeat(np.arange(len(edges)), parts)
        place = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts) + 0.5) / parts[owner]
        start, end = self.vertices[edges[:, 0]], self.vertices[edges[:, 1]]
        samples = start[owner] + place[:, None] * (end - start)[owner]
        return cKDTree(samples), owner, start, end

    def project_border(self, points: np.ndarray) -> np.ndarray:
        """The nearest points (n, 3) on the border edges."""
        tree, owner, start, end = self._border
        _, index = tree.query(points, k=min(6, len(owner)))  # type: ignore[attr-defined]
        candidates = owner[index.reshape(len(points), -1)]
        begin, way = start[candidates], (end - start)[candidates]
        along = np.einsum("nkd,nkd->nk", points[:, None] - begin, way)
        along /= np.maximum(np.einsum("nkd,nkd->nk", way, way), 1e-300)
        reached = begin + np.clip(along, 0.0, 1.0)[..., None] * way
        best = np.argmin(np.linalg.norm(reached - points[:, None], axis=2), axis=1)
        return reached[np.arange(len(points)), best]
