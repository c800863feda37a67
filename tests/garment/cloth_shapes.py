"""Small garments and mesh files for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import write_obj

CLOTH = Material.isotropic(density=0.2, lame_mu=2e4, lame_lambda=3e4, bending=1e-5)


def tube_arrays(
    low: float = 0.5, high: float = 1.0, radius: float = 0.25, around: int = 40, rows: int = 20
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and quads (n, 4), facing outwards, of an upright tube; the last row is the highest."""
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    height = np.linspace(low, high, rows + 1)
    vertices = np.stack(
        [
            np.tile(radius * np.sin(angle), rows + 1),
            np.repeat(height, around),
            np.tile(radius * np.cos(angle), rows + 1),
        ],
        axis=1,
    )
    row, column = np.divmod(np.arange(around * rows), around)
    right = (column + 1) % around
    quads = np.stack([row * around + column, row * around + right], axis=1)
    return vertices, np.concatenate([quads, quads[:, ::-1] + around], axis=1)


def quad_tube(**shape: float) -> PolygonMesh:
    """A tube of quads with a UV seam: one column more of UVs than of vertices."""
    vertices, quads = tube_arrays(**shape)  # type: ignore[arg-type]
    around = int(quads[0, 3])
    row, column = np.divmod(np.arange(len(quads)), around)
    rows = len(quads) // around
    u, v = np.meshgrid(np.linspace(0, 1, around + 1), np.linspace(0, 1, rows + 1))
    first = row * (around + 1) + column
    uv_quads = np.stack([first, first + 1, first + around + 2, first + around + 1], axis=1)
    return PolygonMesh(vertices, tuple(quads), np.stack([u.ravel(), v.ravel()], axis=1), tuple(uv_quads))


def triangle_tube(**shape: float) -> PolygonMesh:
    """The same tube of triangles, without UVs."""
    vertices, quads = tube_arrays(**shape)  # type: ignore[arg-type]
    return PolygonMesh(vertices, tuple(np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])))


def with_open_seam(mesh: PolygonMesh, around: int = 40) -> PolygonMesh:
    """A tube of triangles whose last column has border vertices of its own, on top of the first column's."""
    faces = np.stack(mesh.polygons)
    column = faces % around
    wraps = np.ptp(column, axis=1) > 2
    first = np.arange(0, len(mesh.vertices), around)
    faces[wraps] = np.where(column[wraps] == 0, len(mesh.vertices) + faces[wraps] // around, faces[wraps])
    return PolygonMesh(np.concatenate([mesh.vertices, mesh.vertices[first]]), tuple(faces))


def tube_garment(**shape: float) -> Garment:
    """A tube as a garment."""
    mesh = triangle_tube(**shape)
    return Garment("tube", mesh.vertices, np.stack(mesh.polygons), CLOTH)


def saved(folder: Path, mesh: PolygonMesh, name: str = "tube.obj") -> Path:
    """The mesh as a file."""
    path = folder / name
    write_obj(path, mesh)
    return path
