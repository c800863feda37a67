"""Makes the smooth surface of a garment for one body: pieces of drape joined, then cut open at neck, cuffs and hem."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pb4u.garment.body_form import BodyForm, Limb
from pb4u.garment.cuts import Cut
from pb4u.garment.drape import (
    cone_chain_field,
    hanging,
    skin_field,
    sleeve_field,
    smooth_intersection,
    smooth_union,
    tube_field,
)
from pb4u.geometry.implicit_surface import ImplicitSurface, Lattice

#: Distance [m] between cloth and skin where a garment rests on the body.
REST_CLEARANCE = 0.007
# The widest neck hole as a share of the shoulders, by how they slope [rad]: under sleeves, and between straps. On 18
# degrees straps of stiff, heavy cloth (leather) slide off a jumping body at 0.52 and stay at 0.45; on 21 and 40 those
# of wool slide at 0.58 and 0.48 and stay at 0.45; on 16, the built-in woman's, leather stays at 0.56.
_NECK_SHARES = (np.deg2rad((22.0, 30.0)), (0.58, 0.48))
_STRAPPED_NECK_SHARES = (np.deg2rad((16.5, 18.5)), (0.58, 0.45))
# Room [m] in the lattice around a garment, more than its ease and what its fields are smoothed by.
_MARGIN = 0.05


def tailor(cut: Cut, form: BodyForm) -> ImplicitSurface:
    """The garment surface for a body, ready to be meshed at any resolution.

    Args:
        cut: of the garment.
        form: measures of the body.
    """
    if cut.legs:
        return _trousers(cut, form)
    if cut.top == "waist":
        return _skirt(cut, form)
    return _top(cut, form)


def hem_height(cut: Cut, form: BodyForm) -> float:
    """Height [m] of the hem.

    Args:
        cut: of the garment.
        form: measures of the body.
    """
    base = {
        "crotch": form.crotch,
        "knee": form.knee_height,
        "calf": 0.45 * form.knee_height + 0.55 * form.ankle_height,
        "ankle": form.ankle_height,
    }[cut.hem]
    return base + cut.hem_offset * form.scale


def _ease(cut: Cut, form: BodyForm, hem: float) -> Callable[[np.ndarray], np.ndarray]:
    chest, waist, hip, end = (value * form.scale for value in cut.ease)
    if cut.top == "waist":
        places = [(hem, end), (form.hip_height, hip), (form.waist, waist)]
    else:
        top = form.shoulder_height
        places = [
            (hem, end), (form.hip_height, hip), (form.waist, waist), (form.armpit, chest),
            (form.armpit + 0.6 * (top - form.armpit), REST_CLEARANCE), (top, REST_CLEARANCE),
        ]  # fmt: skip
    places.sort(key=lambda place: place[0])
    heights, values = np.array(places).T
    return lambda y: np.interp(y, heights, values)


def _taper(cut: Cut, form: BodyForm) -> Callable[[np.ndarray], np.ndarray]:
    above, below = cut.taper

    def taper(y: np.ndarray) -> np.ndarray:
        blend = np.clip((y - form.waist) / (0.06 * form.scale) + 0.5, 0.0, 1.0)
        return blend * above + (1.0 - blend) * below

    return taper


def _spacing(form: BodyForm) -> float:
    return 0.012 * float(np.clip(form.scale, 0.5, 1.3))


def _top(cut: Cut, form: BodyForm) -> ImplicitSurface:
    from scipy.ndimage import gaussian_filter

    hem = hem_height(cut, form)
    chest_top = form.shoulder_height - 0.025 * form.scale
    sections = hanging(form.torso, _ease(cut, form, hem), _taper(cut, form), chest_top, hem)
    lattice = _lattice(form, sections.reach(hem - 0.05, chest_top), hem, cut)
    y = lattice.axes[1]

    tube = tube_field(lattice, sections)
    capped = smooth_intersection(tube, y - chest_top, 0.03 * form.scale)
    sleeved = cut.sleeve > 0.0
    left_out = form.head | (form.hand_skin if sleeved else form.arm_skin)
    skin = skin_field(lattice, form, left_out)
    shape = smooth_union(capped, skin - REST_CLEARANCE, 0.02 * form.scale)
    sleeves = np.full(lattice.shape, 0.1)
    if sleeved:
        start, end = (value * form.scale for value in cut.sleeve_ease)

        def slack(place: np.ndarray) -> np.ndarray:
            return np.interp(place, [0.15, min(0.6, cut.sleeve)], [start, end])

        for arm in form.arms:
            sleeves = np.minimum(sleeves, sleeve_field(lattice, form, arm, slack, cut.sleeve))
        shape = smooth_union(shape, sleeves, 0.045 * form.scale)
    shape = gaussian_filter(shape, 1.2, mode="nearest")
    shape = smooth_union(shape, skin - REST_CLEARANCE, 0.006)

    arm_side = tube - _arm_distance(lattice, form)
    ends = [_neck_cut(cut, form, lattice)]
    if sleeved:
        ends.append(np.minimum(hem - y, -arm_side))
        ends += [_cuff_cut(lattice, arm, cut.sleeve, arm_side) for arm in form.arms]
    else:
        ends.append(np.broadcast_to(hem - y, lattice.shape))
        ends += [_armhole_cut(cut, form, lattice, arm) for arm in form.arms]
        # The arm itself always comes out through the hole.
        arm_skin = _distance_to(lattice, form, form.arm_skin & ~_shoulder_skin(form))
        ends.append(0.014 * form.scale - arm_skin)
    if cut.front_gap > 0.0:
        ends.append(_front_cut(cut, form, lattice))
    outside = ends[0]
    for other in ends[1:]:
        outside = smooth_intersection(outside, other, 0.02 * form.scale)
    return ImplicitSurface(lattice, shape, gaussian_filter(outside, 0.8, mode="nearest"))


def _lattice(form: BodyForm, reach: np.ndarray, hem: float, cut: Cut) -> Lattice:
    low = np.array([-reach[0], hem, -reach[1]])
    high = np.array([reach[0], form.neck[1] + 0.05 * form.scale, reach[1]])
    if cut.sleeve > 0.0:
        for arm in form.arms:
            for place in (0.0, min(1.0, cut.sleeve), cut.sleeve):
                point = arm.along(place)
                low = np.minimum(low, point - 0.1 * form.scale)
                high = np.maximum(high, point + 0.1 * form.scale)
    return Lattice.around(low - _MARGIN, high + _MARGIN, _spacing(form))


def _arm_distance(lattice: Lattice, form: BodyForm) -> np.ndarray:
    """Distance to the nearer arm's bones less a typical arm radius: small on arms, large on the torso."""
    field = np.full(lattice.shape, 1.0)
    for arm in form.arms:
        places = np.array([arm.along(s) for s in np.linspace(0.15, 2.0, 12)])
        places = np.concatenate([places, places[-1:] + 0.25 * form.scale * arm.direction(1.9)])
        field = np.minimum(field, cone_chain_field(lattice, places, np.full(len(places), 0.05 * form.scale)))
    return field


