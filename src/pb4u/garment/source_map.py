"""Maps from the author's mesh of a garment to the mesh that is simulated, and garments with other triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.collision.remeshing import remesh
from pb4u.errors import InputError
from pb4u.garment.garment import Garment, SourceMap
from pb4u.garment.pins import resolve_pins
from pb4u.geometry.mesh_file import PolygonMesh


def remeshed(garment: Garment, triangles: int | None) -> Garment:
    """The garment with about `triangles` triangles; its parts, pins, skinning and author's mesh are transferred.

    UVs and images stay with the author's mesh, to which exports go back.

    Args:
        garment: its `vertices` are its rest shape.
        triangles: wanted number; None, or the present number, returns the garment unchanged.

    Raises:
        InputError: less than one triangle, or a garment of flat pieces, whose grain a new mesh would lose.
    """
    if triangles is None or triangles == garment.triangle_count:
        return garment
    if triangles < 1:
        raise InputError(f"The number of triangles must be 1 or more, not {triangles}.")
    if garment.rest_uv is not None:
        raise InputError(
            f"{garment.name} is sewn of flat panels, so it cannot be remeshed once worn; dress it again with "
            f"{triangles} triangles."
        )
    vertices, faces = remesh(garment.vertices, garment.faces, triangles)

    def map_of(mesh: PolygonMesh) -> SourceMap:
        return SourceMap(mesh, *nearest_places(mesh.vertices, vertices, faces))

    skinning = garment.skinning
    if skinning is not None:
        triangle, barycentric = nearest_places(vertices, garment.vertices, garment.faces)
        skinning = skinning.at(garment.faces[triangle], barycentric)
    cloth, layers, trims, pieces = garment.face_material, garment.material_layers, garment.trims, garment.parts
    place = np.full(len(garment.faces), -1)
    for number, piece in enumerate(pieces.values()):
        place[piece] = number
    if cloth is not None or trims is not None or pieces:
        nearest = nearest_places(vertices[faces].mean(axis=1), garment.vertices, garment.faces)[0]
        cloth, layers = (None if values is None else values[nearest] for values in (cloth, layers))
        place, trims = place[nearest], None if trims is None else trims.at(nearest)
    author = garment.mesh if garment.source is None else garment.source.source
    other = replace(
        garment, vertices=vertices, faces=faces, pinned=np.zeros(len(vertices), dtype=bool), uvs=None, uv_faces=None,
        appearances=None, source=map_of(author), coarse_edges=(), skinning=skinning, trims=trims,
        face_material=cloth, material_layers=layers, pieces=tuple(pieces), piece_of_face=place if pieces else None,
    )  # fmt: skip
    if not garment.pinned.any():
        return other
    # Its pins count its own vertices, not the author's.
    return other.with_pins(resolve_pins(np.flatnonzero(garment.pinned), replace(other, source=map_of(garment.mesh))))


def map_to_same(source: PolygonMesh, simulated: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> SourceMap:
    """Source map of a mesh that contains some vertices of its source, in order; the others are attached to it.

    Args:
        source: the author's mesh.
        simulated: (vertices,) int64 vertices of the source that the mesh holds.
        vertices: (vertices, 3) of the mesh [m].
        faces: (faces, 3) int64 of the mesh.
    """
    triangle = np.zeros(len(source.vertices), dtype=np.int64)
    barycentric = np.zeros((len(source.vertices), 3))
    corner_of = np.zeros(len(vertices), dtype=np.int64)
    corner_of[faces.reshape(-1)] = np.arange(faces.size)
    triangle[simulated], column = np.divmod(corner_of, 3)
    barycentric[simulated, column] = 1.0
    others = np.setdiff1d(np.arange(len(source.vertices)), simulated)
    if len(others):
        triangle[others], barycentric[others] = nearest_places(source.vertices[others], vertices, faces)
    return SourceMap(source, triangle, barycentric)


def nearest_places(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of a mesh nearest to given points.

    Args:
        points: (points, 3) [m].
        vertices: (vertices, 3) of the mesh [m].
        faces: (faces, 3) int64.

    Returns:
        Triangle (points,) int64 and barycentric coordinates (points, 3) in it.
    """
    hit = TriangleSurface(faces, len(vertices)).at(vertices).nearest(points)
    return hit.triangle.numpy(), hit.barycentric.numpy()
