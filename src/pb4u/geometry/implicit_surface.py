"""A smooth surface given as the zero set of a field on a lattice, trimmed where a second field is positive."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import face_cross_products


@dataclass(frozen=True, eq=False)
class Lattice:
    """Points on a regular grid.

    Args:
        origin: (3,) lowest corner [m].
        spacing: distance between neighbours [m].
        shape: number of points along x, y, z.
    """

    origin: np.ndarray
    spacing: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, lowest: np.ndarray, highest: np.ndarray, spacing: float) -> Lattice:
        """The lattice that covers a box, with its points at whole multiples of `spacing`.

        Args:
            lowest: (3,) lowest corner of the box [m].
            highest: (3,) highest corner [m].
            spacing: distance between neighbours [m].
        """
        first = np.floor(np.asarray(lowest) / spacing).astype(int)
        last = np.ceil(np.asarray(highest) / spacing).astype(int)
        nx, ny, nz = (last - first + 1).tolist()
        return cls(first * spacing, spacing, (nx, ny, nz))

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates [m] along x (nx, 1, 1), y (1, ny, 1) and z (1, 1, nz), ready to broadcast."""
        x, y, z = (self.origin[k] + self.spacing * np.arange(self.shape[k]) for k in range(3))
        return x[:, None, None], y[None, :, None], z[None, None, :]

    @property
    def points(self) -> np.ndarray:
        """Positions (nx * ny * nz, 3) [m] of all points, z fastest."""
        x, y, z = np.broadcast_arrays(*self.axes)
        return np.column_stack([x.reshape(-1), y.reshape(-1), z.reshape(-1)])


