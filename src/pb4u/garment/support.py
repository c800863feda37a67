"""What holds a garment up on the resting body: its shoulders, straps, a waistband, a collar, or nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pb4u.garment.fit import RestBody
from pb4u.garment.pins import collar_of, highest_reaching
from pb4u.garment.tacks import sewn
from pb4u.geometry.topology import Topology, connected_labels
from pb4u.geometry.triangle_mesh import face_areas

# Share of the body's height above which cloth counts: feet face up as well, but a garment that lies there fell.
_LEAST_HEIGHT = 0.6
# Least upward part of the skin's unit normal where cloth can lie; hips and chest slope more than that.
_FACING_UP = 0.75
# Greatest distance [m] between the skin and the cloth that comes to lie on it.
_RESTING = 0.1
LEAST_AREA = 5e-4
"""Cloth [m^2] over such skin that is a rest: a few square centimetres, as of a strap."""
STRAP_AREA = 6e-3
"""Cloth [m^2] on the shoulders below which it is straps: two of 3 cm by 10; a T-shirt has four times as much."""
# Shares of the body's height between which a waistband sits, and the mean distance to the skin [m] of what holds.
_WAIST, _CLOSE = (0.5, 0.75), 0.03
_LEVEL = 0.1
"""Share of the body's height that a waistband spans at most; the border of a bib with its straps spans more."""
_SEWABLE = 0.03
"""Distance [m] between the end of a strap and a border across which it is taken to be left unsewn."""


