"""Triangles prepared for many points at once: height over the plane and barycentric coordinates of the foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class TriangleFrames:
    """Affine forms of triangles; (triangles, 4) rows r give r[:3] . x + r[3] at a point x.

    Args:
        height: [m] over the plane, positive on the side that the corners go round counter-clockwise.
        second, third: barycentric coordinates of the foot with respect to corners 1 and 2.
        centres: (triangles, 3) [m]. radii: (triangles,) [m] from the centre to the farthest corner.
    """

    height: np.ndarray
    second: np.ndarray
    third: np.ndarray
    centres: np.ndarray
    radii: np.ndarray

    @staticmethod
    def of(vertices: np.ndarray, faces: np.ndarray) -> TriangleFrames:
        """The frames of `faces` (triangles, 3) at `vertices` (vertices, 3) [m]; one without area holds no foot."""
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
        """(pairs,) bool, whether the foot of each of `points` (pairs, 3) lies in its triangle."""
        inside = np.zeros(len(points), dtype=bool)
        second = _at(self.second, triangles, points)
        chosen = np.flatnonzero((second >= 0.0) & (second <= 1.0))
        third = _at(self.third, triangles[chosen], points[chosen])
        inside[chosen] = (third >= 0.0) & (second[chosen] + third <= 1.0)
        return inside

    def heights(self, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(pairs,) [m] of `points` (pairs, 3) over the planes of `triangles` (pairs,)."""
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
