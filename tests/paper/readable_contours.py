"""Contours and near faces written down plainly: every edge with every face, dictionaries and flood fills."""

from __future__ import annotations

from collections import defaultdict

import numpy as np


def crossings(vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> list[tuple[int, int]]:
    found = []
    for e, (i, j) in enumerate(edges.tolist()):
        for f, corners in enumerate(faces.tolist()):
            if i in corners or j in corners:
                continue
            p, q = vertices[i], vertices[j]
            a, b, c = (vertices[k] for k in corners)
            if volume(p, a, b, c) * volume(q, a, b, c) >= 0:
                continue
            around = [volume(p, q, x, y) for x, y in ((a, b), (b, c), (c, a))]
            if all(v >= 0 for v in around) or all(v <= 0 for v in around):
                found.append((e, f))
    return found


def volume(a, b, c, d) -> float:
    return float(np.linalg.det(np.stack([b - a, c - a, d - a])))


def segments(found: list[tuple[int, int]], faces: np.ndarray, edges: np.ndarray) -> set[tuple[int, int]]:
    """Crossings (by index) at both ends of what two triangles share."""
    by_pair = defaultdict(list)
    for index, (e, f) in enumerate(found):
        for g, corners in enumerate(faces.tolist()):
            if set(edges[e].tolist()) <= set(corners):
                by_pair[frozenset((f, g))].append(index)
    return {(pair[0], pair[1]) for pair in by_pair.values() if len(pair) == 2}


def groups(count: int, links) -> list[set[int]]:
    near = defaultdict(set)
    for a, b in links:
        near[a].add(b)
        near[b].add(a)
    left, found = set(range(count)), []
    while left:
        queue, group = [left.pop()], set()
        while queue:
            item = queue.pop()
            group.add(item)
            queue += [other for other in near[item] if other in left]
            left -= near[item]
        found.append(group)
    return found


def enclosed(vertex_count: int, edges: np.ndarray, found, contours: list[set[int]]) -> list[set[int]]:
    """Vertices on the smaller side of each contour."""
    crossed = {e for e, _ in found}
    parts = groups(vertex_count, [tuple(edge) for e, edge in enumerate(edges.tolist()) if e not in crossed])
    part_of = {vertex: part for part in map(frozenset, parts) for vertex in part}
    inside = []
    for contour in contours:
        vertices: set[int] = set()
        for index in contour:
            sides = [part_of[vertex] for vertex in edges[found[index][0]].tolist()]
            if len(sides[0]) != len(sides[1]):
                vertices |= min(sides, key=len)
        inside.append(vertices)
    return inside


def facing(vertices: np.ndarray, faces: np.ndarray, radius: float) -> set[tuple[int, int]]:
    found = set()
    for v, point in enumerate(vertices):
        for f, corners in enumerate(faces.tolist()):
            a, b, c = (vertices[k] for k in corners)
            normal = np.cross(b - a, c - a)
            normal /= np.linalg.norm(normal)
            height = (point - a) @ normal
            foot = point - height * normal
            inside = all(np.cross(y - x, foot - x) @ normal >= 0 for x, y in ((a, b), (b, c), (c, a)))
            if v not in corners and abs(height) <= radius and inside:
                found.add((v, f))
    return found
