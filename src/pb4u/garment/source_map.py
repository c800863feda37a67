"""The tie between the mesh that is simulated and the mesh its author made."""

from __future__ import annotations

import numpy as np

from pb4u.garment.garment import SourceMap
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.nearest_surface import TriangleSurface


def map_to_same(source: PolygonMesh, kept: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> SourceMap:
    """Source map of a simulated mesh that holds the `kept` source vertices, in order.

    Source vertices that are not simulated go with the nearest point of the mesh.
    """
    triangle = np.zeros(len(source.vertices), dtype=np.int64)
    barycentric = np.zeros((len(source.vertices), 3))
    corner_of = np.zeros(len(vertices), dtype=np.int64)
    corner_of[faces.reshape(-1)] = np.arange(faces.size)
    triangle[kept], column = np.divmod(corner_of, 3)
    barycentric[kept, column] = 1.0
    left = np.setdiff1d(np.arange(len(source.vertices)), kept)
    if len(left):
        hit = TriangleSurface(faces, len(vertices)).at(vertices).nearest(source.vertices[left])
        triangle[left], barycentric[left] = hit.triangle.numpy(), hit.barycentric.numpy()
    return SourceMap(source, triangle, barycentric)


def map_to_nearest(source: PolygonMesh, vertices: np.ndarray, faces: np.ndarray) -> SourceMap:
    """Source map by the nearest point of the simulated mesh (vertices, 3) [m] to each source vertex."""
    hit = TriangleSurface(faces, len(vertices)).at(vertices).nearest(source.vertices)
    return SourceMap(source, hit.triangle.numpy(), hit.barycentric.numpy())