def _neck_width(cut: Cut, form: BodyForm) -> float:
    """Half the width [m] of the neck hole, held clear of the ends of the shoulders, the more so the more they slope."""
    share = float(np.interp(form.shoulder_slope, *(_STRAPPED_NECK_SHARES if cut.strap > 0.0 else _NECK_SHARES)))
    return min(form.neck_half_width + cut.neckline.spread * form.scale, share * form.shoulder_half_width)


def _neck_cut(cut: Cut, form: BodyForm, lattice: Lattice) -> np.ndarray:
    x, y, z = lattice.axes
    line = cut.neckline
    front = form.midline(float(form.neck[1]) - line.front * form.scale, front=True)
    back = form.midline(float(form.neck[1]) - line.back * form.scale, front=False)
    way = (front - back)[1:] / np.linalg.norm((front - back)[1:])
    above = (y - back[1]) * way[1] - (z - back[2]) * way[0]
    width = _neck_width(cut, form)
    return smooth_union(above, width - np.abs(x), 0.08 * form.scale)


def _cuff_cut(lattice: Lattice, arm: Limb, end: float, arm_side: np.ndarray) -> np.ndarray:
    x, y, z = lattice.axes
    place, axis = arm.along(end), arm.direction(end)
    beyond = (x - place[0]) * axis[0] + (y - place[1]) * axis[1] + (z - place[2]) * axis[2]
    return np.minimum(np.minimum(beyond, arm_side), arm.side * x)