class _SmoothField:
    """Cubic spline through the values of a lattice; its gradient is interpolated linearly."""

    def __init__(self, lattice: Lattice, values: np.ndarray) -> None:
        from scipy.ndimage import spline_filter

        self.lattice = lattice
        self._coefficients = spline_filter(values.astype(np.float64), order=3, mode="nearest").astype(np.float32)
        self._gradient = [g.astype(np.float32) for g in np.gradient(values.astype(np.float32), lattice.spacing)]

    def value_and_gradient(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from scipy.ndimage import map_coordinates

        place = ((points - self.lattice.origin) / self.lattice.spacing).T
        value = map_coordinates(self._coefficients, place, order=3, mode="nearest", prefilter=False, output=np.float64)
        slopes = [map_coordinates(g, place, order=1, mode="nearest", output=np.float64) for g in self._gradient]
        return value, np.column_stack(slopes)


class ImplicitSurface:
    """The part of {shape = 0} where cut < 0; outside is where the shape field is positive.

    Args:
        lattice: sample points of the fields.
        shape: field (nx, ny, nz) [m], about a distance near its zero set.
        cut: field (nx, ny, nz) [m], about a distance near its zero set, or None for a closed surface.
    """

    def __init__(self, lattice: Lattice, shape: np.ndarray, cut: np.ndarray) -> None:
        self.lattice = lattice
        self._values = shape
        self._shape = _SmoothField(lattice, shape)
        self._cut = _SmoothField(lattice, cut)

    def project(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Points moved along the gradient on to the surface, two cells at most each.

        Args:
            points: (n, 3) near the surface [m].
            normals: (n, 3), not used: the gradient gives the side.

        Returns:
            (n, 3) [m].
        """
        limit = self.lattice.spacing
        for _ in range(2):
            value, gradient = self._shape.value_and_gradient(points)
            square = np.maximum((gradient**2).sum(axis=1), 0.04)
            step = np.clip(value / square, -2 * limit, 2 * limit)
            points = points - step[:, None] * gradient
        return points

    def project_border(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) [m] projected to the nearest points of the trimming curves, where both fields vanish.

        Args:
            points: (n, 3) [m] near the border.
        """
        limit = 2 * self.lattice.spacing
        for _ in range(4):
            f, df = self._shape.value_and_gradient(points)
            g, dg = self._cut.value_and_gradient(points)
            a, b, c = (df * df).sum(1), (df * dg).sum(1), (dg * dg).sum(1)
            a, c = np.maximum(a, 0.04), np.maximum(c, 0.04)
            determinant = np.maximum(a * c - b * b, 0.05 * a * c)
            s, t = (c * f - b * g) / determinant, (a * g - b * f) / determinant
            step = s[:, None] * df + t[:, None] * dg
            length = np.linalg.norm(step, axis=1, keepdims=True)
            points = points - step * np.minimum(1.0, limit / np.maximum(length, 1e-12))
        return points

    @cached_property
    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (vertices, 3) [m] and outward faces (faces, 3) int64 of the largest piece: fine, but uneven."""
        vertices, faces = self._contour()
        value, _ = self._cut.value_and_gradient(vertices)
        vertices, faces = _clip(vertices, faces, value)
        pieces = Topology(faces, len(vertices)).piece_of_vertex
        largest = np.argmax(np.bincount(pieces[faces[:, 0]]))
        faces = faces[pieces[faces[:, 0]] == largest]
        used = np.unique(faces)
        return vertices[used], np.searchsorted(used, faces)

    def _contour(self) -> tuple[np.ndarray, np.ndarray]:
        # pyvista would do the same, and takes longer to import than the whole shape to make.
        from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
        from vtkmodules.vtkCommonDataModel import vtkImageData
        from vtkmodules.vtkFiltersCore import vtkMarchingCubes

        grid, contour = vtkImageData(), vtkMarchingCubes()
        grid.SetDimensions(self.lattice.shape)
        grid.SetSpacing((self.lattice.spacing,) * 3)
        grid.SetOrigin(self.lattice.origin.tolist())
        grid.GetPointData().SetScalars(numpy_to_vtk(self._values.reshape(-1, order="F")))
        contour.SetInputData(grid)
        contour.SetValue(0, 0.0)
        contour.ComputeNormalsOff()
        contour.Update()
        surface = contour.GetOutput()
        faces = vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).astype(np.int64).reshape(-1, 3)
        points = vtk_to_numpy(surface.GetPoints().GetData()).astype(np.float64)
        vertices, same = np.unique(points, axis=0, return_inverse=True)
        faces = same.reshape(-1)[faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
        _, gradient = self._shape.value_and_gradient((a + b + c) / 3.0)
        outward = np.einsum("ij,ij->", face_cross_products(vertices, faces), gradient)
        return vertices, faces if outward > 0 else faces[:, ::-1].copy()


def _clip(vertices: np.ndarray, faces: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of a mesh where the linear interpolation of `value` (vertices,) is below zero."""
    inside = value < 0.0
    count = inside[faces].sum(axis=1)
    crossing = faces[(count == 1) | (count == 2)]
    # Turn each crossing face so that its odd vertex (alone on its side) comes first.
    inner = inside[crossing]
    single = np.where(inner.sum(axis=1) == 1, np.argmax(inner, axis=1), np.argmin(inner, axis=1))
    corner = (single[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(crossing, corner, 1).T

    pairs = np.sort(np.concatenate([np.column_stack([a, b]), np.column_stack([a, c])]), axis=1)
    unique, of_pair = np.unique(pairs, axis=0, return_inverse=True)
    of_pair = of_pair.reshape(-1)
    p, q = unique.T
    along = np.clip(value[p] / (value[p] - value[q]), 0.02, 0.98)
    cuts = vertices[p] + along[:, None] * (vertices[q] - vertices[p])
    ab, ac = of_pair[: len(a)] + len(vertices), of_pair[len(a) :] + len(vertices)
    keep_tip = inside[a]
    tip = np.column_stack([a, ab, ac])[keep_tip]
    base_one = np.column_stack([ab, b, c])[~keep_tip]
    base_two = np.column_stack([ab, c, ac])[~keep_tip]
    faces = np.concatenate([faces[count == 3], tip, base_one, base_two])
    vertices = np.concatenate([vertices, cuts])
    used = np.unique(faces)
    return vertices[used], np.searchsorted(used, faces)
