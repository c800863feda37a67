"""Splitting, collapsing and flipping edges of a manifold triangle mesh with open borders, many at a time.

Each pass picks a set of edges whose neighbourhoods do not overlap, so that all can be changed at once, in whole-array
operations. The choice depends on lengths and indices only: the same mesh always gives the same result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

#: A border loop is not thinned below this many vertices.
SMALLEST_LOOP = 8


@dataclass(frozen=True, eq=False)
class EdgeTable:
    """Edges of a mesh with the one or two faces at each.

    Args:
        edges: (edges, 2) int64 vertex indices, lower first, in lexicographic order.
        keys: (edges,) int64 one increasing number per edge.
        face_edges: (faces, 3) int64 edges of corners 01, 12 and 20.
        faces: (edges, 2) int64 faces at the edge, the second -1 on a border.
        opposite: (edges, 2) int64 third vertex of those faces, the second -1 on a border.
        border_vertex: (vertices,) bool.
    """

    edges: np.ndarray
    keys: np.ndarray
    face_edges: np.ndarray
    faces: np.ndarray
    opposite: np.ndarray
    border_vertex: np.ndarray

    @property
    def on_border(self) -> np.ndarray:
        """(edges,) bool."""
        return self.faces[:, 1] < 0


def edge_table(faces: np.ndarray, vertex_count: int) -> EdgeTable:
    """The edges of `faces` (faces, 3), each of which at most two faces share."""
    starts = faces.T.reshape(-1)
    ends = faces[:, [1, 2, 0]].T.reshape(-1)
    half_keys = np.minimum(starts, ends) * vertex_count + np.maximum(starts, ends)
    order = np.argsort(half_keys, kind="stable")
    ordered = half_keys[order]
    first = np.concatenate([[True], ordered[1:] != ordered[:-1]]) if len(ordered) else np.zeros(0, dtype=bool)
    edge_of = np.empty(len(order), dtype=np.int64)
    edge_of[order] = np.cumsum(first) - 1
    begin = np.flatnonzero(first)
    keys = ordered[begin]
    count = np.diff(np.append(begin, len(ordered)))
    half_faces = np.tile(np.arange(len(faces)), 3)
    thirds = faces[:, [2, 0, 1]].T.reshape(-1)
    second = np.where(count > 1, order[np.minimum(begin + 1, max(len(order) - 1, 0))], -1)
    edge_faces = np.column_stack([half_faces[order[begin]], np.where(second >= 0, half_faces[second], -1)])
    opposite = np.column_stack([thirds[order[begin]], np.where(second >= 0, thirds[second], -1)])
    edges = np.column_stack([keys // vertex_count, keys % vertex_count])
    border_vertex = np.zeros(vertex_count, dtype=bool)
    border_vertex[edges[count == 1]] = True
    return EdgeTable(edges, keys, edge_of.reshape(3, -1).T, edge_faces, opposite, border_vertex)


def _lengths(vertices: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    way = vertices[pairs[:, 0]] - vertices[pairs[:, 1]]
    return np.sqrt(np.einsum("ij,ij->i", way, way))


def _cross_products(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    return np.cross(b - a, c - a)


def _quality(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """1 for an equilateral triangle, 0 for a degenerate one."""
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    ab, bc, ca = b - a, c - b, a - c
    squares = np.einsum("ij,ij->i", ab, ab) + np.einsum("ij,ij->i", bc, bc) + np.einsum("ij,ij->i", ca, ca)
    cross = np.cross(ab, bc)
    return 2.0 * np.sqrt(3.0) * np.sqrt(np.einsum("ij,ij->i", cross, cross)) / np.maximum(squares, 1e-300)


def _ragged(starts: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Concatenated ranges start..start+count-1."""
    total = int(counts.sum())
    offsets = np.repeat(np.cumsum(counts) - counts, counts)
    return np.arange(total) - offsets + np.repeat(starts, counts)