def _armhole_cut(cut: Cut, form: BodyForm, lattice: Lattice, arm: Limb) -> np.ndarray:
    x, y, _ = lattice.axes
    strap = _neck_width(cut, form) + cut.strap * form.scale
    low = form.armpit - cut.armhole_depth * form.scale
    chest = form.torso.support[form.torso.level(form.armpit - 0.02), form.torso.support.shape[1] // 4]
    inset = min(strap, 0.86 * abs(float(arm.joints[0, 0])))
    bottom = max(float(chest) - 0.02 * form.scale, inset)
    top = float(arm.joints[0, 1]) + 0.03 * form.scale
    edge = inset + (bottom - inset) * np.clip((top - y) / (top - low), 0.0, 1.5) ** 2
    outward = arm.side * x - edge
    return smooth_union(outward, np.broadcast_to(y - low, outward.shape), 0.06 * form.scale)


def _shoulder_skin(form: BodyForm) -> np.ndarray:
    """(vertices,) bool: the cap of the shoulder, over which straps may lie."""
    y = form.body.vertices[:, 1]
    return y > form.shoulder_height


def _distance_to(lattice: Lattice, form: BodyForm, skin: np.ndarray) -> np.ndarray:
    from scipy.spatial import cKDTree

    points, _, owner = form.samples
    tree = cKDTree(points[skin[owner]], balanced_tree=False, compact_nodes=False)
    distance, _ = tree.query(lattice.points, distance_upper_bound=0.05)
    return np.minimum(distance, 0.05).reshape(lattice.shape)


def _front_cut(cut: Cut, form: BodyForm, lattice: Lattice) -> np.ndarray:
    x, y, z = lattice.axes
    middle = np.interp(y, form.torso.heights, form.torso.centres[:, 1])
    gap = 0.5 * cut.front_gap * form.scale - np.abs(x)
    return np.minimum(np.broadcast_to(gap, lattice.shape), z - middle)


def _skirt(cut: Cut, form: BodyForm) -> ImplicitSurface:
    hem = hem_height(cut, form)
    sections = hanging(form.torso, _ease(cut, form, hem), _taper(cut, form), form.waist + 0.02, hem)
    reach = sections.reach(hem - 0.05, form.waist)
    low, high = np.array([-reach[0], hem, -reach[1]]), np.array([reach[0], form.waist, reach[1]])
    lattice = Lattice.around(low - _MARGIN, high + _MARGIN, _spacing(form))
    y = lattice.axes[1]
    end = np.maximum(np.broadcast_to(hem - y, lattice.shape), y - form.waist)
    return ImplicitSurface(lattice, tube_field(lattice, sections), end)


def _trousers(cut: Cut, form: BodyForm) -> ImplicitSurface:
    from scipy.ndimage import gaussian_filter

    hem = hem_height(cut, form)
    ease, taper = _ease(cut, form, hem), _taper(cut, form)
    left_out = form.arm_skin | form.head | form.foot_skin
    pelvis = hanging(form.torso, ease, taper, form.waist + 0.02, form.crotch)
    reach = pelvis.reach(form.crotch, form.waist)
    foot = max(abs(limb.joints[2, 0]) for limb in form.legs) + 0.12 * form.scale
    reach[0] = max(reach[0], foot)
    low, high = np.array([-reach[0], hem, -reach[1]]), np.array([reach[0], form.waist, reach[1]])
    lattice = Lattice.around(low - _MARGIN, high + _MARGIN, 0.85 * _spacing(form))
    y = lattice.axes[1]

    shape = smooth_intersection(tube_field(lattice, pelvis), form.crotch + 0.02 * form.scale - y, 0.04 * form.scale)
    for limb in form.legs:
        skin = (limb.side * form.body.vertices[:, 0] > 0) & ~left_out
        leg = hanging(form.sections(skin, None), ease, taper, form.crotch + 0.06 * form.scale, hem)
        tube = smooth_intersection(tube_field(lattice, leg), y - form.crotch - 0.06 * form.scale, 0.03 * form.scale)
        shape = smooth_union(shape, tube, 0.04 * form.scale)
    shape = gaussian_filter(shape, 1.2, mode="nearest")
    shape = smooth_union(shape, skin_field(lattice, form, left_out) - REST_CLEARANCE, 0.006)
    shape = smooth_intersection(shape, _between_legs(lattice, form), 0.015 * form.scale)
    end = np.maximum(np.broadcast_to(hem - y, lattice.shape), y - form.waist)
    return ImplicitSurface(lattice, shape, end)


def _between_legs(lattice: Lattice, form: BodyForm) -> np.ndarray:
    """Positive in the slot that keeps the trouser legs apart, below the height where there is room for it."""
    from scipy.ndimage import gaussian_filter1d

    points, _, owner = form.samples
    leg = (form.legs[0].belongs | form.legs[1].belongs)[owner] & (points[:, 1] < form.crotch + 0.02)
    heights = form.torso.heights
    level = form.torso.level
    room = np.full(len(heights), np.inf)
    np.minimum.at(
        room,
        np.clip(np.rint(points[leg, 1] / (heights[1] - heights[0])).astype(int), 0, len(room) - 1),
        np.abs(points[leg, 0]),
    )
    room[level(form.crotch) :] = 0.0
    half = np.clip(room - 0.005, 0.0, 0.03 * form.scale)
    half = np.minimum.reduce([half, np.roll(half, 1), np.roll(half, -1)])
    narrow = np.flatnonzero(half < 0.006 * form.scale)
    narrow = narrow[narrow > level(form.ankle_height)]
    top = heights[narrow[0]] if len(narrow) else form.crotch - 0.02
    arch = 0.006 * form.scale + 0.25 * np.maximum(top - heights, 0.0)
    half = gaussian_filter1d(np.where(heights < top, np.minimum(half, arch), 0.0), 1.0, mode="nearest")
    x, y, _ = lattice.axes
    width = np.interp(y, heights, half)
    return np.broadcast_to(smooth_union(width - np.abs(x), np.broadcast_to(top - y, width.shape), 0.01), lattice.shape)
