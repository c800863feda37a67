"""Triangles prepared for many points at once: height over the plane and barycentric coordinates of the foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class TriangleFrames:
    """Affine forms of triangles; (triangles, 4) rows r give r[:3] . x + r[3] at a point x.

    Args:
        height: (triangles, 4) height over the plane [m], positive on the side from which the corners go round
            counter-clockwise.
        second: (triangles, 4) barycentric coordinate of the foot with respect to corner 1.
        third: (triangles, 4) the same with respect to corner 2.
        centres: (triangles, 3) [m].
        radii: (triangles,) from the centre to the farthest corner [m].
    """

    height: np.ndarray
    second: np.ndarray
    third: np.ndarray
    centres: np.ndarray
    radii: np.ndarray

    @staticmethod
    def of(vertices: np.ndarray, faces: np.ndarray) -> TriangleFrames:
        """The frames of triangles; one without area contains no foot.

        Args:
            vertices: (vertices, 3) [m].
            faces: (triangles, 3) int64.
        """
        a, b, c = (vertices[faces[:, corner]] for corner in range(3))
        normal = np.cross(b - a, c - a)
        double = np.einsum("ij,ij->i", normal, normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            unit = normal / np.sqrt(double)[:, None]
            second = np.cross(c - a, normal) / double[:, None]
            third = np.cross(normal, b - a) / double[:, None]
        centres = (a + b + c) / 3.0
        radii = np.linalg.norm(np.stack([a, b, c], axis=1) - centres[:, None], axis=2).max(axis=1)
        return TriangleFrames(_through(unit, a), _through(second, a), _through(third, a), centres, radii)

    def contains_foot(self, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Whether the foot of each point on its triangle's plane lies in the triangle.

        Args:
            triangles: (pairs,) int64.
            points: (pairs, 3) [m].

        Returns:
            (pairs,) bool.
        """
        inside = np.zeros(len(points), dtype=bool)
        second = _at(self.second, triangles, points)
        chosen = np.flatnonzero((second >= 0.0) & (second <= 1.0))
        third = _at(self.third, triangles[chosen], points[chosen])
        inside[chosen] = (third >= 0.0) & (second[chosen] + third <= 1.0)
        return inside

    def heights(self, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Signed height of each point over its triangle's plane.

        Args:
            triangles: (pairs,) int64.
            points: (pairs, 3) [m].

        Returns:
            (pairs,) [m].
        """
        return _at(self.height, triangles, points)


def _through(form: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """The affine form that is 0 at `origin`."""
    return np.column_stack([form, -np.einsum("ij,ij->i", form, origin)])


def _at(forms: np.ndarray, rows: np.ndarray, points: np.ndarray) -> np.ndarray:
    chosen = forms[rows]
    value = chosen[:, 3].copy()
    for axis in range(3):
        value += chosen[:, axis] * points[:, axis]
    return value
