"""Edges of self-contact as the released ContourCraft has them: directed, one a face, also to where pins will be.

Two faces with the same nearest corner give two edges, none is made back, and vertices on an open contour are attracted
too (reference 6.1, 6.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import torch

from pb4u.baselines.self_contact import ATTRACTION, REPULSION, PackProximity
from pb4u.geometry.proximity.intersection_contours import ContourFinder, Contours
from pb4u.geometry.proximity.self_proximity import facing_pairs
from pb4u.geometry.topology import Topology
from pb4u.graph.builder import FoundEdges
from pb4u.graph.incidence import incidence
from pb4u.graph.pins import SeenGarments
from pb4u.scene.packed import PackedGarments

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


@dataclass(frozen=True)
class DirectedSelfEdges:
    """Rule for edges of self-contact of the released ContourCraft."""

    def finder(self, pack: PackProximity, radius: float) -> DirectedProximityEdges:
        """Finder of the edges of a pack.

        Args:
            pack: the garments.
            radius: largest height over a face [m].
        """
        return DirectedProximityEdges(pack.garments, radius)


class DirectedProximityEdges:
    """Directed edges from vertices to the nearest corner of the faces that they stand over, world by world.

    Args:
        garments: the pack.
        radius: largest height over a face [m].
    """

    def __init__(self, garments: PackedGarments, radius: float) -> None:
        self._radius = radius
        self._count = garments.vertex_count
        faces = garments.faces.cpu().numpy()
        world = garments.vertex_world.cpu().numpy()[faces[:, 0]] if len(faces) else faces[:, 0]
        self._worlds = [
            _World(start, stop, faces[world == number] - start)
            for number, (start, stop) in enumerate(pairwise(garments.world_offsets))
        ]

    def found(self, seen: SeenGarments) -> Mapping[str, FoundEdges]:
        """Repulsion and attraction edges.

        Args:
            seen: garments at the start of the step.
        """
        positions, velocities, targets = (
            values.detach().to("cpu", torch.float64).numpy()
            for values in (seen.positions, seen.velocities, seen.targets)
        )
        pinned = seen.pinned.cpu().numpy()[:, 0]
        parts = [world.edges(positions, targets + velocities, pinned, self._radius) for world in self._worlds]
        rows = {
            name: np.concatenate([part[name] for part in parts]) for name in ("sender", "receiver", "future", "kind")
        }
        device = seen.positions.device
        return {
            kind: self._directed(rows, rows["kind"] == attracted, device, seen.positions.dtype)
            for kind, attracted in ((REPULSION, False), (ATTRACTION, True))
        }

    def _directed(
        self, rows: Mapping[str, np.ndarray], chosen: np.ndarray, device: torch.device, dtype: torch.dtype
    ) -> FoundEdges:
        order = np.flatnonzero(chosen)
        order = order[np.argsort(rows["receiver"][order], kind="stable")]
        sender, receiver = (torch.from_numpy(rows[name][order]).to(device) for name in ("sender", "receiver"))
        future = torch.from_numpy(rows["future"][order]).to(device, dtype)[:, None]
        return FoundEdges(incidence(sender, self._count), incidence(receiver, self._count), future)


class _World:
    """The cloth of one world, which can touch itself."""

    def __init__(self, start: int, stop: int, faces: np.ndarray) -> None:
        self.rows, self.faces = slice(start, stop), faces
        self.contours = ContourFinder(faces, stop - start)

    def edges(
        self, positions: np.ndarray, future: np.ndarray, pinned: np.ndarray, radius: float
    ) -> dict[str, np.ndarray]:
        now, then, held = positions[self.rows], future[self.rows], pinned[self.rows]
        vertex, face, _ = facing_pairs(now, self.faces, radius)
        ahead, ahead_face = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        if held.any():
            ahead, ahead_face, _ = facing_pairs(then, self.faces, radius)
            ahead, ahead_face = ahead[held[ahead]], ahead_face[held[ahead]]
        sender, over = np.concatenate([vertex, ahead]), np.concatenate([face, ahead_face])
        receiver = np.concatenate([self._corner(now, vertex, face), self._corner(then, ahead, ahead_face)])
        kept, attracted = self._kinds(now, sender, over)
        return {
            "sender": sender[kept] + self.rows.start,
            "receiver": receiver[kept] + self.rows.start,
            "future": np.repeat([False, True], [len(vertex), len(ahead)])[kept],
            "kind": attracted[kept],
        }

    def _corner(self, positions: np.ndarray, vertex: np.ndarray, face: np.ndarray) -> np.ndarray:
        """The corner of each face that is nearest to its vertex."""
        corners = self.faces[face]
        away = np.linalg.norm(positions[corners] - positions[vertex][:, None], axis=2)
        nearest: np.ndarray = np.take_along_axis(corners, away.argmin(axis=1)[:, None], axis=1)[:, 0]
        return nearest

    def _kinds(self, now: np.ndarray, vertex: np.ndarray, face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which pairs are kept, and which of them attract, (pairs,) bool each."""
        sides = ContourSides.of(self.contours, now)
        enclosed = sides.enclosed.getnnz(axis=1)[vertex] > 0
        matching = sides.reached[vertex].multiply(sides.touched[face]).getnnz(axis=1) > 0
        return ~enclosed | matching, enclosed | sides.on_open[vertex]


