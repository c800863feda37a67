"""The passes of the penetration clean-up, compiled as one: another thread goes on with the next step meanwhile."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pb4u.collision.jit import compiled
from pb4u.collision.nearest_points import Found, Searched, update_closest
from pb4u.collision.surface_elements import any_corner
from pb4u.collision.wide_tree import fit, fit_again
from pb4u.physics.contact.penetration_loops import add_lifts, carry_found, move_vertices
from pb4u.physics.contact.skin_cover import SKIN_OVER_CLOTH, described


class Body(NamedTuple):
    """The body of a world as clean-up sees it.

    Args:
        searched: its surface.
        names: (faces,) int64 what answers call each face.
        skin_faces: number of faces that are skin; the faces after them are caps.
        points: (vertices, 3) [m] nearest points of the surface to the vertices of the cloth.
        distances: (vertices,) [m] from these points.
    """

    searched: Searched
    names: np.ndarray
    skin_faces: int
    points: np.ndarray
    distances: np.ndarray


class Cloth(NamedTuple):
    """The cloth of a world as clean-up sees it.

    Args:
        faces: (faces, 3) int64 of its surface, counted from its own first vertex.
        names: (faces,) int64 what answers call each.
        fans: as in `Searched`.
        order: as in `Searched`.
        children: as in `Searched`.
        bottoms: as in `Searched`.
        levels: of its tree.
        first: its first vertex.
        stop: vertex after its last one.
    """

    faces: np.ndarray
    names: np.ndarray
    fans: tuple
    order: np.ndarray
    children: np.ndarray
    bottoms: int
    levels: np.ndarray
    first: int
    stop: int


class _Middles(NamedTuple):
    """Elements of the cloth of one world whose middles may be too near to its body.

    Args:
        corners: (elements, corners) int64.
        wanted: (elements,) [m] distance that each keeps.
        found: of the body, for each middle.
    """

    corners: np.ndarray
    wanted: np.ndarray
    found: Found


class _Skin(NamedTuple):
    """Places on the skin of one world.

    Args:
        places: (places, 3) [m].
        normals: (places, 3) outward unit normals.
        found: of the cloth, for each place; at first a place at the end of their reach, and no cloth.
    """

    places: np.ndarray
    normals: np.ndarray
    found: Found


@compiled
def lifted_off(
    before: np.ndarray,
    movable: np.ndarray,
    between: bool,
    elements: tuple[np.ndarray, np.ndarray, np.ndarray],
    sag: np.ndarray,
    skin: tuple[np.ndarray, np.ndarray],
    body: Body,
    cloth: Cloth,
    limits: tuple[float, int, float],
) -> np.ndarray:
    """Positions (vertices, 3) [m] of the cloth of all worlds, with the cloth of one world moved off its body.

    Every pass tests the vertices, the midpoints of edges and faces, and the skin that cloth has to cover, and then
    moves them together.

    Args:
        before: (vertices, 3) [m].
        movable: (vertices,) bool.
        between: test only elements between movable vertices.
        elements: (vertices, 1), (edges, 2) and (faces, 3) int64 of the cloth.
        sag: (vertices,) [m] added to the clearance for edges and faces.
        skin: (places, 3) [m] on the skin, and its unit normals there.
        body: of the world.
        cloth: of the world.
        limits: clearance [m], number of passes, and largest displacement [m] in one.
    """
    clearance, passes, largest = limits
    x, chosen = before.copy(), movable if between else np.ones(len(before), dtype=np.bool_)
    vertices = _near(x, elements[0], body, cloth, chosen, clearance, np.zeros(len(x)))
    edges = _near(x, elements[1], body, cloth, chosen, clearance, sag)
    faces = _near(x, elements[2], body, cloth, chosen, clearance, sag)
    places = _Skin(skin[0], skin[1], _unknown(skin[0] + SKIN_OVER_CLOTH * skin[1]))
    moved, fitted = np.zeros(len(x)), fit(x[cloth.first : cloth.stop], cloth.faces, cloth.order, cloth.levels)
    for number in range(passes):
        direction, size = np.zeros(x.shape), np.zeros(len(x))
        vertices = _lift_middles(direction, size, x, vertices, body)
        edges = _lift_middles(direction, size, x, edges, body)
        faces = _lift_middles(direction, size, x, faces, body)
        if len(places.places):
            places = _lift_off_skin(direction, size, x, moved, number == 0, places, cloth, fitted, clearance)
        if not move_vertices(x, direction, size, movable, largest):
            break
        moved = size
    return x


@compiled
def _unknown(near: np.ndarray) -> Found:
    """As `Found.nothing`, of points of the surface that are `near` (points, 3) [m]."""
    count = len(near)
    return Found(
        np.full((count, 3), np.nan),
        np.zeros(count, dtype=np.int64),
        np.zeros((count, 3)),
        near,
        np.zeros((count, 3)),
        np.full(count, np.inf),
        np.ones(count, dtype=np.bool_),
    )


@compiled
def _among(found: Found, rows: np.ndarray) -> Found:
    """What was found for some `rows` (rows,) int64."""
    return Found(
        found.at[rows],
        found.triangle[rows],
        found.barycentric[rows],
        found.positions[rows],
        found.normals[rows],
        found.distances[rows],
        found.beyond[rows],
    )


@compiled
def _near(
    x: np.ndarray,
    corners: np.ndarray,
    body: Body,
    cloth: Cloth,
    chosen: np.ndarray,
    clearance: float,
    sag: np.ndarray,
) -> _Middles:
    """Elements between `chosen` (vertices,) vertices of a world whose middle may be too near to its body.

    It is no nearer than a corner less the way from there. `sag` (vertices,) [m] of its first corner is an element's.
    """
    near = np.zeros(len(corners), dtype=np.bool_)
    count = corners.shape[1]
    for row in range(len(corners)):
        far, looked_at = -np.inf, cloth.first <= corners[row, 0] < cloth.stop
        for k in range(count):
            looked_at = looked_at and chosen[corners[row, k]]
        if not looked_at:
            continue
        for k in range(count):
            squared = 0.0
            for axis in range(3):
                middle = 0.0
                for other in range(count):
                    middle += x[corners[row, other], axis]
                squared += (x[corners[row, k], axis] - middle / count) ** 2
            far = max(far, body.distances[corners[row, k]] - np.sqrt(squared))
        near[row] = far < clearance + sag[corners[row, 0]]
    rows = np.flatnonzero(near)
    kept = corners[rows]
    # What is nearest to a corner bounds what is nearest to the middle.
    return _Middles(kept, clearance + sag[kept[:, 0]], _unknown(body.points[kept[:, 0]]))


@compiled
def _lift_middles(direction: np.ndarray, size: np.ndarray, x: np.ndarray, middles: _Middles, body: Body) -> _Middles:
    """Lift elements whose middle is too near to the body, and give back those."""
    corners, found = middles.corners, middles.found
    count = corners.shape[1]
    points, low = np.empty((len(corners), 3)), np.empty(len(corners), dtype=np.bool_)
    for row in range(len(corners)):
        for axis in range(3):
            middle = x[corners[row, 0], axis]
            for k in range(1, count):
                middle += x[corners[row, k], axis]
            points[row, axis] = middle / count
    update_closest(body.searched, body.names, points, np.inf, 0.0, False, found)
    for row in range(len(corners)):
        # Where a region is left out of contact there is no skin, nor is the cap of one.
        is_skin = not found.beyond[row] and found.triangle[row] < body.skin_faces
        low[row] = is_skin and found.distances[row] < middles.wanted[row]
    rows = np.flatnonzero(low)
    kept = _Middles(corners[rows], middles.wanted[rows], _among(found, rows))
    shares = np.full(kept.corners.shape, 1.0 / count)
    add_lifts(direction, size, kept.corners, shares, kept.wanted - kept.found.distances, kept.found.normals)
    return kept


@compiled
def _lift_off_skin(
    direction: np.ndarray,
    size: np.ndarray,
    x: np.ndarray,
    moved: np.ndarray,
    new: bool,
    skin: _Skin,
    cloth: Cloth,
    fitted: tuple[np.ndarray, np.ndarray],
    clearance: float,
) -> _Skin:
    """Lift the faces that skin shows through; the skin that has cloth of its own near it is given back.

    Cloth is searched for again where it `moved` (vertices,) [m] since the pass before, everywhere where that is `new`.
    Its tree was `fitted` to where it was then.
    """
    corners, boxes = fitted
    own, faces, found = x[cloth.first : cloth.stop], cloth.faces, skin.found
    went = any_corner(faces, moved[cloth.first : cloth.stop] > 0.0)
    if new or went.any():
        if not new:
            alone = fit_again(own, faces, went, cloth.order, cloth.levels, corners, boxes)
            # Where the nearest cloth went bounds what is nearest now.
            carry_found(found, went, own, faces)
            searched = Searched(own, faces, cloth.fans, cloth.order, cloth.children, cloth.bottoms, corners, boxes)
            update_closest(searched, cloth.names, skin.places, np.inf, 0.0, False, found)
            boxes = alone
        searched = Searched(own, faces, cloth.fans, cloth.order, cloth.children, cloth.bottoms, corners, boxes)
        update_closest(searched, cloth.names, skin.places, np.inf, -1.0, True, found)
    nearest = found.triangle, found.positions, found.beyond
    heights, _, belongs = described(nearest, skin.places, skin.normals, own, faces)
    near = np.abs(found.distances) < SKIN_OVER_CLOTH
    low = np.flatnonzero(belongs & near & (heights < clearance))
    lifts, normals = clearance - heights[low], skin.normals[low]
    add_lifts(direction, size, faces[found.triangle[low]] + cloth.first, found.barycentric[low], lifts, normals)
    if near.all():
        return skin
    rows = np.flatnonzero(near)
    return _Skin(skin.places[rows], skin.normals[rows], _among(found, rows))
