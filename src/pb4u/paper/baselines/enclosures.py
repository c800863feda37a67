"""What of a surface has passed through it: the vertices that its intersection contours cut off (reference 6.2).

Two rules, of the same form: column by column of a contour, whichever surface is cut apart there, or of each of the two
surfaces that meet at it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pb4u.geometry.topology import Topology, connected_labels
from pb4u.paper.baselines.intersection_contours import Contours

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


@dataclass(frozen=True, eq=False)
class Enclosures:
    """Vertices that intersection contours enclose, a column a contour.

    Args:
        enclosed: (vertices, columns) bool, vertices on the smaller side of the cut surface.
        reached: (vertices, columns) bool, vertices of the touched faces.
        touched: (faces, columns) bool, faces that the contour passes through or that have an enclosed vertex.
        at_open: (vertices,) bool, vertices at a contour that separates nothing, as far as the rule counts them.
    """

    enclosed: csr_matrix
    reached: csr_matrix
    touched: csr_matrix
    at_open: np.ndarray

    def told(self, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which pairs of a vertex and a face count, and which of them attract, (pairs,) bool each.

        A vertex that is enclosed has passed through the faces of its contour; its pairs with others do not count.

        Args:
            vertices: (pairs,) int64.
            faces: (pairs,) int64.
        """
        enclosed = (self.enclosed.getnnz(axis=1) > 0)[vertices]
        passed = np.flatnonzero(enclosed)
        free = ~enclosed
        free[passed] = self.reached[vertices[passed]].multiply(self.touched[faces[passed]]).getnnz(axis=1) > 0
        return free, enclosed | self.at_open[vertices]


CutOff = Callable[[Contours, Topology], Enclosures]


def by_contour(contours: Contours, topology: Topology) -> Enclosures:
    """Columns are contours; vertices are enclosed if removing all crossed edges separates them from the surface.

    Args:
        contours: contours of what crosses.
        topology: edges and faces of the surface.
    """
    edges, vertex_count = topology.edges, topology.vertex_count
    part = _parts(contours, topology)
    size = np.bincount(part)
    a, b = part[edges[contours.edges]].T
    parts = np.concatenate([a[size[a] < size[b]], b[size[b] < size[a]]])
    columns = np.concatenate([contours.contour[size[a] < size[b]], contours.contour[size[b] < size[a]]])
    inside = _table(parts, columns, (len(size), contours.count))
    enclosed = _table(np.arange(vertex_count), part, (vertex_count, len(size))) @ inside
    crossing, at_edge = topology.faces_at(contours.edges)
    run_through = _table(
        np.concatenate([contours.faces, at_edge]),
        np.concatenate([contours.contour, contours.contour[crossing]]),
        (len(topology.faces), contours.count),
    )
    touched = run_through + _corners(topology) @ enclosed
    return Enclosures(enclosed, enclosed, touched, np.zeros(vertex_count, dtype=bool))


def by_side(contours: Contours, topology: Topology) -> Enclosures:
    """Columns are the two surfaces at each contour; each encloses the part that the other cuts off.

    If the edges that cross the other surface divide a surface into exactly two parts, it encloses the smaller one.
    It touches the faces that it pierces, and faces with a vertex that the other side encloses.

    Args:
        contours: contours of what crosses.
        topology: edges and faces of the surface.
    """
    side, side_contour = _sides(contours, topology)
    count, vertex_count = len(side_contour), topology.vertex_count
    enclosed, closed = _cut_off(contours, topology, side, count)
    other = _table(side_contour, np.arange(count), (contours.count, count))
    other = (other.T @ other).tolil()
    other.setdiag(False)
    pierced = _table(contours.faces, side, (len(topology.faces), count))
    ends = topology.edges[contours.edges]
    at_open, at_closed = np.zeros(vertex_count, dtype=bool), np.zeros(vertex_count, dtype=bool)
    at_open[ends[~closed[side]]] = True
    at_closed[ends[closed[side]]] = True
    reached = enclosed + _table(ends.reshape(-1), np.repeat(side, 2), enclosed.shape)
    touched = pierced + _corners(topology) @ enclosed @ other.tocsr()
    return Enclosures(enclosed, reached, touched, at_open & ~at_closed)


def _sides(contours: Contours, topology: Topology) -> tuple[np.ndarray, np.ndarray]:
    """Side (crossings,) int64 of the edge at each crossing, and the contour of each side (sides,).

    Along a contour, the triangles at one crossed edge belong to one surface.
    """
    crossing, triangle = topology.faces_at(contours.edges)
    faces = max(len(topology.faces), 1)
    places, place = np.unique(contours.contour[crossing] * faces + triangle, return_inverse=True)
    _, first = np.unique(crossing, return_index=True)
    at_first = place[first]
    surface = connected_labels(len(places), at_first[crossing], place)
    side_contour = np.zeros(surface.max(initial=-1) + 1, dtype=np.int64)
    side_contour[surface] = places // faces
    return surface[at_first], side_contour


def _cut_off(contours: Contours, topology: Topology, side: np.ndarray, count: int) -> tuple[csr_matrix, np.ndarray]:
    """Vertices (vertices, sides) that each side encloses, and which sides are closed (sides,) bool."""
    edges = contours.edges
    # A side alone cuts fewer edges than all do, so that its parts are joined parts of these.
    part = _parts(contours, topology)
    sizes, ends = np.bincount(part), part[topology.edges[edges]]
    rows, columns, closed = [], [], np.zeros(count, dtype=bool)
    # An edge that crosses more than twice is cut by the first of its contours alone; seen in one golden step.
    often = np.bincount(edges, minlength=len(topology.edges)) > 2
    first = np.full(len(topology.edges), contours.count)
    np.minimum.at(first, edges, contours.contour)
    cuts = ~often[edges] | (contours.contour == first[edges])
    for number in range(count):
        is_cut = np.isin(edges, edges[(side == number) & cuts])
        joined = connected_labels(len(sizes), *ends[~is_cut].T)
        reached = np.unique(joined[ends[is_cut]])
        if len(reached) != 2:
            continue
        closed[number] = True
        size = np.bincount(joined, weights=sizes)
        inside = np.flatnonzero(joined[part] == reached[size[reached].argmin()])
        rows.append(inside)
        columns.append(np.full(len(inside), number))
    none = [np.zeros(0, dtype=np.int64)]
    shape = (topology.vertex_count, count)
    return _table(np.concatenate(rows or none), np.concatenate(columns or none), shape), closed


def _parts(contours: Contours, topology: Topology) -> np.ndarray:
    """Part (vertices,) of the surface that each vertex is on when every crossed edge is cut."""
    is_uncut = np.ones(len(topology.edges), dtype=bool)
    is_uncut[contours.edges] = False
    return connected_labels(topology.vertex_count, *topology.edges[is_uncut].T)


def _corners(topology: Topology) -> csr_matrix:
    """The vertices of each face, (faces, vertices) bool."""
    count = len(topology.faces)
    return _table(np.repeat(np.arange(count), 3), topology.faces.reshape(-1), (count, topology.vertex_count))


def _table(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> csr_matrix:
    """A matrix of booleans, True at the given places."""
    # Scipy is absent from machines that only train other networks.
    from scipy.sparse import csr_matrix

    return csr_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=shape)