def split_long_edges(
    vertices: np.ndarray, faces: np.ndarray, longest: float, locked: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Halves every edge longer than `longest` [m]; returns vertices, faces and the `locked` flags extended."""
    table = edge_table(faces, len(vertices))
    marked = _lengths(vertices, table.edges) > longest
    if not marked.any():
        return vertices, faces, locked
    new_index = np.full(len(marked), -1)
    new_index[marked] = len(vertices) + np.arange(int(marked.sum()))
    middles = vertices[table.edges[marked]].mean(axis=1)
    vertices = np.concatenate([vertices, middles])
    locked = np.concatenate([locked, np.zeros(len(middles), dtype=bool)])

    cut = marked[table.face_edges]
    pattern = cut @ np.array([1, 2, 4])
    # Turn each face so that one cut lies on corner 01, and two cuts on 01 and 12.
    turn = np.array([0, 0, 1, 0, 2, 2, 1, 0])[pattern]
    corner = (turn[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, corner, 1).T
    ab, bc, ca = new_index[np.take_along_axis(table.face_edges, corner, 1)].T
    cuts = cut.sum(axis=1)
    parts = [faces[cuts == 0]]
    one = cuts == 1
    parts += [np.column_stack([a, ab, c])[one], np.column_stack([ab, b, c])[one]]
    two = cuts == 2
    parts.append(np.column_stack([ab, b, bc])[two])
    shorter = np.zeros(len(faces), dtype=bool)
    shorter[two] = _lengths(vertices, np.column_stack([ab, c])[two]) < _lengths(vertices, np.column_stack([a, bc])[two])
    other = two & ~shorter
    parts += [np.column_stack([a, ab, c])[shorter], np.column_stack([ab, bc, c])[shorter]]
    parts += [np.column_stack([a, ab, bc])[other], np.column_stack([a, bc, c])[other]]
    three = cuts == 3
    for triple in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)):
        parts.append(np.column_stack(triple)[three])
    return vertices, np.concatenate(parts), locked


def _vertex_faces(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces around each vertex: start and count per vertex, and the concatenated face indices."""
    corners = faces.reshape(-1)
    order = np.argsort(corners, kind="stable")
    counts = np.bincount(corners, minlength=vertex_count)
    return np.cumsum(counts) - counts, counts, order // 3


def collapse_short_edges(
    vertices: np.ndarray, faces: np.ndarray, shortest: float, longest: float, locked: np.ndarray, turn: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """One pass that removes edges shorter than `shortest` [m] where manifoldness, orientation and borders allow it.

    Border vertices slide along the border only, `locked` ones stay, and no edge longer than `longest` [m] is made.
    Passes with another `turn` try other edges first.
    Returns vertices, faces, locked flags and the number of edges removed.
    """
    table = edge_table(faces, len(vertices))
    lengths = _lengths(vertices, table.edges)
    border, on_border = table.border_vertex, table.on_border
    u, v = table.edges.T
    allowed = (lengths < shortest) & ~(locked[u] & locked[v]) & ~(border[u] & border[v] & ~on_border)
    allowed[on_border & allowed] = _spare_border_edges(table, np.flatnonzero(on_border & allowed), lengths)
    candidates = _independent(faces, table.edges, lengths, np.flatnonzero(allowed), turn, len(vertices))
    if not len(candidates):
        return vertices, faces, locked, 0
    u, v = table.edges[candidates].T
    # `u` survives; it is the vertex that is held more tightly.
    held_u = 2 * locked[u].astype(int) + border[u]
    held_v = 2 * locked[v].astype(int) + border[v]
    swap = held_v > held_u
    u, v = np.where(swap, v, u), np.where(swap, u, v)
    merged = np.where((held_u == held_v)[:, None], 0.5 * (vertices[u] + vertices[v]), vertices[u])

    start, count, ring_faces = _vertex_faces(faces, len(vertices))
    sizes = np.concatenate([count[u], count[v]])
    owner = np.repeat(np.tile(np.arange(len(u)), 2), sizes)
    touched = ring_faces[_ragged(np.concatenate([start[u], start[v]]), sizes)]

    good = _link_condition(faces, owner, touched, u, v, on_border[candidates], len(vertices))

    # Faces that survive must keep their side, stay fat enough and get no long edge.
    corners = faces[touched]
    is_u, is_v = corners == u[owner][:, None], corners == v[owner][:, None]
    survives = ~(is_u.any(1) & is_v.any(1))
    moved = np.where((is_u | is_v)[..., None], merged[owner][:, None, :], vertices[corners])
    before = vertices[corners]
    normal_before = np.cross(before[:, 1] - before[:, 0], before[:, 2] - before[:, 0])
    normal_after = np.cross(moved[:, 1] - moved[:, 0], moved[:, 2] - moved[:, 0])
    agree = np.einsum("ij,ij->i", normal_before, normal_after)
    scale = np.linalg.norm(normal_before, axis=1) * np.linalg.norm(normal_after, axis=1)
    sides = np.linalg.norm(moved - np.roll(moved, 1, axis=1), axis=2)
    thin = np.linalg.norm(normal_after, axis=1) < 0.1 * sides.max(axis=1) ** 2
    thinner = thin & (_triangle_quality(moved) < _triangle_quality(before))
    bad = survives & ((agree < 0.3 * scale) | (sides.max(axis=1) > longest) | thinner)
    good &= np.bincount(owner[bad], minlength=len(u)) == 0

    if not good.any():
        return vertices, faces, locked, 0
    vertices = vertices.copy()
    vertices[u[good]] = merged[good]
    target = np.arange(len(vertices))
    target[v[good]] = u[good]
    faces = target[faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    kept = np.zeros(len(vertices), dtype=bool)
    kept[faces] = True
    renumber = np.cumsum(kept) - 1
    return vertices[kept], renumber[faces], locked[kept], int(good.sum())


def _independent(
    faces: np.ndarray, edges: np.ndarray, lengths: np.ndarray, candidates: np.ndarray, turn: int, vertex_count: int
) -> np.ndarray:
    """Those `candidates` among the edges, short ones rather first, whose ends have no face in common with each other.

    Rounds of Luby's algorithm; a scrambled part in the order makes the sets large and varies them with `turn`.
    """
    scramble = (candidates * 2654435761 + (turn + 1) * 40503 * 65537) % 1000003 / 1000003
    order = np.lexsort((candidates, lengths[candidates] * (0.4 + scramble)))
    rank = np.empty(len(candidates), dtype=np.int64)
    rank[order] = np.arange(len(candidates))
    chosen = []
    u, v = edges[candidates].T
    for _ in range(4):
        if not len(candidates):
            break
        at_vertex = np.full(vertex_count, np.iinfo(np.int64).max)
        np.minimum.at(at_vertex, u, rank)
        np.minimum.at(at_vertex, v, rank)
        at_face = at_vertex[faces].min(axis=1)
        around = np.full(vertex_count, np.iinfo(np.int64).max)
        for k in range(3):
            np.minimum.at(around, faces[:, k], at_face)
        win = (around[u] == rank) & (around[v] == rank)
        chosen.append(candidates[win])
        ends = np.zeros(vertex_count, dtype=bool)
        ends[u[win]] = ends[v[win]] = True
        taken = np.zeros(vertex_count, dtype=bool)
        taken[faces[ends[faces].any(axis=1)]] = True
        free = ~(taken[u] | taken[v])
        candidates, rank, u, v = candidates[free], rank[free], u[free], v[free]
    return np.sort(np.concatenate(chosen)) if chosen else candidates


def _spare_border_edges(table: EdgeTable, wanted: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """(wanted,) bool: border edges that may go without leaving a loop with fewer than `SMALLEST_LOOP` edges."""
    ends = table.edges[table.on_border]
    count = len(table.border_vertex)
    graph = coo_matrix((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    loop_of = connected_components(graph, directed=False)[1]
    sizes = np.bincount(loop_of[ends[:, 0]])
    loops = loop_of[table.edges[wanted, 0]]
    order = np.lexsort((lengths[wanted], loops))
    sorted_loops = loops[order]
    rank = np.arange(len(order)) - np.searchsorted(sorted_loops, sorted_loops)
    spare = np.empty(len(wanted), dtype=bool)
    spare[order] = rank < sizes[sorted_loops] - SMALLEST_LOOP
    return spare


def _triangle_quality(corners: np.ndarray) -> np.ndarray:
    sides = corners - np.roll(corners, 1, axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return area / np.maximum((sides**2).sum(axis=(1, 2)), 1e-300)


def _link_condition(
    faces: np.ndarray,
    owner: np.ndarray,
    touched: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    on_border: np.ndarray,
    vertex_count: int,
) -> np.ndarray:
    """Whether u and v of each candidate share no neighbours but those of their common faces."""
    corners = faces[touched]
    from_u = (corners == u[owner][:, None]).any(axis=1)
    from_v = (corners == v[owner][:, None]).any(axis=1)
    keys_u = _distinct((owner[from_u, None] * vertex_count + corners[from_u]).reshape(-1))
    keys_v = _distinct((owner[from_v, None] * vertex_count + corners[from_v]).reshape(-1))
    together = np.sort(np.concatenate([keys_u, keys_v]))
    both = together[1:][together[1:] == together[:-1]] // vertex_count
    # u and v themselves are among the shared ones.
    shared = np.bincount(both, minlength=len(u)) - 2
    around = np.bincount(keys_u // vertex_count, minlength=len(u)) + np.bincount(
        keys_v // vertex_count, minlength=len(u)
    )
    return (shared == np.where(on_border, 1, 2)) & (around - 2 * shared > 4 - on_border)


def _distinct(keys: np.ndarray) -> np.ndarray:
    keys = np.sort(keys)
    return keys[np.concatenate([[True], keys[1:] != keys[:-1]])] if len(keys) else keys


def flip_edges(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """One pass that flips edges where it brings valences nearer to 6 (4 on the border), or else fattens triangles."""
    table = edge_table(faces, len(vertices))
    valence = np.bincount(table.edges.reshape(-1), minlength=len(vertices))
    excess = valence - np.where(table.border_vertex, 4, 6)
    gain = excess[table.edges].sum(axis=1) - excess[table.opposite].sum(axis=1) - 2
    face_quality = _quality(vertices, faces)
    quality_old = face_quality[table.faces].min(axis=1)
    inner = np.flatnonzero(~table.on_border & ((gain > 0) | ((gain > -2) & (quality_old < 0.6))))
    if not len(inner):
        return faces, 0
    gain, quality_old = gain[inner], quality_old[inner]
    a, b = table.edges[inner].T
    c, d = table.opposite[inner].T
    # Orient: the first face runs a -> b (then its third vertex is c).
    first_face = faces[table.faces[inner, 0]]
    runs = ((first_face == a[:, None]) & (np.roll(first_face, -1, axis=1) == b[:, None])).any(axis=1)
    a, b = np.where(runs, a, b), np.where(runs, b, a)

    new_one, new_two = np.column_stack([c, d, b]), np.column_stack([d, c, a])
    quality_new = np.minimum(_quality(vertices, new_one), _quality(vertices, new_two))
    normal_old = _cross_products(vertices, np.column_stack([a, b, c]))
    normal_old += _cross_products(vertices, np.column_stack([b, a, d]))
    aligned = np.ones(len(a), dtype=bool)
    for new in (new_one, new_two):
        cross = _cross_products(vertices, new)
        dot = np.einsum("ij,ij->i", cross, normal_old)
        aligned &= dot > 0.6 * np.linalg.norm(cross, axis=1) * np.linalg.norm(normal_old, axis=1)
    better = (gain > 0) & (quality_new > np.minimum(0.5, 0.9 * quality_old))
    better |= (gain > -2) & (quality_new > 1.2 * quality_old + 0.05) & (quality_old < 0.6)
    key = np.minimum(c, d) * len(vertices) + np.maximum(c, d)
    place = np.minimum(np.searchsorted(table.keys, key), len(table.keys) - 1)
    fine = better & aligned & (table.keys[place] != key) & (valence[a] > 3) & (valence[b] > 3)
    fine &= ~((table.border_vertex[a] & (valence[a] <= 3)) | (table.border_vertex[b] & (valence[b] <= 3)))
    chosen = np.flatnonzero(fine)
    if not len(chosen):
        return faces, 0
    chosen = chosen[np.lexsort((chosen, -(gain[chosen] + quality_new[chosen] - quality_old[chosen])))]
    quad = np.column_stack([a, b, c, d])[chosen]
    rank = np.arange(len(chosen))
    first = np.full(len(vertices), len(chosen))
    np.minimum.at(first, quad.reshape(-1), np.repeat(rank, 4))
    win = (first[quad] == rank[:, None]).all(axis=1)
    won = chosen[win]
    faces = faces.copy()
    faces[table.faces[inner[won], 0]] = new_one[won]
    faces[table.faces[inner[won], 1]] = new_two[won]
    return faces, len(won)


def relax(vertices: np.ndarray, faces: np.ndarray, locked: np.ndarray, step: float = 0.7) -> np.ndarray:
    """Moves each vertex towards the mean of its neighbours within the surface; border vertices along the border."""
    table = edge_table(faces, len(vertices))
    a, b = table.edges.T
    border = table.border_vertex
    # A border vertex listens to its two border neighbours only.
    weight_a = np.where(border[a], table.on_border, True).astype(float)
    weight_b = np.where(border[b], table.on_border, True).astype(float)
    total = np.zeros_like(vertices)
    for axis in range(3):
        total[:, axis] = np.bincount(a, weights=weight_a * vertices[b, axis], minlength=len(vertices))
        total[:, axis] += np.bincount(b, weights=weight_b * vertices[a, axis], minlength=len(vertices))
    weight = np.bincount(a, weights=weight_a, minlength=len(vertices))
    weight += np.bincount(b, weights=weight_b, minlength=len(vertices))
    shift = total / np.maximum(weight, 1.0)[:, None] - vertices
    normals = vertex_normals(vertices, faces)
    inward = np.einsum("ij,ij->i", shift, normals)[:, None] * normals
    shift = shift - np.where(border[:, None], 0.0, inward)
    shift[locked] = 0.0
    return vertices + step * shift


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals (vertices, 3)."""
    cross = _cross_products(vertices, faces)
    total = np.zeros_like(vertices)
    for axis in range(3):
        for corner in range(3):
            total[:, axis] += np.bincount(faces[:, corner], weights=cross[:, axis], minlength=len(vertices))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
