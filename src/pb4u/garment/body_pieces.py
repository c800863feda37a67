"""Bodies in the place of garments: an avatar that was exported with its clothes, or by itself."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from pb4u.body.length_units import UNITS, extent_of
from pb4u.garment.fit import RestBody
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import volume

# Shares of the wearer's height: how high what may be a body is at least and at most, how near it is to the skin that it
# covers, how near it lies to the skin that it is, and where the head begins and the feet end.
_HIGH, _HIGHEST, _NEAR, _ON_SKIN, _HEAD, _FEET = 0.85, 1.4, 0.02, 0.003, 0.9, 0.06
# Shares of the head, the feet and all skin that a body covers, and of its vertices that lie on the skin or beneath it:
# a garment that leaves neither face nor soles bare still lies outside.
_COVERED_HEAD, _COVERED_FEET, _COVERED, _SKIN = 0.9, 0.8, 0.7, 0.5
_SAMPLES = 4000
# Length of its borders, in heights of the wearer, that a body of another shape or in another pose has at most, and the
# share of the wearer's volume that it has at least: a shell of cloth encloses nothing.
_BORDERS, _VOLUME = 0.25, 0.4


def body_faces(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> np.ndarray:
    """Mask (faces,) bool of the pieces of a garment that are a body.

    They lie on the wearer's skin from head to foot, or have the height and volume of a body and no opening.

    Args:
        vertices: (vertices, 3) of the garment, in any unit and place.
        faces: (faces, 3) int64.
        body: the resting body.
    """
    none = np.zeros(len(faces), dtype=bool)
    if not len(faces):
        return none
    height, extent = float(np.ptp(body.vertices[:, 1])), extent_of(vertices[np.unique(faces)])
    sizes = [length for length in UNITS.values() if _HIGH <= extent * length / height <= _HIGHEST]
    masks = (_body_faces(length * vertices, faces, body) for length in sizes)
    return next((mask for mask in masks if mask.any()), none)


def _body_faces(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> np.ndarray:
    """The same of a garment in metres."""
    none, height = np.zeros(len(faces), dtype=bool), float(np.ptp(body.vertices[:, 1]))
    piece = Topology(faces, len(vertices)).piece_of_vertex[faces[:, 0]]
    for number in np.unique(piece):
        in_piece = piece == number
        if extent_of(vertices[np.unique(faces[in_piece])]) < _HIGH * height:
            continue
        if _is_full(vertices, faces[in_piece], body) or _is_body(vertices[np.unique(faces[in_piece])], body):
            none |= in_piece
    # One that was modelled in parts, such as head, hands and the rest.
    return none if none.any() or not _is_body(vertices[np.unique(faces)], body) else ~none


def _is_full(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> bool:
    """Whether a piece has no opening for a wearer, and the volume of one."""
    topology, height = Topology(faces, len(vertices)), float(np.ptp(body.vertices[:, 1]))
    border = topology.edges[topology.edge_face_counts == 1]
    length = float(np.linalg.norm(vertices[border[:, 0]] - vertices[border[:, 1]], axis=1).sum())
    enclosed = abs(volume(vertices, faces)) >= _VOLUME * abs(volume(body.vertices, body.faces))
    return length <= _BORDERS * height and enclosed


def _is_body(points: np.ndarray, body: RestBody) -> bool:
    """Whether points (points, 3) [m] are those of a body like the one that they lie on."""
    height, lowest = float(np.ptp(body.vertices[:, 1])), float(body.vertices[:, 1].min())
    every = max(1, len(body.vertices) // _SAMPLES)
    skin = body.vertices[::every]
    covered = cKDTree(points).query(skin)[0] < _NEAR * height
    level = (skin[:, 1] - lowest) / height
    for part, share in ((level > _HEAD, _COVERED_HEAD), (level < _FEET, _COVERED_FEET), (level >= 0.0, _COVERED)):
        if not part.any() or covered[part].mean() < share:
            return False
    distances = body.signed_distances(points[:: max(1, len(points) // _SAMPLES)])
    return bool((distances < _ON_SKIN * height).mean() >= _SKIN)


def named(mesh: PolygonMesh, polygons: np.ndarray) -> str | None:
    """Names of the objects that most of some polygons (n,) belong to; None where the file names none."""
    if mesh.object_of is None or not len(polygons):
        return None
    counts = np.bincount(mesh.object_of[polygons], minlength=len(mesh.objects))
    return " and ".join(mesh.objects[k] for k in np.flatnonzero(counts > 0.1 * counts.sum()).tolist()) or None
