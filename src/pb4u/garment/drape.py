"""Fields whose zero sets are pieces of clothing: a hanging tube around the torso or a leg, sleeves, the skin itself.

Every field is sampled on a lattice, in metres, negative inside the piece and about a distance near its surface.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pb4u.garment.body_form import BodyForm, Limb, Sections, directions
from pb4u.geometry.implicit_surface import Lattice

#: Skin farther than this from a lattice point is only classified as inside or outside [m].
_BAND = 0.045
# Width of the smoothing of hanging cloth along the height [m]: folds finer than this cloth does not take up at rest.
_SMOOTHING = 0.02


def smooth_union(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """The smaller of two fields, rounded where they are nearly equal.

    Args:
        a: (...) field [m].
        b: (...) the other field [m].
        width: difference below which it is rounded [m].

    Returns:
        (...) [m].
    """
    overlap = np.maximum(width - np.abs(a - b), 0.0)
    return np.minimum(a, b) - 0.25 * overlap**2 / width


def smooth_intersection(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """The larger of two fields, rounded where they are nearly equal.

    Args:
        a: (...) field [m].
        b: (...) the other field [m].
        width: difference below which it is rounded [m].

    Returns:
        (...) [m].
    """
    return -smooth_union(-a, -b, width)


def hanging(
    sections: Sections,
    ease: Callable[[np.ndarray], np.ndarray],
    taper: Callable[[np.ndarray], np.ndarray],
    top: float,
    bottom: float,
) -> Sections:
    """Sections of cloth that hangs from everything above it, from height `top` down to `bottom` [m].

    Args:
        sections: the skin.
        ease: height (n,) -> distance (n,) from the skin [m].
        taper: height (n,) -> largest decrease (positive) or least flare (negative) of the radius per metre downwards.
        top: nothing above this height holds the cloth.
        bottom: lowest height of the sections [m].
    """
    from scipy.ndimage import gaussian_filter1d

    heights, units = sections.heights, directions()
    step = heights[1] - heights[0]
    world = sections.support + sections.centres @ units.T + ease(heights)[:, None]
    slope = taper(heights) * step
    cloth = np.full_like(world, np.nan)
    line = np.full(world.shape[1], -np.inf)
    for level in range(sections.level(top), -1, -1):
        line = line - slope[level]
        skin = np.where(np.isfinite(world[level]), world[level], -np.inf)
        line = np.maximum(line, skin)
        cloth[level] = line
    first, last = sections.level(bottom - 0.1), sections.level(top)
    cloth[last + 1 :] = cloth[last]
    cloth[:first] = cloth[first]
    cloth = gaussian_filter1d(cloth, _SMOOTHING / step, axis=0, mode="nearest")
    local = cloth - sections.centres @ units.T
    local = gaussian_filter1d(local, 1.0, axis=1, mode="wrap")
    return Sections(heights, sections.centres, local)


def tube_field(lattice: Lattice, sections: Sections) -> np.ndarray:
    """Field of an endless vertical tube.

    Args:
        lattice: points at which to sample the field.
        sections: of the tube.

    Returns:
        (nx, ny, nz) [m].
    """
    x, y, z = (axis.reshape(-1) for axis in lattice.axes)
    units = directions()
    support = np.column_stack([np.interp(y, sections.heights, column) for column in sections.support.T])
    centre = np.column_stack([np.interp(y, sections.heights, sections.centres[:, k]) for k in (0, 1)])
    field = np.full(lattice.shape, -np.inf, dtype=np.float32)
    for k, (ux, uz) in enumerate(units):
        level = (support[:, k] + centre @ np.array([ux, uz])).astype(np.float32)
        reach = (x[:, None] * ux + z[None, :] * uz).astype(np.float32)
        np.maximum(field, reach[:, None, :] - level[None, :, None], out=field)
    return field.astype(np.float64)


def sleeve_field(
    lattice: Lattice, form: BodyForm, arm: Limb, ease: Callable[[np.ndarray], np.ndarray], end: float
) -> np.ndarray:
    """Field of a tube around an arm from inside the shoulder to `end` (0 shoulder, 1 elbow, 2 wrist).

    The tube lies lightly on the top of the arm and its ease hangs below.

    Args:
        lattice: points at which to sample the field.
        form: measures of the body.
        arm: the arm.
        ease: position along the arm (n,) -> extra radius of the tube [m].
        end: position along the arm where the sleeve ends (1 elbow, 2 wrist).

    Returns:
        (nx, ny, nz) [m].
    """
    from scipy.ndimage import gaussian_filter1d

    points, _, owner = form.samples
    skin = points[(arm.belongs & ~arm.tip)[owner]]
    stations = np.arange(0.0, min(end + 0.15, 2.0) + 1e-9, 0.04)
    bone = np.array([arm.along(s) for s in stations])
    if end + 0.15 > 2.0:
        over = (end + 0.15 - 2.0) * np.linalg.norm(arm.joints[2] - arm.joints[1])
        bone = np.concatenate([bone, bone[-1:] + over * arm.direction(1.9)])
        stations = np.append(stations, end + 0.15)
    bone = gaussian_filter1d(bone, 2.0, axis=0, mode="nearest")
    way = np.gradient(bone, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    centres, radii = [], []
    for place, axis in zip(bone, way, strict=True):
        along = (skin - place) @ axis
        ring = skin[np.abs(along) < 0.012] - place
        ring = ring - np.outer(ring @ axis, axis)
        ring = ring[np.linalg.norm(ring, axis=1) < 0.14 * form.scale]
        if len(ring) < 8:
            centres.append(np.full(3, np.nan))
            radii.append(np.nan)
            continue
        middle = 0.5 * (ring.max(axis=0) + ring.min(axis=0))
        centres.append(place + middle - (middle @ axis) * axis)
        radii.append(float(np.linalg.norm(ring - middle, axis=1).max()))
    radius = _filled(np.array(radii))
    centre = np.column_stack([_filled(np.array(centres)[:, k]) for k in range(3)])
    # The first stations cut through the shoulder itself, where no ring of arm skin closes.
    settled = int(np.searchsorted(stations, 0.3))
    radius[:settled] = radius[settled]
    offset = centre - bone
    offset[:settled] = offset[settled]
    slack = ease(stations)
    down = np.array([0.0, -1.0, 0.0]) - np.outer(way @ np.array([0.0, -1.0, 0.0]), np.ones(3)) * way
    centre = gaussian_filter1d(bone + offset, 2.0, axis=0, mode="nearest") + 0.75 * slack[:, None] * down
    radius = gaussian_filter1d(radius + slack, 2.0, mode="nearest")

    return cone_chain_field(lattice, centre, radius)


def cone_chain_field(lattice: Lattice, centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Field of the union of the cones between consecutive discs, capped far away.

    Args:
        lattice: points at which to sample the field.
        centre: (n, 3) centres of the discs [m].
        radius: (n,) their radii [m].

    Returns:
        (nx, ny, nz) [m].
    """
    field = np.full(lattice.shape, 0.1)
    x, y, z = lattice.axes
    reach = radius.max() + 0.1
    for k in range(len(centre) - 1):
        a, b = centre[k], centre[k + 1]
        low = np.maximum(np.floor((np.minimum(a, b) - reach - lattice.origin) / lattice.spacing).astype(int), 0)
        high = np.ceil((np.maximum(a, b) + reach - lattice.origin) / lattice.spacing).astype(int) + 1
        box = tuple(slice(int(p), int(max(q, p))) for p, q in zip(low, high, strict=True))
        if any(s.start >= n for s, n in zip(box, lattice.shape, strict=True)):
            continue
        dx, dy, dz = x[box[0]] - a[0], y[:, box[1]] - a[1], z[:, :, box[2]] - a[2]
        way = b - a
        t = np.clip((dx * way[0] + dy * way[1] + dz * way[2]) / max(float(way @ way), 1e-12), 0.0, 1.0)
        distance = np.sqrt((dx - t * way[0]) ** 2 + (dy - t * way[1]) ** 2 + (dz - t * way[2]) ** 2)
        field[box] = np.minimum(field[box], distance - (radius[k] + t * (radius[k + 1] - radius[k])))
    return field


