"""Surfaces that cross nowhere, in states that cross nowhere, and a slow readable search of what is near on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from tests.physics.shapes import sheet, tube

from pb4u.collision.crossings import self_crossings
from pb4u.collision.element_pairs import ElementPairs
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.garment.garment import Garment
from pb4u.geometry.topology import Topology


@dataclass(frozen=True, eq=False)
class Surface:
    """Garments joined to one surface: its rest shape, and `before`, a state that crosses nowhere."""

    rest: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    world: tuple[int, ...]
    before: np.ndarray

    @cached_property
    def edges(self) -> np.ndarray:
        return Topology(self.faces, len(self.rest)).edges

    @cached_property
    def tree(self) -> SurfaceTree:
        return SurfaceTree(self.rest, self.faces, self.edges, self.part, self.world)

    @cached_property
    def all_pairs(self) -> ElementPairs:
        """Every vertex with every face and every edge with every other of the same world that share no vertex."""
        world = np.asarray(self.world)[self.part]
        vertex, face = np.divmod(np.arange(len(self.rest) * len(self.faces)), len(self.faces))
        vertex_faces = np.column_stack([vertex, self.faces[face]])
        one, other = np.triu_indices(len(self.edges), 1)
        edge_edges = np.column_stack([self.edges[one], self.edges[other]])
        vertex_faces = vertex_faces[(vertex_faces[:, :1] != vertex_faces[:, 1:]).all(axis=1)]
        edge_edges = edge_edges[(edge_edges[:, :2, None] != edge_edges[:, None, 2:]).all(axis=(1, 2))]
        met = [rows[world[rows[:, 0]] == world[rows[:, 2]]] for rows in (vertex_faces, edge_edges)]
        pairs = ElementPairs(np.concatenate(met), len(met[0]), np.zeros(sum(map(len, met))))
        apart = self.part[pairs.corners[:, 0]] != self.part[pairs.corners[:, 2]]
        return ElementPairs(pairs.corners, pairs.vertex_faces, np.where(apart, np.inf, pairs.nearest(self.rest)[0]))

    def crossing(self, vertices: np.ndarray) -> int:
        """Crossing pairs of faces of one world, those that share a vertex as well, of positions as they are written."""
        written = vertices.astype(np.float32).astype(np.float64)
        face_world = np.asarray(self.world)[self.part[self.faces[:, 0]]]
        return sum(
            len(self_crossings(written, self.faces[face_world == world], sharing=True)) for world in set(self.world)
        )


def joined(garments: list[Garment], states: list[np.ndarray], worlds: tuple[int, ...] | None = None) -> Surface:
    """The garments as one surface, in their states (vertices, 3) [m]."""
    starts = np.cumsum([0, *(len(garment.vertices) for garment in garments)])
    return Surface(
        np.concatenate([garment.vertices for garment in garments]),
        np.concatenate([garment.faces + start for garment, start in zip(garments, starts[:-1], strict=True)]),
        np.repeat(np.arange(len(garments)), np.diff(starts)),
        worlds or (0,) * len(garments),
        np.concatenate(states),
    )


def lying(cells: int = 5, side: float = 0.2, height: float = 0.0, shear: float = 0.0) -> tuple[Garment, np.ndarray]:
    """A sheet, and where it lies flat at a height [m]; `shear` [m] puts its edges across those of others."""
    garment = sheet(cells, cells, side, side)
    return garment, garment.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0] + [shear, height, 0.6 * shear]


def stack(layers: int, gap: float, cells: int = 5, worlds: tuple[int, ...] | None = None) -> Surface:
    """Sheets over one another, each a little aside of the one below."""
    garments, states = zip(
        *(lying(cells, height=gap * layer, shear=0.013 * layer) for layer in range(layers)), strict=True
    )
    return joined(list(garments), list(states), worlds)


def folded(pleats: int, gap: float, cells: int = 3, side: float = 0.1) -> Surface:
    """One long strip laid to and fro over itself, its layers `gap` [m] apart."""
    columns = cells * pleats
    garment = sheet(columns, cells, side * pleats, side)
    along = garment.vertices[:, 0] / side
    pleat = np.minimum(along.astype(int), pleats - 1)
    share = along - pleat
    x = side * np.where(pleat % 2 == 0, share, 1.0 - share)
    # Every pleat rises evenly, so that layers meet in the folds and nowhere else.
    return joined([garment], [np.column_stack([x, gap * along, garment.vertices[:, 1]])])


def nested(gap: float, around: int = 12, along: int = 4) -> Surface:
    """A tube in a wider one, both a little crumpled."""
    garments = [tube(around, along, radius, 0.3) for radius in (0.1, 0.1 + gap)]
    rng = np.random.default_rng(0)
    rumple = 0.1 * gap * rng.standard_normal((2, len(garments[0].vertices), 3)).clip(-1.0, 1.0)
    return joined(garments, [garment.vertices + part for garment, part in zip(garments, rumple, strict=True)])
