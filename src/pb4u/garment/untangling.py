"""Takes apart what of a cloth has passed through itself, by shortening the lines in which it crosses.

Volino and Magnenat-Thalmann, "Resolving surface collisions through intersection contour minimization", 2006: where an
edge passes through a face, both are moved against each other so that the line in which their sheets intersect becomes
shorter; no inside or outside is asked for, so it works at hems and on open cloth, and on any number of layers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import diags
from scipy.sparse.linalg import spsolve

from pb4u.collision.collision_free import SMALLEST_GAP
from pb4u.collision.crossings import Piercings, piercings, self_crossings
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.geometry.topology import Topology, neighbour_mean
from pb4u.geometry.triangle_mesh import edge_lengths

MOST_PASSES = 200
"""Passes after which cloth counts as one that cannot be untangled; what can needs 5 to about 100."""

FARTHEST = 0.15
"""Displacement [m] of a vertex at which cloth counts as one that cannot be untangled: garments are untangled within
2 to 6 cm, and what is drawn farther hangs in a place of its own making."""

_STEP = 0.3
"""Mean edge lengths that an edge and the face it passes through are moved against each other in a pass: three times
as many passes at 0.1, and no more than that is untangled."""
_STEEPEST = 0.1
"""Least cosine between an edge and the normal of the face it passes through that the step divides by."""
_SHORTEST, _LONGEST = 0.85, 1.15
"""Edges keep between these shares of their initial lengths, so that nothing is untangled by collapsing to a
point: of 27 garments it left 13 faces each strained by more than half, against 32 at 0.5 and 1.6."""
_SPREADS = 2
"""Times that a step is passed on to the neighbours, half of it each time: a vertex moved on its own would leave the
cloth as a spike. Without it freeing takes twice the passes."""
_AIM = 2.0
"""Times the smallest distance that parts nearer than it are pushed apart to, so that a few passes do."""
_MOST_WIDENINGS = 60
"""Passes of pushing apart after which what is too near stays so, as between fixed vertices."""
_PATIENCE = 30
"""Passes without fewer crossings after which the cloth around those left is smoothed, up to `_WIDEST` edges away."""
_WIDEST = 4
_GIVEN_UP = 3 * _PATIENCE
"""Passes without fewer crossings after which no more are made."""


@dataclass(frozen=True, eq=False)
class Untangled:
    """Cloth after untangling.

    Args:
        vertices: (vertices, 3) float64 [m], exactly representable in float32; after a failure, the best result.
        crossings: (pairs, 2) int64 faces that still cross, pairs that share a vertex included.
        gap: smallest distance [m] between parts that share no vertex, searched up to twice the requested one; 0 if
            something crosses.
        passes: passes made.
    """

    vertices: np.ndarray
    crossings: np.ndarray
    gap: float
    passes: int

    @property
    def is_free(self) -> bool:
        """Whether nothing crosses."""
        return not len(self.crossings)


def untangle(
    vertices: np.ndarray, faces: np.ndarray, mobility: np.ndarray | None = None, gap: float = SMALLEST_GAP
) -> Untangled:
    """Move cloth by small displacements until no two of its triangles cross and its parts keep a smallest distance.

    Cloth that already does is returned unchanged but rounded to float32. If the distance is not possible, as between
    fixed vertices, the result with the largest distance is returned.

    Args:
        vertices: (vertices, 3) [m], finite, of one garment or of several together.
        faces: (faces, 3) int64.
        mobility: (vertices,) how readily each moves, 0 for fixed; default 1 for all.
        gap: smallest distance [m] between parts that share no vertex; 0 for no such condition.
    """
    return _Untangling(np.asarray(vertices, dtype=np.float64), faces, mobility, gap).run()


@dataclass(frozen=True, eq=False)
class _Pushes:
    """Points of the cloth to be moved against each other.

    Args:
        vertices: (pushes, corners) int64 that the two points lie between.
        shares: (pushes, corners) of the first point, and negative those of the second; each adds up to 1.
        offsets: (pushes, 3) by which the first point is to move away from the second [m].
    """

    vertices: np.ndarray
    shares: np.ndarray
    offsets: np.ndarray


class _Untangling:
    """The passes; what depends on the cloth as it came is prepared once."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, mobility: np.ndarray | None, gap: float) -> None:
        self.topology = Topology(np.ascontiguousarray(faces, dtype=np.int64), len(vertices))
        self.mobility = np.ones(len(vertices)) if mobility is None else np.asarray(mobility, dtype=np.float64)
        self.start, self.gap = _rounded(vertices), gap
        self.lengths = edge_lengths(self.start, self.topology.edges)
        self.step = _STEP * float(self.lengths.mean()) if len(self.lengths) else 0.0
        self.spread = neighbour_mean(self.topology)

    @cached_property
    def tree(self) -> SurfaceTree:
        """Search tree of the cloth as it came."""
        parts = np.zeros(self.topology.vertex_count, dtype=np.int64)
        return SurfaceTree(self.start, self.topology.faces, self.topology.edges, parts, [0])

    def run(self) -> Untangled:
        """Pass after pass until nothing crosses or is too near."""
        vertices, since, rings, widenings, passes = self.start, 0, 0, 0, 0
        best = Untangled(vertices, np.zeros((0, 2), dtype=np.int64), 0.0, 0)
        for passes in range(MOST_PASSES + 1):
            pairs = self_crossings(vertices, self.topology.faces, sharing=True)
            pushes, nearest = (None, 0.0) if len(pairs) else self._near(vertices)
            since += 1
            if not passes or (len(pairs), -nearest) < (len(best.crossings), -best.gap):
                best, since = Untangled(vertices, pairs, nearest, passes), 0
            if since == _GIVEN_UP or (not len(pairs) and (pushes is None or widenings == _MOST_WIDENINGS)):
                break
            if pushes is not None:
                widenings += 1
                vertices = _rounded(vertices + self._moves(pushes))
            elif since and since % _PATIENCE == 0:
                rings = min(rings + 1, _WIDEST)
                vertices = self._smoothed(vertices, pairs, rings)
            else:
                vertices = self._shortened(vertices, pairs)
            if not np.linalg.norm(vertices - self.start, axis=1).max() < FARTHEST:
                break
        return replace(best, passes=passes)

    def _shortened(self, vertices: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Vertices (vertices, 3) [m] after one step down the length of all contours."""
        pierced = piercings(vertices, self.topology, pairs)
        along = _descent(vertices, self.topology, pierced)
        size = np.linalg.norm(along, axis=1, keepdims=True)
        ends, corners = self.topology.edges[pierced.edges], self.topology.faces[pierced.faces]
        moves = self._moves(
            _Pushes(
                np.column_stack([ends, corners]),
                np.column_stack([1.0 - pierced.shares, pierced.shares, -pierced.barycentric]),
                along * (self.step / np.maximum(size, 1.0)),
            )
        )
        for _ in range(_SPREADS):
            moves = moves + 0.5 * (self.spread @ moves)
        return _rounded(self._held_in_length(vertices + moves * (self.mobility > 0.0)[:, None]))

    def _moves(self, pushes: _Pushes) -> np.ndarray:
        """Displacements (vertices, 3) [m] of each vertex: the mean of the displacements that its elements need."""
        weights = self.mobility[pushes.vertices]
        reached = np.maximum((weights * pushes.shares**2).sum(axis=1), 1e-9)
        moves = (weights * pushes.shares / reached[:, None])[:, :, None] * pushes.offsets[:, None, :]
        owner, count = pushes.vertices.reshape(-1), self.topology.vertex_count
        total = np.stack([np.bincount(owner, moves[:, :, k].reshape(-1), count) for k in range(3)], axis=1)
        # A corner that a point lies far from hardly moves with it, and does not count as asked.
        times = np.bincount(owner, np.abs(pushes.shares).reshape(-1), count)
        return total / np.maximum(times, 1.0)[:, None]

    def _held_in_length(self, vertices: np.ndarray) -> np.ndarray:
        """Vertices with edges that are far too short or too long brought half way back."""
        edges = self.topology.edges
        offset = vertices[edges[:, 1]] - vertices[edges[:, 0]]
        length = np.linalg.norm(offset, axis=1)
        target = np.clip(length, _SHORTEST * self.lengths, _LONGEST * self.lengths)
        out = np.flatnonzero(np.abs(target - length) > 1e-6 * self.lengths)
        if not len(out):
            return vertices
        unit = offset[out] / np.maximum(length[out], 1e-12)[:, None]
        shares = np.tile([-1.0, 1.0], (len(out), 1))
        return vertices + self._moves(_Pushes(edges[out], shares, 0.5 * (target - length)[out][:, None] * unit))

    def _smoothed(self, vertices: np.ndarray, pairs: np.ndarray, rings: int) -> np.ndarray:
        """Vertices with the cloth around crossing faces drawn smooth between what is `rings` edges away."""
        free = np.zeros(self.topology.vertex_count, dtype=bool)
        free[self.topology.faces[pairs.reshape(-1)].reshape(-1)] = True
        for _ in range(rings):
            free |= (self.spread @ free.astype(np.float64)) > 0.0
        free &= self.mobility > 0.0
        laplacian = (diags(np.ones(len(free))) - self.spread).tocsr()
        system = laplacian[free][:, free] + 1e-6 * diags(np.ones(int(free.sum())))
        right = -(laplacian[free][:, ~free] @ vertices[~free]) + 1e-6 * vertices[free]
        drawn = vertices.copy()
        drawn[free] = np.asarray(spsolve(system.tocsc(), right)).reshape(-1, 3)
        return _rounded(drawn)

    def _near(self, vertices: np.ndarray) -> tuple[_Pushes | None, float]:
        """Pairs of parts nearer than the gap, to be pushed apart, or None; and the smallest distance found [m]."""
        if not self.gap:
            return None, 0.0
        pairs = self.tree.pairs(vertices, _AIM * self.gap)
        distances, weights, normals = pairs.nearest(vertices)
        nearest = float(distances.min(initial=_AIM * self.gap))
        if not (distances < self.gap).any():
            return None, nearest
        aim = _AIM * self.gap
        near = distances < aim
        push = (aim - distances[near])[:, None] * normals[near]
        return _Pushes(pairs.corners[near], weights[near], push), nearest


def _descent(vertices: np.ndarray, topology: Topology, pierced: Piercings) -> np.ndarray:
    """Directions (piercings, 3) in which to move each edge against its face so that the contours become shorter.

    The contour leaves the point of crossing along the line in which the face cuts each face at the edge: along unit
    vectors R into those. With the edge's direction E and the face's normal N, moving the edge by
    R - 2 (E . R) / (E . N) N draws the point along the contour (equation 6 of the paper).
    """
    edge = pierced.edges
    start = vertices[topology.edges[edge, 0]]
    way = vertices[topology.edges[edge, 1]] - start
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    cosine = np.einsum("ij,ij->i", way, pierced.normals)
    cosine = np.where(cosine < 0.0, -1.0, 1.0) * np.maximum(np.abs(cosine), _STEEPEST)
    total = np.zeros_like(way)
    for side in range(2):
        is_there = topology.edge_faces[edge, side] >= 0
        to_third = vertices[topology.edge_opposites[edge, side]] - start
        inward = to_third - np.einsum("ij,ij->i", to_third, way)[:, None] * way
        line = np.cross(pierced.normals, np.cross(way, inward))
        line *= np.sign(np.einsum("ij,ij->i", line, inward))[:, None]
        line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-300)
        lift = 2.0 * np.einsum("ij,ij->i", way, line) / cosine
        total += np.where(is_there[:, None], line - lift[:, None] * pierced.normals, 0.0)
    return total


def _rounded(vertices: np.ndarray) -> np.ndarray:
    """Numbers as a file of float32 holds them, in float64."""
    return vertices.astype(np.float32).astype(np.float64)