def _filled(values: np.ndarray) -> np.ndarray:
    finite = np.isfinite(values)
    return np.interp(np.arange(len(values)), np.flatnonzero(finite), values[finite])


def skin_field(lattice: Lattice, form: BodyForm, left_out: np.ndarray) -> np.ndarray:
    """Signed distance to the skin, exact within a few centimetres.

    Args:
        lattice: points at which to sample the field.
        form: measures of the body.
        left_out: (vertices,) bool, skin that is not covered: where such skin is nearest the field is +3 cm.

    Returns:
        (nx, ny, nz) [m].
    """
    from scipy.ndimage import label
    from scipy.spatial import cKDTree

    points, normals, owner = form.samples
    grid = lattice.points
    inside_box = ((points > grid[0] - 2 * _BAND) & (points < grid[-1] + 2 * _BAND)).all(axis=1)
    points, normals, owner = points[inside_box], normals[inside_box], owner[inside_box]
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    distance, nearest = tree.query(grid, distance_upper_bound=_BAND)
    finite = np.isfinite(distance)
    field = np.full(len(grid), _BAND)
    offset = grid[finite] - points[nearest[finite]]
    along = np.einsum("ij,ij->i", offset, normals[nearest[finite]])
    # Close to the skin the plane of the nearest sample is better than the sample itself.
    near = np.abs(along) > 0.8 * distance[finite]
    field[finite] = np.where(along < 0, -1.0, 1.0) * np.where(near, np.abs(along), distance[finite])
    field[finite] = np.where(left_out[owner[nearest[finite]]], 0.03, field[finite])
    # What lies beyond the band comes in a few connected regions: one query each tells inside from outside.
    pieces, _ = label((~finite).reshape(lattice.shape))
    pieces = pieces.reshape(-1)
    names, first = np.unique(pieces, return_index=True)
    _, nearest = tree.query(grid[first])
    within = np.einsum("ij,ij->i", grid[first] - points[nearest], normals[nearest]) < 0
    sign = np.where(within & (names > 0), -1.0, 1.0)[np.searchsorted(names, pieces)]
    field = np.where(finite, field, sign * _BAND)
    return field.reshape(lattice.shape)
