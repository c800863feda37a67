"""Seams that a mesh file gives as threads: lines between vertices of borders, as those that Blender's cloth sews."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import diags
from scipy.sparse.linalg import spsolve

from pb4u.garment.garment import Garment
from pb4u.garment.source_surface import SourceSurface
from pb4u.garment.tacks import FARTHEST, sewn, tacked
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.topology import connected_labels, neighbour_mean


def sewable_threads(surface: SourceSurface) -> np.ndarray:
    """Ends (threads, 2) int64 of the threads that are sewn: between borders, short, of a seam that cloth can have.

    Args:
        surface: the author's mesh.
    """
    threads = surface.unsewn
    if not len(threads):
        return threads
    ends = surface.source.vertices[threads]
    near = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) <= FARTHEST
    threads = threads[near & surface.topology.border_vertices[threads].all(axis=1)]
    return threads if sewn(surface.faces, len(surface.source.vertices), threads) is not None else threads[:0]


def drawn_together(surface: SourceSurface, threads: np.ndarray) -> PolygonMesh:
    """The mesh with both ends of each thread merged at their midpoint; the cloth around follows smoothly.

    Args:
        surface: the author's mesh.
        threads: (threads, 2) int64 vertices, as from `sewable_threads`.
    """
    source, topology = surface.source, surface.topology
    count = len(source.vertices)
    label = connected_labels(count, *threads.T)
    members = np.bincount(label)
    middle = np.stack([np.bincount(label, axis) for axis in source.vertices.T], axis=1) / members[:, None]
    at_seam = np.zeros(count, dtype=bool)
    at_seam[threads] = True
    moves = np.where(at_seam[:, None], middle[label] - source.vertices, 0.0)
    sewn_pieces = np.unique(topology.piece_of_vertex[threads])
    free = np.isin(topology.piece_of_vertex, sewn_pieces) & ~at_seam
    if free.any():
        smooth = (diags(np.ones(count)) - neighbour_mean(topology)).tocsr()[free]
        moves[free] = spsolve(smooth[:, free].tocsc(), -(smooth[:, at_seam] @ moves[at_seam])).reshape(-1, 3)
    first = np.unique(label, return_index=True)[1]
    polygons = tuple(first[label[polygon]] for polygon in source.polygons)
    return replace(source, vertices=source.vertices + moves, polygons=polygons, lines=None)


def with_sewn_threads(garment: Garment, surface: SourceSurface, simulated: np.ndarray) -> Garment:
    """The garment sewn by the threads of its file; its triangles keep their rest shapes.

    Args:
        garment: of the author's triangles.
        surface: the author's mesh.
        simulated: (vertices,) int64 the author's vertex of each of the garment's.
    """
    threads = sewable_threads(surface)
    if not len(threads):
        return garment
    places = drawn_together(surface, threads).vertices[simulated]
    apart = replace(garment, vertices=places, rest_uv=garment.rest_shape, grainless=not garment.has_grain)
    return tacked(apart, [(int(a), int(b)) for a, b in threads])