@dataclass(frozen=True, eq=False)
class ContourSides:
    """The two surfaces that meet at every intersection contour, each with what it cuts off.

    A surface is closed where its edges that cross the other one cut it into exactly two parts; it encloses the smaller.

    Args:
        enclosed: (vertices, sides) bool, vertices that a side encloses.
        reached: (vertices, sides) bool, those and the ends of the edges that cross at a side.
        touched: (faces, sides) bool, faces that a side pierces, or that hold a vertex which the other side encloses.
        on_open: (vertices,) bool, ends of edges that cross at an open side and at no closed one.
    """

    enclosed: csr_matrix
    reached: csr_matrix
    touched: csr_matrix
    on_open: np.ndarray

    @classmethod
    def of(cls, finder: ContourFinder, vertices: np.ndarray) -> ContourSides:
        """The sides of all contours of a mesh.

        Args:
            finder: finds the contours.
            vertices: (vertices, 3) [m].
        """
        contours, mesh = finder.find(vertices), finder.topology
        side, side_contour = _sides(contours, mesh)
        count, vertex_count = len(side_contour), mesh.vertex_count
        enclosed, closed = _cut_off(contours, mesh, side, count)
        other = _table(side_contour, np.arange(count), (contours.count, count))
        other = (other.T @ other).tolil()
        other.setdiag(False)
        corners = _table(
            np.repeat(np.arange(len(mesh.faces)), 3), mesh.faces.reshape(-1), (len(mesh.faces), vertex_count)
        )
        touched = _table(contours.faces, side, (len(mesh.faces), count)) + corners @ enclosed @ other.tocsr()
        on_open, on_closed = np.zeros(vertex_count, dtype=bool), np.zeros(vertex_count, dtype=bool)
        on_open[contours.edges[~closed[side]]] = True
        on_closed[contours.edges[closed[side]]] = True
        at_ends = _table(contours.edges.reshape(-1), np.repeat(side, 2), enclosed.shape)
        return cls(enclosed, enclosed + at_ends, touched, on_open & ~on_closed)


def _sides(contours: Contours, mesh: Topology) -> tuple[np.ndarray, np.ndarray]:
    """Side (crossings,) int64 of the edge at each crossing, and the contour of each side (sides,).

    Along a contour, the triangles at one crossed edge belong to one surface.
    """
    edges = _edge_numbers(contours.edges, mesh)
    of_edge = np.argsort(mesh.face_edges.reshape(-1), kind="stable")
    first = np.searchsorted(mesh.face_edges.reshape(-1)[of_edge], np.arange(len(mesh.edges) + 1))
    counts = np.diff(first)[edges]
    crossing = np.repeat(np.arange(len(edges)), counts)
    within = np.arange(len(crossing)) - np.repeat(np.cumsum(counts) - counts, counts)
    triangle = of_edge[np.repeat(first[edges], counts) + within] // 3
    places, place = np.unique(contours.contour[crossing] * len(mesh.faces) + triangle, return_inverse=True)
    at_first = place[np.cumsum(counts) - counts]
    links = _table(at_first[crossing], place, (len(places), len(places)))
    # Scipy is absent from machines that only train other networks.
    from scipy.sparse.csgraph import connected_components

    count, surface = connected_components(links, directed=False)
    side_contour = np.zeros(count, dtype=np.int64)
    side_contour[surface] = places // len(mesh.faces)
    return surface[at_first], side_contour


def _cut_off(contours: Contours, mesh: Topology, side: np.ndarray, count: int) -> tuple[csr_matrix, np.ndarray]:
    """Vertices (vertices, sides) that each side encloses, and which sides are closed (sides,) bool."""
    edges = _edge_numbers(contours.edges, mesh)
    whole = np.ones(len(mesh.edges), dtype=bool)
    whole[edges] = False
    kept = mesh.edges[whole]
    # Parts of the mesh with every crossed edge cut; a side alone cuts fewer, so its parts are joined parts of these.
    from scipy.sparse.csgraph import connected_components

    parts, part = connected_components(_table(kept[:, 0], kept[:, 1], (mesh.vertex_count,) * 2), directed=False)
    sizes, ends = np.bincount(part, minlength=parts), part[contours.edges]
    rows, columns, closed = [], [], np.zeros(count, dtype=bool)
    # An edge that crosses more than twice is cut by the first of its contours alone; seen in one golden step.
    often = np.bincount(edges, minlength=len(mesh.edges)) > 2
    first = np.full(len(mesh.edges), contours.count)
    np.minimum.at(first, edges, contours.contour)
    cuts = ~often[edges] | (contours.contour == first[edges])
    for number in range(count):
        own = np.isin(edges, edges[(side == number) & cuts])
        others = ends[~own]
        _, joined = connected_components(_table(others[:, 0], others[:, 1], (parts, parts)), directed=False)
        reached = np.unique(joined[ends[own]])
        if len(reached) != 2:
            continue
        closed[number] = True
        size = np.bincount(joined, weights=sizes)
        inside = np.flatnonzero(joined[part] == reached[size[reached].argmin()])
        rows.append(inside)
        columns.append(np.full(len(inside), number))
    none = [np.zeros(0, dtype=np.int64)]
    return _table(np.concatenate(rows or none), np.concatenate(columns or none), (mesh.vertex_count, count)), closed


def _edge_numbers(edges: np.ndarray, mesh: Topology) -> np.ndarray:
    """Number (edges,) int64 of each of the mesh's edges `edges` (edges, 2)."""
    keys = mesh.edges[:, 0] * mesh.vertex_count + mesh.edges[:, 1]
    order = np.argsort(keys)
    return order[np.searchsorted(keys[order], edges[:, 0] * mesh.vertex_count + edges[:, 1])]


def _table(rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> csr_matrix:
    """A matrix of booleans, True at the given places."""
    from scipy.sparse import csr_matrix

    return csr_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=shape)
