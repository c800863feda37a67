"""HOOD's coarsening and a graph's centre, written down as the paper tells them: loops over vertices, sets, queues."""

from __future__ import annotations

from collections import deque
from itertools import combinations

Neighbours = dict[int, set[int]]


def neighbours_of(edges, vertex_count: int) -> Neighbours:
    found: Neighbours = {vertex: set() for vertex in range(vertex_count)}
    for a, b in edges:
        found[int(a)].add(int(b))
        found[int(b)].add(int(a))
    return found


def distances(graph: Neighbours, source: int) -> dict[int, int]:
    found, queue = {source: 0}, deque([source])
    while queue:
        vertex = queue.popleft()
        for other in graph[vertex]:
            if other not in found:
                found[other] = found[vertex] + 1
                queue.append(other)
    return found


def eccentricity(graph: Neighbours, vertex: int) -> int:
    return max(distances(graph, vertex).values())


def coarser(graph: Neighbours, centres: list[int]) -> Neighbours:
    depth: dict[int, int] = {}
    for centre in centres:
        depth |= distances(graph, centre)
    odd = [vertex for vertex, d in depth.items() if d % 2]
    even = [vertex for vertex, d in depth.items() if d % 2 == 0]

    first: Neighbours = {vertex: set() for vertex in graph}
    for vertex in odd:
        for inner in graph[vertex]:
            for outer in graph[vertex]:
                if depth[inner] == depth[vertex] - 1 and depth[outer] == depth[vertex] + 1:
                    assert distances(graph, inner)[outer] == 2
                    _join(first, inner, outer)

    second = {vertex: set(others) for vertex, others in first.items()}
    for vertex in odd:
        if any(depth[other] == depth[vertex] + 1 for other in graph[vertex]):
            continue
        inner = [other for other in graph[vertex] if depth[other] == depth[vertex] - 1]
        for a, b in combinations(inner, 2):
            if distances(first, a).get(b, 99) > 2:
                _join(second, a, b)

    third = {vertex: set(others) for vertex, others in second.items()}
    for a in even:
        for b in graph[a]:
            if depth[b] % 2 == 0 and distances(second, a).get(b, 99) > 2:
                _join(third, a, b)
    return third


def edges_of(graph: Neighbours) -> set[tuple[int, int]]:
    return {(a, b) for a, others in graph.items() for b in others if a < b}


def _join(graph: Neighbours, a: int, b: int) -> None:
    graph[a].add(b)
    graph[b].add(a)
