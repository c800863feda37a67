"""Which pieces of a character's surface are its skin, by what covers what: clothes, helpers and props are none.

Artists' meshes hold more than a body: helpers that clothes are fitted to and small cubes at joints (MakeHuman), clothes
under any name, hulls for outlines, tools. Whatever lies over other skin would keep cloth from it, and whatever stands
beside it would be dressed.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from pb4u.body.character_surface import CharacterSurface
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import face_areas, face_cross_products

# Share of the surface from which on a piece is looked at by itself; eyes, teeth and joint cubes are smaller.
_LARGE = 0.01
# Faces of a piece that are looked at, and the share of them under which skin lies that makes it a cover.
_SAMPLES, _COVER = 500, 0.5
# Shares of the height: how far under a cover skin lies at most, how thick cloth is at most, and how near the borders of
# pieces of one skin are.
_REACH, _CLOTH, _SEAM = 0.2, 0.005, 0.006
# Depths under a face, as shares of that at which other skin lies, at which its own other side is looked for.
_DEPTHS = (0.1, 0.2, 0.35, 0.5, 0.7)
# Share of the skin that one piece has where what stands beside it is not skin; of a piece, what is of limbs that the
# rest lacks; and of a limb, what the rest has of one that it lacks.
_MAIN, _OWN_LIMB, _LIMB_END = 0.5, 0.2, 0.05


def skin_vertices(surface: CharacterSurface, limbs: np.ndarray) -> np.ndarray:
    """Mask (vertices,) bool of the vertices of the skin.

    A piece that lies over others is not skin. If one of the remaining pieces has most of the area, the others are skin
    only if they continue it at a border or have limbs of their own, such as a head or a hand modelled separately.

    Args:
        surface: all meshes that may be skin, in the bind pose, not welded.
        limbs: (bones,) int64 number of the limb or head of each bone; -1 for none.
    """
    welded, number = surface.welded()
    topology = Topology(welded.faces, len(welded.vertices))
    piece = topology.piece_of_vertex[welded.faces[:, 0]]
    names, piece = np.unique(piece, return_inverse=True)
    if len(names) < 2:
        return np.ones(len(number), dtype=bool)
    area = face_areas(welded.vertices, welded.faces)
    areas = np.bincount(piece, area)
    large = areas >= _LARGE * areas.sum()
    skin = np.ones(len(names), dtype=bool)
    for k in np.flatnonzero(large):
        skin[k] = _cover(welded, piece, int(k), large) < _COVER
    if not skin.any():
        return np.ones(len(number), dtype=bool)
    main = int(np.where(skin, areas, 0.0).argmax())
    if areas[main] >= _MAIN * areas[skin].sum():
        skin &= _beside(welded, topology, piece, main, large, limbs)
    is_skin = np.zeros(len(welded.vertices), dtype=bool)
    is_skin[welded.faces[skin[piece]]] = True
    return is_skin[number]


def _cover(surface: CharacterSurface, piece: np.ndarray, k: int, large: np.ndarray) -> float:
    """Share of a piece under which other large pieces lie, as skin lies under cloth."""
    rows, others = np.flatnonzero(piece == k), np.flatnonzero(large[piece] & (piece != k))
    if not len(others):
        return 0.0
    height = float(np.ptp(surface.vertices, axis=0).max())
    centres = surface.vertices[surface.faces].mean(axis=1)
    normals = face_cross_products(surface.vertices, surface.faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    area = face_areas(surface.vertices, surface.faces)[rows]
    # Turned by the volume about its own middle: an open tube has none about another point.
    away = np.einsum("fc,fc,f->", centres[rows] - np.average(centres[rows], axis=0, weights=area), normals[rows], area)
    outward = normals[rows] * (1.0 if away >= 0.0 else -1.0)
    spread = np.searchsorted(np.cumsum(area), (np.arange(_SAMPLES) + 0.5) / _SAMPLES * area.sum())
    places, looks = centres[rows][spread], outward[spread]
    distance, at = cKDTree(centres[others]).query(places)
    offset = centres[others][at] - places
    depth = -np.einsum("ij,ij->i", offset, looks)
    under = (distance < _REACH * height) & (depth > 0.3 * distance)
    under &= np.einsum("ij,ij->i", normals[others][at], looks) > 0.2
    # Where its own other side lies between, it is a limb beside the body, not cloth over it.
    tree = cKDTree(centres[rows])
    for share in _DEPTHS:
        step = share * distance
        gap, there = tree.query(places - step[:, None] * looks)
        turned = np.einsum("ij,ij->i", outward[there], looks) < -0.3
        below = -np.einsum("ij,ij->i", centres[rows][there] - places, looks)
        under &= ~(turned & (gap < 0.5 * step) & (below > _CLOTH * height) & (below < depth))
    return float(under.mean())


def _beside(
    surface: CharacterSurface, topology: Topology, piece: np.ndarray, main: int, large: np.ndarray, limbs: np.ndarray
) -> np.ndarray:
    """Mask (pieces,) bool of what belongs to the skin whose `main` piece is the most of it."""
    height = float(np.ptp(surface.vertices, axis=0).max())
    limb, count = limbs[surface.bones], len(large)
    of_vertex = np.full(len(surface.vertices), -1)
    of_vertex[surface.faces] = piece[:, None]
    used = of_vertex >= 0
    weight = np.zeros((count, int(limbs.max()) + 2))  # the last one is of no limb
    # By area, since what is modelled finely weighs no more.
    area = np.repeat(face_areas(surface.vertices, surface.faces) / 3.0, 3)
    share = np.bincount(surface.faces.reshape(-1), area, len(surface.vertices))
    np.add.at(weight, (of_vertex[used][:, None], limb[used]), (share[:, None] * surface.weights)[used])
    size, weight = weight.sum(axis=1), weight[:, :-1]
    most = weight.sum(axis=0)
    border = np.flatnonzero(topology.border_vertices)
    joined = np.zeros(count, dtype=bool)
    joined[main] = True
    while True:
        new = weight[joined].sum(axis=0) <= _LIMB_END * most
        more = ~joined & large & (weight[:, new].sum(axis=1) > _OWN_LIMB * size)
        there, open_ = border[joined[of_vertex[border]]], border[~joined[of_vertex[border]]]
        if len(there) and len(open_):
            near = cKDTree(surface.vertices[there]).query(surface.vertices[open_])[0] < _SEAM * height
            touching = np.bincount(of_vertex[open_][near], minlength=count)
            more |= ~joined & (touching > 0.5 * np.bincount(of_vertex[open_], minlength=count).clip(1))
        if not more.any():
            return joined
        joined |= more
