"""Which vertices of a body cloth can reach."""

from __future__ import annotations

import numpy as np

from pb4u.geometry.triangle_mesh import face_areas

# For cloth to reach a vertex it must be free so far along its normal [m], and less than this share of its sky hidden.
_CLEARANCE = 1e-3
_HIDDEN = 0.95


def reachable(
    vertices: np.ndarray, faces: np.ndarray, candidates: np.ndarray | None = None, rays: int = 200
) -> np.ndarray:
    """Mask of the vertices that cloth can reach: not inside other skin and not in a cavity such as the mouth.

    A vertex is inside if the winding number just outside of it is 1 or more, and in a cavity if other skin blocks
    nearly all rays from it.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64, counter-clockwise seen from outside.
        candidates: (vertices,) bool, the vertices to test; by default all.
        rays: number of rays cast from each vertex; 200 take half a millisecond a vertex.

    Returns:
        (vertices,) bool, False for vertices that are not candidates.
    """
    import igl

    rows = np.arange(len(vertices)) if candidates is None else np.flatnonzero(candidates)
    normals = igl.per_vertex_normals(vertices, faces)[rows]
    places = vertices[rows]
    free = igl.fast_winding_number(vertices, faces, places + _CLEARANCE * normals) <= 0.5
    rows, places, normals = rows[free], places[free], normals[free]
    occlusion = igl.ambient_occlusion(vertices, faces, places + 1e-4 * normals, normals, rays)
    result = np.zeros(len(vertices), dtype=bool)
    result[rows] = np.asarray(occlusion).reshape(-1) < _HIDDEN
    return result


def share_out_of_contact(vertices: np.ndarray, faces: np.ndarray, contact: np.ndarray) -> float:
    """Share of a body's area that takes no part in contact.

    Args:
        vertices: (vertices, 3) at rest [m].
        faces: (faces, 3) int64.
        contact: (vertices,) bool.
    """
    area = face_areas(vertices, faces)
    return float(area[~contact[faces].all(axis=1)].sum() / max(float(area.sum()), 1e-30))
