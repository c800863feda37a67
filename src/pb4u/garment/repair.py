"""Mends of a garment's mesh that are safe to make without its author."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import ShapedBody
from pb4u.body.length_units import UNITS
from pb4u.collision.crossings import self_crossings
from pb4u.garment.fit import UPRIGHT, RestBody, find_fit, is_inside_out
from pb4u.garment.source_surface import SourceSurface
from pb4u.garment.surface_faults import is_double
from pb4u.garment.surface_parts import inner_layer, sewn_on
from pb4u.garment.thread_seams import drawn_together, sewable_threads
from pb4u.garment.untangling import untangle
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.topology import Topology, neighbour_mean

# A garment with more of its vertices inside the body than this is of another size, not in want of a push.
_DEEPEST_SHARE = 0.6
CLEARANCE = 2e-3
"""Distance [m] from the skin to which cloth is pushed out."""
# Most passes of each kind: both end when nothing is left to push, which a crease without room would never allow.
_SMOOTHING_PASSES, _PROJECTION_PASSES = 20, 40


class Repaired(NamedTuple):
    """A garment after `repair`.

    Args:
        mesh: the garment.
        changes: a plain sentence for each change.
        remarks: a plain sentence for each fault that was not repaired.
    """

    mesh: PolygonMesh
    changes: tuple[str, ...]
    remarks: tuple[str, ...]


def repair(source: PolygonMesh, body: ShapedBody | AnimatedBody | None = None) -> Repaired:
    """Repair every repairable fault of a garment.

    Polygons and UVs are kept; vertex order too, unless vertices had to be welded or dropped. No more pairs of triangles
    cross than before.

    Args:
        source: the garment.
        body: the body that wears it; without a body only the mesh itself is repaired.
    """
    changes, remarks = list[str](), list[str]()
    if not len(SourceSurface.of(source).faces):
        return Repaired(source, (), ())
    rest = None if body is None else RestBody.of(body)
    if rest is not None:
        source = _moved(source, rest, changes, remarks)
    source = _without_parts(source, rest, changes, remarks)
    source = _welded(source, changes, remarks)
    source = _without_waste(source, changes)
    source = _oriented(source, rest, changes)
    if rest is not None and rest.is_closed:
        source = _pushed_out(source, rest, changes, remarks)
    return Repaired(source, tuple(changes), tuple(remarks))


def _moved(source: PolygonMesh, body: RestBody, changes: list[str], remarks: list[str]) -> PolygonMesh:
    surface = SourceSurface.of(source)
    threads = sewable_threads(surface)
    sewn = drawn_together(surface, threads) if len(threads) else source
    fit = find_fit(sewn.vertices[np.unique(surface.faces)], body)
    if fit.is_identity:
        return source
    if fit.is_unsure:
        remarks.append("It was not moved: its shape does not show where on the body it belongs.")
        return source
    if fit.unit != "metres":
        changes.append(f"Scaled by {UNITS[fit.unit]:g}, from {fit.unit} to metres.")
    if fit.axes != UPRIGHT:
        changes.append(f"Turned from {fit.axes} to {UPRIGHT}.")
    if fit.shift.any():
        changes.append(f"Moved by {fit.move} on to the body, {1000 * fit.misfit:.0f} mm off on average.")
    if fit.front_alike:
        remarks.append(f"Front and back fit equally well: {fit.axes} was chosen, {fit.front_alike[0]} is as likely.")
    return replace(source, vertices=fit.apply(source.vertices))


def _without_parts(source: PolygonMesh, body: RestBody | None, changes: list[str], remarks: list[str]) -> PolygonMesh:
    """Drops what is sewn on where two faces meet already, and the inner layer of a double cloth."""
    surface = SourceSurface.of(source)
    on = sewn_on(surface)
    if on.any():
        source, count = _without(source, surface, on)
        changes.append(f"Removed {count} faces of parts sewn on, such as pockets or flaps.")
        surface = SourceSurface.of(source)
    if not is_double(surface):
        return source
    heights = None if body is None or not body.is_closed else body.signed_distances(source.vertices)
    inner = inner_layer(surface, heights)
    single, count = _without(source, surface, inner)
    if not inner.any() or is_double(SourceSurface.of(single)):
        remarks.append("Its cloth stays double: the inner layer could not be distinguished from the outer one.")
        return source
    changes.append(f"Kept the outer layer of its cloth, and dropped {count} faces.")
    return single


def _without(source: PolygonMesh, surface: SourceSurface, faces: np.ndarray) -> tuple[PolygonMesh, int]:
    """The mesh without the polygons of some kept triangles (faces,) bool and the vertices of these alone; how many."""
    gone = np.unique(surface.polygon[surface.kept[faces]])
    keep = np.setdiff1d(np.arange(len(source.polygons)), gone)
    polygons = [source.polygons[k] for k in keep.tolist()]
    lost = np.setdiff1d(np.concatenate(source.polygons), np.concatenate(polygons))
    used = np.setdiff1d(np.arange(len(source.vertices)), lost)
    return PolygonMesh(
        source.vertices[used],
        tuple(np.searchsorted(used, polygon) for polygon in polygons),
        source.uvs,
        None if source.polygon_uvs is None else tuple(source.polygon_uvs[k] for k in keep.tolist()),
        None if source.appearances is None else source.appearances.at(keep),
        lines=_kept_lines(source, used),
    ), len(gone)


def _welded(source: PolygonMesh, changes: list[str], remarks: list[str]) -> PolygonMesh:
    surface = SourceSurface.of(source)
    target = surface.weld_target
    joined = Topology(target[surface.faces], len(target))
    if not len(surface.unwelded):
        return source
    if len(joined.non_manifold_edges) > len(surface.topology.non_manifold_edges):
        remarks.append("Seams were left open: welded, more than two faces would share an edge.")
        return source
    if len(surface.topology.boundary_loops) and not len(joined.boundary_loops):
        remarks.append(
            "Seams were left open: welded, the garment would have no opening; check whether every face exists twice."
        )
        return source
    changes.append(f"Welded {len(surface.unwelded)} border vertices.")
    lines = None if source.lines is None else target[source.lines]
    return replace(source, polygons=tuple(target[p] for p in source.polygons), lines=lines)


def _without_waste(source: PolygonMesh, changes: list[str]) -> PolygonMesh:
    """Drops faces without area, faces there twice and vertices of no face."""
    surface = SourceSurface.of(source)
    keep = np.unique(surface.polygon[surface.kept])
    dropped = len(source.polygons) - len(keep)
    polygons = [source.polygons[k] for k in keep.tolist()]
    uvs = None if source.polygon_uvs is None else [source.polygon_uvs[k] for k in keep.tolist()]
    for k, polygon in enumerate(polygons):
        # A corner that repeats the one before it makes a polygon that is otherwise sound.
        distinct = polygon != np.roll(polygon, 1)
        if not distinct.all():
            polygons[k] = polygon[distinct]
            if uvs is not None:
                uvs[k] = uvs[k][distinct]
    if dropped:
        changes.append(f"Dropped {dropped} face(s) without area or repeated.")
    used = np.unique(np.concatenate(polygons)) if polygons else np.zeros(0, dtype=np.int64)
    if len(used) < len(source.vertices):
        changes.append(f"Dropped {len(source.vertices) - len(used)} vertices that no face uses.")
    return PolygonMesh(
        source.vertices[used],
        tuple(np.searchsorted(used, p) for p in polygons),
        source.uvs,
        None if uvs is None else tuple(uvs),
        None if source.appearances is None else source.appearances.at(keep),
        lines=_kept_lines(source, used),
    )


def _kept_lines(source: PolygonMesh, used: np.ndarray) -> np.ndarray | None:
    """The lines (lines, 2) between vertices that are kept, `used` (kept,), by their new numbers."""
    if source.lines is None:
        return None
    return np.searchsorted(used, source.lines[np.isin(source.lines, used).all(axis=1)])


def _oriented(source: PolygonMesh, body: RestBody | None, changes: list[str]) -> PolygonMesh:
    surface = SourceSurface.of(source)
    flip = surface.flipped[0]
    turn = np.zeros(len(source.polygons), dtype=bool)
    turn[surface.turned_over] = True
    if turn.any():
        changes.append(f"Turned {int(turn.sum())} face(s) over to agree with their neighbours.")
    faces = np.where(flip[:, None], surface.faces[:, ::-1], surface.faces)
    if body is not None and len(faces) and is_inside_out(source.vertices, faces, body):
        turn = ~turn
        changes.append("Turned the garment right side out.")
    if not turn.any():
        return source

    def turned(polygons: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        return tuple(p[::-1] if t else p for p, t in zip(polygons, turn.tolist(), strict=True))

    uvs = None if source.polygon_uvs is None else turned(source.polygon_uvs)
    return replace(source, polygons=turned(source.polygons), polygon_uvs=uvs)


def _pushed_out(source: PolygonMesh, body: RestBody, changes: list[str], remarks: list[str]) -> PolygonMesh:
    inside = body.signed_distances(source.vertices) < 0.0
    if not inside.any():
        return source
    if inside.mean() > _DEEPEST_SHARE:
        remarks.append(f"{int(inside.sum())} vertices stay inside the body: the garment is too small for it.")
        return source
    surface = SourceSurface.of(source)
    vertices = push_out(source.vertices, surface.topology, body)
    before = len(self_crossings(source.vertices, surface.faces, sharing=True))
    pairs = len(self_crossings(vertices, surface.faces, sharing=True)) - before
    if pairs > 0:
        untangled = untangle(vertices, surface.faces, gap=0.0)
        still = body.signed_distances(untangled.vertices) < 0.0
        if len(untangled.crossings) > before or still.sum() >= inside.sum():
            remarks.append(
                f"{int(inside.sum())} vertices stay inside the body: pushing them out would make {pairs} more pairs "
                "of triangles cross."
            )
            return source
        vertices = untangled.vertices
    farthest = float(np.linalg.norm(vertices - source.vertices, axis=1).max())
    changes.append(
        f"Pushed {int(inside.sum())} vertices out of the body to {1000 * CLEARANCE:.0f} mm of clearance, "
        f"by at most {1000 * farthest:.1f} mm."
    )
    if pairs > 0:
        changes.append(f"Untangled {pairs} pairs of triangles that the push had made cross.")
    if count := int((body.signed_distances(vertices) < 0.0).sum()):
        remarks.append(f"{count} vertices are still inside the body.")
    return replace(source, vertices=vertices)


def push_out(vertices: np.ndarray, topology: Topology, body: RestBody) -> np.ndarray:
    """Cloth moved to at least `CLEARANCE` outside a closed body, if the body's creases leave room.

    Vertices too near are projected out, the displacement is spread over the neighbouring cloth so that it does not
    crease, and what this brings back in is projected again. Middles of edges are kept outside too.

    Args:
        vertices: (vertices, 3) of the garment [m].
        topology: its connectivity.
        body: the resting body, closed.

    Returns:
        (vertices, 3) [m].
    """
    spread = neighbour_mean(topology)
    distances = body.signed_distances(vertices)
    # Only cloth this near can be reached by what is pushed; the rest need not be searched in each pass.
    near = distances < 2.0 * max(0.0, -float(distances.min())) + 2.0 * CLEARANCE
    a, b = topology.edges[near[topology.edges].all(axis=1)].T
    places = vertices.copy()
    for _ in range(_SMOOTHING_PASSES):
        push = np.zeros_like(places)
        push[near] = _push(places[near], body, CLEARANCE)
        across = _push(0.5 * (places[a] + places[b]), body, 0.25 * CLEARANCE)
        for end in (a, b):
            larger = np.einsum("ij,ij->i", across, across) > np.einsum("ij,ij->i", push[end], push[end])
            push[end[larger]] = across[larger]
        if not push.any():
            break
        displacement = places + push - vertices
        places = vertices + 0.5 * (displacement + spread @ displacement)
    inside = np.arange(len(places))
    for _ in range(_PROJECTION_PASSES):
        push = _push(places[inside], body, CLEARANCE)
        inside, push = inside[push.any(axis=1)], push[push.any(axis=1)]
        if not len(inside):
            break
        # A little further than needed: in a crease the last fraction would take forever.
        places[inside] += 1.02 * push
    return places


def _push(points: np.ndarray, body: RestBody, clearance: float) -> np.ndarray:
    """(points, 3) smallest displacement [m] that brings each point `clearance` outside; 0 where it is already."""
    near = body.surface.nearest(points)
    depth = clearance - near.signed_distance.numpy()
    return np.where(depth > 1e-6, depth, 0.0)[:, None] * near.normals.numpy()
