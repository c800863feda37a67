"""Splitting, collapsing and flipping edges of a manifold triangle mesh with open borders, many at a time.

Each pass picks a set of edges whose neighbourhoods do not overlap, so that all can be changed at once, in whole-array
operations. The choice depends on lengths and indices only: the same mesh always gives the same result.
"""

from __future__ import annotations

import numpy as np

from pb4u.geometry.topology import Topology, connected_labels, ranges
from pb4u.geometry.triangle_mesh import face_cross_products

# A border loop is not thinned below this many vertices: fewer no longer show that it is round.
_SMALLEST_LOOP = 8
# Share of the way to the mean of its neighbours that a vertex goes: all of it would swing to and fro.
_RELAXATION = 0.7


def _lengths(vertices: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    way = vertices[pairs[:, 0]] - vertices[pairs[:, 1]]
    return np.sqrt(np.einsum("ij,ij->i", way, way))


def _quality(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """1 for an equilateral triangle, 0 for a degenerate one."""
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    ab, bc, ca = b - a, c - b, a - c
    squares = np.einsum("ij,ij->i", ab, ab) + np.einsum("ij,ij->i", bc, bc) + np.einsum("ij,ij->i", ca, ca)
    cross = np.cross(ab, bc)
    return 2.0 * np.sqrt(3.0) * np.sqrt(np.einsum("ij,ij->i", cross, cross)) / np.maximum(squares, 1e-300)


def split_long_edges(
    vertices: np.ndarray, faces: np.ndarray, longest: float, locked: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Halve every long edge.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        longest: length above which an edge is halved [m].
        locked: (vertices,) bool, extended: new vertices are not locked.

    Returns:
        Vertices (new vertices, 3) [m], faces (new faces, 3) int64 and locked flags (new vertices,) bool.
    """
    mesh = Topology(faces, len(vertices))
    return split_edges(vertices, faces, mesh, _lengths(vertices, mesh.edges) > longest, locked)


def split_edges(
    vertices: np.ndarray, faces: np.ndarray, mesh: Topology, marked: np.ndarray, locked: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split the marked edges in half; the new vertices follow the old ones, in the order of their edges.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        mesh: topology of the faces.
        marked: (edges,) bool, the edges to halve.
        locked: (vertices,) bool, extended: new vertices are not locked.

    Returns:
        Vertices (new vertices, 3) [m], faces (new faces, 3) int64 and locked flags (new vertices,) bool.
    """
    if not marked.any():
        return vertices, faces, locked
    new_index = np.full(len(marked), -1)
    new_index[marked] = len(vertices) + np.arange(int(marked.sum()))
    middles = vertices[mesh.edges[marked]].mean(axis=1)
    vertices = np.concatenate([vertices, middles])
    locked = np.concatenate([locked, np.zeros(len(middles), dtype=bool)])

    cut = marked[mesh.face_edges]
    pattern = cut @ np.array([1, 2, 4])
    # Turn each face so that one cut lies on corner 01, and two cuts on 01 and 12.
    turn = np.array([0, 0, 1, 0, 2, 2, 1, 0])[pattern]
    corner = (turn[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, corner, 1).T
    ab, bc, ca = new_index[np.take_along_axis(mesh.face_edges, corner, 1)].T
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


def collapse_short_edges(
    vertices: np.ndarray, faces: np.ndarray, shortest: float, longest: float, locked: np.ndarray, turn: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Remove short edges, in one pass, where manifoldness, orientation and borders allow it.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        shortest: length below which an edge is removed [m].
        longest: largest length of a new edge [m].
        locked: (vertices,) bool, vertices that do not move; border vertices slide only along the border.
        turn: number of the pass: each tries other edges first.

    Returns:
        Vertices (new vertices, 3) [m], faces (new faces, 3) int64, locked flags (new vertices,) bool and the number of
        edges removed.
    """
    mesh = Topology(faces, len(vertices))
    lengths = _lengths(vertices, mesh.edges)
    border, on_border = mesh.border_vertices, mesh.edge_face_counts == 1
    u, v = mesh.edges.T
    allowed = (lengths < shortest) & ~(locked[u] & locked[v]) & ~(border[u] & border[v] & ~on_border)
    allowed[on_border & allowed] = _spare_border_edges(mesh, np.flatnonzero(on_border & allowed), lengths)
    candidates = _independent(faces, mesh.edges, lengths, np.flatnonzero(allowed), turn, len(vertices))
    if not len(candidates):
        return vertices, faces, locked, 0
    u, v = mesh.edges[candidates].T
    # `u` survives; it is the vertex that is held more tightly.
    held_u = 2 * locked[u].astype(int) + border[u]
    held_v = 2 * locked[v].astype(int) + border[v]
    swap = held_v > held_u
    u, v = np.where(swap, v, u), np.where(swap, u, v)
    merged = np.where((held_u == held_v)[:, None], 0.5 * (vertices[u] + vertices[v]), vertices[u])

    begins, around = mesh.vertex_faces
    ends = np.concatenate([u, v])
    sizes = begins[ends + 1] - begins[ends]
    owner = np.repeat(np.tile(np.arange(len(u)), 2), sizes)
    touched = around[ranges(begins[ends], sizes)]

    good = _link_condition(faces, owner, touched, u, v, on_border[candidates], len(vertices))

    # Faces that survive must keep their side, stay fat enough and get no long edge.
    corners = faces[touched]
    is_u, is_v = corners == u[owner][:, None], corners == v[owner][:, None]
    survives = ~(is_u.any(1) & is_v.any(1))
    collapsed = np.where((is_u | is_v)[..., None], merged[owner][:, None, :], vertices[corners])
    before = vertices[corners]
    normal_before = np.cross(before[:, 1] - before[:, 0], before[:, 2] - before[:, 0])
    normal_after = np.cross(collapsed[:, 1] - collapsed[:, 0], collapsed[:, 2] - collapsed[:, 0])
    agree = np.einsum("ij,ij->i", normal_before, normal_after)
    scale = np.linalg.norm(normal_before, axis=1) * np.linalg.norm(normal_after, axis=1)
    sides = np.linalg.norm(collapsed - np.roll(collapsed, 1, axis=1), axis=2)
    thin = np.linalg.norm(normal_after, axis=1) < 0.1 * sides.max(axis=1) ** 2
    thinner = thin & (_triangle_quality(collapsed) < _triangle_quality(before))
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
    is_used = np.zeros(len(vertices), dtype=bool)
    is_used[faces] = True
    renumber = np.cumsum(is_used) - 1
    return vertices[is_used], renumber[faces], locked[is_used], int(good.sum())


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


def _spare_border_edges(mesh: Topology, edges: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """(wanted,) bool: border edges that may go without leaving a loop with fewer than `_SMALLEST_LOOP` edges."""
    ends = mesh.edges[mesh.edge_face_counts == 1]
    loop_of = connected_labels(mesh.vertex_count, *ends.T)
    sizes = np.bincount(loop_of[ends[:, 0]])
    loops = loop_of[mesh.edges[edges, 0]]
    order = np.lexsort((lengths[edges], loops))
    sorted_loops = loops[order]
    rank = np.arange(len(order)) - np.searchsorted(sorted_loops, sorted_loops)
    spare = np.empty(len(edges), dtype=bool)
    spare[order] = rank < sizes[sorted_loops] - _SMALLEST_LOOP
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
    """Flip edges, in one pass, where this brings valences nearer to 6 (4 on the border), or else improves thin
    triangles.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.

    Returns:
        Faces (faces, 3) int64 and the number of edges flipped.
    """
    mesh = Topology(faces, len(vertices))
    valence = np.bincount(mesh.edges.reshape(-1), minlength=len(vertices))
    excess = valence - np.where(mesh.border_vertices, 4, 6)
    gain = excess[mesh.edges].sum(axis=1) - excess[mesh.edge_opposites].sum(axis=1) - 2
    face_quality = _quality(vertices, faces)
    quality_old = face_quality[mesh.edge_faces].min(axis=1)
    inner = np.flatnonzero((mesh.edge_face_counts > 1) & ((gain > 0) | ((gain > -2) & (quality_old < 0.6))))
    if not len(inner):
        return faces, 0
    gain, quality_old = gain[inner], quality_old[inner]
    a, b = mesh.edges[inner].T
    c, d = mesh.edge_opposites[inner].T
    # Orient: the first face runs a -> b (then its third vertex is c).
    first_face = faces[mesh.edge_faces[inner, 0]]
    runs = ((first_face == a[:, None]) & (np.roll(first_face, -1, axis=1) == b[:, None])).any(axis=1)
    a, b = np.where(runs, a, b), np.where(runs, b, a)

    new_one, new_two = np.column_stack([c, d, b]), np.column_stack([d, c, a])
    quality_new = np.minimum(_quality(vertices, new_one), _quality(vertices, new_two))
    normal_old = face_cross_products(vertices, np.column_stack([a, b, c]))
    normal_old += face_cross_products(vertices, np.column_stack([b, a, d]))
    aligned = np.ones(len(a), dtype=bool)
    for new in (new_one, new_two):
        cross = face_cross_products(vertices, new)
        dot = np.einsum("ij,ij->i", cross, normal_old)
        aligned &= dot > 0.6 * np.linalg.norm(cross, axis=1) * np.linalg.norm(normal_old, axis=1)
    better = (gain > 0) & (quality_new > np.minimum(0.5, 0.9 * quality_old))
    better |= (gain > -2) & (quality_new > 1.2 * quality_old + 0.05) & (quality_old < 0.6)
    key = np.minimum(c, d) * len(vertices) + np.maximum(c, d)
    place = np.minimum(np.searchsorted(mesh.edge_keys, key), len(mesh.edge_keys) - 1)
    fine = better & aligned & (mesh.edge_keys[place] != key) & (valence[a] > 3) & (valence[b] > 3)
    fine &= ~((mesh.border_vertices[a] & (valence[a] <= 3)) | (mesh.border_vertices[b] & (valence[b] <= 3)))
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
    faces[mesh.edge_faces[inner[won], 0]] = new_one[won]
    faces[mesh.edge_faces[inner[won], 1]] = new_two[won]
    return faces, len(won)


def relax(vertices: np.ndarray, faces: np.ndarray, locked: np.ndarray) -> np.ndarray:
    """Vertices each moved towards the mean of its neighbours within the surface; border vertices along the border.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        locked: (vertices,) bool, vertices that do not move.

    Returns:
        (vertices, 3) [m].
    """
    mesh = Topology(faces, len(vertices))
    a, b = mesh.edges.T
    border = mesh.border_vertices
    # A border vertex listens to its two border neighbours only.
    weight_a = np.where(border[a], mesh.edge_face_counts == 1, True).astype(float)
    weight_b = np.where(border[b], mesh.edge_face_counts == 1, True).astype(float)
    total = np.zeros_like(vertices)
    for axis in range(3):
        total[:, axis] = np.bincount(a, weights=weight_a * vertices[b, axis], minlength=len(vertices))
        total[:, axis] += np.bincount(b, weights=weight_b * vertices[a, axis], minlength=len(vertices))
    weight = np.bincount(a, weights=weight_a, minlength=len(vertices))
    weight += np.bincount(b, weights=weight_b, minlength=len(vertices))
    shift = total / np.maximum(weight, 1.0)[:, None] - vertices
    normals = cornerwise_normals(vertices, faces)
    inward = np.einsum("ij,ij->i", shift, normals)[:, None] * normals
    shift = shift - np.where(border[:, None], 0.0, inward)
    shift[locked] = 0.0
    return vertices + _RELAXATION * shift


def cornerwise_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit vertex normals, summed corner by corner.

    The mean is that of `triangle_mesh.area_weighted_normals`; the order of its sum, and so its last digit, is not.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.

    Returns:
        (vertices, 3) [1]; 0 where no face is.
    """
    cross = face_cross_products(vertices, faces)
    total = np.zeros_like(vertices)
    for axis in range(3):
        for corner in range(3):
            total[:, axis] += np.bincount(faces[:, corner], weights=cross[:, axis], minlength=len(vertices))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