def _resting(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> np.ndarray:
    """Mask (faces,) of the cloth that lies on skin which faces up."""
    ground, top = float(body.vertices[:, 1].min()), float(body.vertices[:, 1].max())
    centres = vertices[faces].mean(axis=1)
    rests = centres[:, 1] > ground + _LEAST_HEIGHT * (top - ground)
    if rests.any():
        below = body.surface.nearest(centres[rests])
        upward = below.normals.numpy()[:, 1] > _FACING_UP
        rests[rests] = upward & (np.abs(below.signed_distance.numpy()) < _RESTING)
    return rests


class Strap(NamedTuple):
    """Cloth that passes over a shoulder and has a loose end.

    Args:
        end: (n,) int64 vertices at its end.
        gap: distance [m] from that end to the garment.
        tacks: pairs of vertices that sew it on; none where it ends too far away.
    """

    end: np.ndarray
    gap: float
    tacks: tuple[tuple[int, int], ...]


def _closing(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> tuple[np.ndarray, tuple[Strap, ...]]:
    """Mask (faces,) of the cloth that lies on skin which faces up and hangs on from both sides, and the loose straps.

    Without that cloth, what is left of the garment is a largest part and others: it has to meet the largest in front of
    its middle and behind.
    """
    resting = _resting(vertices, faces, body)
    if not resting.any():
        return resting, ()
    topology = Topology(faces, len(vertices))
    a, b = topology.edges.T
    part_of_vertex = Topology(faces[resting], len(vertices)).piece_of_vertex
    loose, straps = np.zeros(len(faces), dtype=bool), []
    for number in np.unique(part_of_vertex[faces[resting]]):
        patch = part_of_vertex == number
        apart = ~patch[a] & ~patch[b]
        part = connected_labels(len(vertices), a[apart], b[apart])
        main = ~patch & (part == np.bincount(part[~patch], minlength=1).argmax()) if not patch.all() else ~patch
        contacts = np.concatenate([a[patch[a] & main[b]], b[patch[b] & main[a]]])
        middle = vertices[patch, 2].mean()
        if len(contacts) and vertices[contacts, 2].min() < middle < vertices[contacts, 2].max():
            continue
        loose |= resting & patch[faces[:, 0]]
        hung = np.unique(part[np.concatenate([a[patch[b] & ~patch[a] & ~main[a]], b[patch[a] & ~patch[b] & ~main[b]]])])
        if len(contacts) and (strap := _strap(vertices, topology, patch | np.isin(part, hung), contacts, main)):
            straps.append(strap)
    return resting & ~loose, tuple(straps)


def _strap(
    vertices: np.ndarray, topology: Topology, cloth: np.ndarray, begins: np.ndarray, main: np.ndarray
) -> Strap | None:
    """The strap of some `cloth` (vertices,) bool that begins at the `main` garment and ends elsewhere."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    a, b = topology.edges[cloth[topology.edges].all(axis=1)].T
    lengths = np.linalg.norm(vertices[a] - vertices[b], axis=1)
    graph = coo_matrix((lengths, (a, b)), shape=(len(vertices), len(vertices)))
    away = dijkstra(graph, directed=False, indices=np.unique(begins), min_only=True)
    border = topology.border_vertices
    away = np.where(np.isfinite(away) & border & cloth, away, -np.inf)
    end = np.flatnonzero(away > away.max() - 1.5 * float(np.median(lengths)))
    if not len(end) or not (main & border).any():
        return None
    # On a border first; an end that lies farther within a panel is sewn there.
    for targets in (np.flatnonzero(main & border), np.flatnonzero(main)):
        gaps, nearest = cKDTree(vertices[targets]).query(vertices[end])
        if gaps.min() < _SEWABLE:
            break
    tacks: list[tuple[int, int]] = []
    for k in np.argsort(gaps).tolist():
        pair = int(end[k]), int(targets[nearest[k]])
        if gaps[k] < _SEWABLE and sewn(topology.faces, len(vertices), np.array([*tacks, pair])) is not None:
            tacks.append(pair)
    return Strap(end, float(gaps.min()), tuple(tacks))


class Support(NamedTuple):
    """The part of a garment that holds it up.

    Args:
        name: "shoulders", "straps", "waistband" or "collar"; None for nothing.
        area: cloth that lies on the shoulders, or on other skin of the upper part that faces up [m^2]; cloth that is
            connected on one side only, such as a strap with a loose end, does not count.
        held: (vertices,) bool, vertices of the straps, waistband or collar, which hold the garment only if pinned; None
            for shoulders or nothing.
        loose: straps that end unsewn beyond the shoulder.
    """

    name: str | None
    area: float
    held: np.ndarray | None = None
    loose: tuple[Strap, ...] = ()


def find_support(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> Support:
    """Shoulders, straps too narrow to stay on them by friction, the collar of an open front, or a border at the waist.

    A real waistband is elastic or buttoned, and straps are sewn on under tension; plain simulated cloth has neither.
    Nor does anything keep the halves of an open front from sliding down the arms; in life the wearer does. A bodice
    that fits closely far above the waist can hold without shoulders all the same; that is not seen here.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the resting body.
    """
    resting, loose = _closing(vertices, faces, body)
    area = float(face_areas(vertices, faces[resting]).sum())
    if area >= STRAP_AREA:
        collar = _open_collar(vertices, faces, body)
        return Support("shoulders" if collar is None else "collar", area, collar, loose)
    if area >= LEAST_AREA:
        straps = np.zeros(len(vertices), dtype=bool)
        straps[faces[resting].ravel()] = True
        return Support("straps", area, straps, loose)
    band = _waistband(vertices, faces, body)
    return Support(None if band is None else "waistband", area, band, loose)


def _waistband(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> np.ndarray | None:
    """Mask (vertices,) of a level border that goes closely around the waist."""
    ground, top = float(body.vertices[:, 1].min()), float(body.vertices[:, 1].max())
    middle = 0.5 * (body.vertices.min(axis=0) + body.vertices.max(axis=0))
    for loop in sorted(Topology(faces, len(vertices)).boundary_loops, key=lambda loop: -vertices[loop, 1].mean()):
        ring = vertices[loop]
        height = (float(ring[:, 1].mean()) - ground) / (top - ground)
        x, z = (ring - middle)[:, [0, 2]].T
        # Once around the body's axis; a leg's border goes around none of it.
        turn = np.angle(np.exp(1j * np.diff(np.arctan2(z, x), append=np.arctan2(z[:1], x[:1])))).sum()
        close = float(np.abs(body.signed_distances(ring)).mean()) < _CLOSE
        level = float(np.ptp(ring[:, 1])) < _LEVEL * (top - ground)
        if _WAIST[0] < height < _WAIST[1] and abs(turn) > np.pi and close and level:
            mask = np.zeros(len(vertices), dtype=bool)
            mask[loop] = True
            return mask
    return None


def _open_collar(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> np.ndarray | None:
    """Mask (vertices,) of the collar of an open front: the border at its neck goes on to below the garment's middle."""
    loops = Topology(faces, len(vertices)).boundary_loops
    if not loops:
        return None
    border = highest_reaching(vertices, loops)
    middle = 0.5 * float(vertices[:, 1].min() + vertices[:, 1].max())
    collar = collar_of(vertices, border)
    if vertices[border, 1].min() > middle or np.abs(body.signed_distances(vertices[collar])).mean() > _CLOSE:
        return None
    mask = np.zeros(len(vertices), dtype=bool)
    mask[collar] = True
    return mask
