"""Even triangles within a loop of points, every point of which stays."""

from __future__ import annotations

import numpy as np

from pb4u.geometry.topology import connected_labels

_CLEAR = 0.55
"""Distance of inner points from the loop, as a share of the wanted edge length: the triangles there are even then."""

_ROUNDS = 4
"""Times that inner points are moved to the mean of their neighbours, and triangulated again."""


def triangulate_loop(loop: np.ndarray, length: float, bulge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Constrained Delaunay triangles of even size within a simple counter-clockwise loop.

    Inner points begin on a triangular lattice and relax (Laplacian smoothing). Edges of the loop that the Delaunay
    triangulation lacks are recovered by flips (Sloan 1993).

    Args:
        loop: (n, 2) points [m]; the mesh keeps the edges between consecutive points.
        length: wanted edge length within [m].
        bulge: (n, 2) small outward displacements [m] of these points during triangulation: three points of a straight
            edge would give flat triangles.

    Returns:
        Points (m, 2), those of the loop first, and counter-clockwise triangles (k, 3) int64.
    """
    inner = _lattice(loop, length)
    points, count = np.concatenate([loop + bulge, inner]), len(loop)
    faces = _delaunay(points, count)
    for _ in range(_ROUNDS if len(inner) else 0):
        points = _relaxed(points, faces, count)
        faces = _delaunay(points, count)
    points[:count] = loop
    used = np.unique(np.append(faces, np.arange(count)))
    return points[used], np.searchsorted(used, faces)


def _lattice(loop: np.ndarray, length: float) -> np.ndarray:
    """Points of a triangular lattice within the loop, clear of it."""
    low, high = loop.min(axis=0), loop.max(axis=0)
    row = length * np.sqrt(0.75)
    counts = np.ceil((high - low) / (length, row)).astype(int) + 1
    x, y = np.meshgrid(np.arange(counts[0]) * length, np.arange(counts[1]) * row)
    x = x + np.where(np.arange(counts[1]) % 2 == 1, 0.5 * length, 0.0)[:, None]
    points = np.column_stack([x.ravel(), y.ravel()]) + 0.5 * (low + high - (counts - 1) * (length, row))
    distance, inside = _to_loop(points, loop)
    return points[inside & (distance > _CLEAR * length)]


def _to_loop(points: np.ndarray, loop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) of points from the loop, and whether each lies within it."""
    distance, inside = np.full(len(points), np.inf), np.zeros(len(points), dtype=bool)
    for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
        way, offset = b - a, points - a
        t = np.clip(offset @ way / (way @ way), 0.0, 1.0)
        distance = np.minimum(distance, np.hypot(*(offset - t[:, None] * way).T))
        above = points[:, 1] >= a[1]
        crossed = above != (points[:, 1] >= b[1])
        side = way[0] * offset[:, 1] - way[1] * offset[:, 0]
        inside ^= crossed & ((side > 0) == (b[1] > a[1]))
    return distance, inside


def _relaxed(points: np.ndarray, faces: np.ndarray, fixed: int) -> np.ndarray:
    """Points of which those after the first `fixed` have moved to the mean of their neighbours."""
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    sums, counts = np.zeros_like(points), np.bincount(ends[:, 0], minlength=len(points))
    np.add.at(sums, ends[:, 0], points[ends[:, 1]])
    relaxed = points.copy()
    relaxed[fixed:] = np.where(
        counts[fixed:, None] > 0, sums[fixed:] / np.maximum(counts[fixed:, None], 1), relaxed[fixed:]
    )
    return relaxed


def _delaunay(points: np.ndarray, loop: int) -> np.ndarray:
    """Triangles within the loop of the first `loop` points; every edge of the loop is an edge of a triangle."""
    from scipy.spatial import Delaunay

    faces = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[faces].transpose(1, 0, 2)
    turned = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) < (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    faces[turned] = faces[turned, ::-1]
    start, size = np.arange(loop), len(points)
    border = start * size + np.roll(start, -1)
    keys = _directed(faces, size)
    missing = ~np.isin(border, keys)
    if missing.any():
        mesh = _Triangles(points, faces)
        for a, b in zip(start[missing].tolist(), np.roll(start, -1)[missing].tolist(), strict=True):
            mesh.recover(a, b)
        faces = np.array(mesh.faces, dtype=np.int64)
        keys = _directed(faces, size)
    # Triangles that share an edge lie on one side of the loop, unless the edge is of the loop.
    order = np.argsort(keys)
    back = keys % size * size + keys // size
    beyond = order[np.minimum(np.searchsorted(keys[order], back), len(keys) - 1)]
    joined = (keys[beyond] == back) & ~np.isin(keys, border) & ~np.isin(back, border)
    owner = np.tile(np.arange(len(faces)), 3)
    piece = connected_labels(len(faces), owner[joined], owner[beyond[joined]])
    return faces[np.isin(piece, piece[owner[np.isin(keys, border)]])]


def _directed(faces: np.ndarray, size: int) -> np.ndarray:
    """Keys (3 faces,) of the directed edges: those from the first corners, then from the second and the third."""
    return (faces * size + np.roll(faces, -1, axis=1)).T.ravel()


class _Triangles:
    """A triangulation of a convex region in which edges are flipped.

    Args:
        points: (n, 2) [m].
        faces: (m, 3) counter-clockwise.
    """

    def __init__(self, points: np.ndarray, faces: np.ndarray) -> None:
        self.points = points
        self.faces = faces.tolist()
        self.at: dict[tuple[int, int], int] = {}
        for number in range(len(self.faces)):
            self._enter(number)

    def recover(self, a: int, b: int) -> None:
        """Flip what crosses the segment from `a` to `b`, until it is an edge."""
        if (a, b) in self.at or (b, a) in self.at:
            return
        crossing = [edge for edge in self.at if edge[0] < edge[1] and self._crosses(a, b, *edge)]
        for _ in range(100 * (len(crossing) + 1)):
            if not crossing:
                return
            u, v = crossing.pop(0)
            flipped = self._flip(u, v)
            if flipped is None:
                crossing.append((u, v))
            elif self._crosses(a, b, *flipped):
                crossing.append(flipped)

    def _flip(self, u: int, v: int) -> tuple[int, int] | None:
        """Replace the edge u, v of two triangles by that between their other corners; None unless they are convex."""
        one, other = self.at.get((u, v)), self.at.get((v, u))
        if one is None or other is None:
            return None
        c, d = (next(k for k in self.faces[number] if k not in (u, v)) for number in (one, other))
        size = float(np.square(self.points[u] - self.points[v]).sum())
        if min(self._turn(c, d, v), self._turn(d, c, u)) <= 1e-12 * size:
            return None
        for number in (one, other):
            self._leave(number)
        self.faces[one], self.faces[other] = [c, d, v], [d, c, u]
        for number in (one, other):
            self._enter(number)
        return c, d

    def _crosses(self, a: int, b: int, u: int, v: int) -> bool:
        if {a, b} & {u, v}:
            return False
        return self._turn(a, b, u) * self._turn(a, b, v) < 0.0 and self._turn(u, v, a) * self._turn(u, v, b) < 0.0

    def _turn(self, a: int, b: int, c: int) -> float:
        """Twice the signed area of a triangle, positive where it is counter-clockwise."""
        (ax, ay), (bx, by), (cx, cy) = self.points[[a, b, c]].tolist()
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    def _enter(self, number: int) -> None:
        a, b, c = self.faces[number]
        self.at[a, b] = self.at[b, c] = self.at[c, a] = number

    def _leave(self, number: int) -> None:
        a, b, c = self.faces[number]
        for edge in ((a, b), (b, c), (c, a)):
            self.at.pop(edge, None)
