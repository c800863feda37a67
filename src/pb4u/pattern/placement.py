"""Where the panels of a pattern are placed around a body before they are sewn, and what of them lies where."""

from __future__ import annotations

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.environment import UP
from pb4u.garment.body_form import form_of
from pb4u.garment.source_map import nearest_places
from pb4u.pattern.body_measurements import shoulder_height, trunk_girths
from pb4u.pattern.mesh import PatternMesh

_REACH = 0.1
"""Distance [m] from the top and the middle of the pattern at which a panel keeps its placement a third as firmly."""

_AHEAD = 0.02
"""Distance [m] from the body at which panels begin."""

_MIDDLE = 0.02
"""Distance [m] from the middle of the body within which four corners of panels that meet are a crotch."""

_CROTCH_ROOM = 0.01
"""Least distance [m] of the crotch of trousers below that of the body."""

_WAISTBAND = 0.05
"""Most height [m] above the waist of the top of a skirt: that of a waistband."""


def around(mesh: PatternMesh, body: ShapedBody) -> np.ndarray:
    """Positions (points, 3) [m] of the panels, at the height of this body's shoulders if the garment has shoulders.

    Trousers with a crotch inside the body, and skirts that begin above the waist, are lowered.

    Args:
        mesh: the panels.
        body: the resting body.
    """
    places = joined(mesh)
    top, rise = shoulder_point(mesh, places), 0.0
    if top is not None:
        rise = shoulder_height(body, abs(places[top, 0])) - float(places[top, 1])
    elif (crotch := crotch_height(mesh, places)) is not None:
        rise = min(0.0, form_of(body).crotch - _CROTCH_ROOM - crotch)
    else:
        rise = min(0.0, trunk_girths(body)["waist"][0] + _WAISTBAND - float(places[:, 1].max()))
    return places + rise * np.array(UP)


def joined(mesh: PatternMesh) -> np.ndarray:
    """Positions (points, 3) [m] of the pattern's panels, moved up, down and out to the panels that they are sewn to.

    Args:
        mesh: the panels.
    """
    places, count = mesh.placed, len(mesh.pattern.panels)
    masks = [mesh.panel == panel for panel in range(count)]
    tops = np.array([places[rows, 1].max() for rows in masks])
    middles = np.array([places[rows, 0].mean() for rows in masks])
    matrix, target = np.diag(np.exp((tops - tops.max() - np.abs(middles)) / _REACH) + 1e-6), np.zeros((count, 2))
    for seam, sides in zip(mesh.pattern.seams, mesh.sides, strict=True):
        one, other = (mesh.panel[side[0]] for side in sides)
        weight = sum(mesh.pattern.seam_lengths(seam))
        gap = np.subtract(*(places[side, :2].mean(axis=0) for side in sides))
        for a, b, sign in ((one, other, -1.0), (other, one, 1.0)):
            matrix[a, a] += weight
            matrix[a, b] -= weight
            target[a] += sign * weight * gap
    shifts = np.linalg.solve(matrix, target)
    # Legs would be drawn into each other, and are wide enough where they are.
    shifts[:, 0] = np.where(shifts[:, 0] * middles > 0.0, shifts[:, 0], 0.0)
    places[:, :2] += shifts[mesh.panel]
    return places


def shoulder_point(mesh: PatternMesh, places: np.ndarray) -> int | None:
    """Number of the highest point of the seams that run across from front to back panels; None where there are none.

    Args:
        mesh: the panels.
        places: (points, 3) of the panels [m].
    """
    facing = np.array([panel.rotation[2, 2] * panel.area for panel in mesh.pattern.panels])
    candidates: list[int] = []
    for one, other in mesh.sides:
        run = np.abs(places[one[-1]] - places[one[0]])
        if facing[mesh.panel[one[0]]] * facing[mesh.panel[other[0]]] < 0.0 and run[0] > run[1]:
            candidates += [*one.tolist(), *other.tolist()]
    return max(candidates, key=lambda point: places[point, 1], default=None)


def crotch_height(mesh: PatternMesh, places: np.ndarray) -> float | None:
    """Height [m] of the lowest point in the middle where four corners of panels are sewn together; None without one.

    Args:
        mesh: the panels.
        places: (points, 3) of the panels [m].
    """
    sewn = mesh.sewn(places)
    meet = (np.bincount(mesh.vertex) >= 4) & (np.abs(sewn[:, 0]) < _MIDDLE)
    return float(sewn[meet, 1].min()) if meet.any() else None


def off_body(mesh: PatternMesh, places: np.ndarray, body: np.ndarray) -> np.ndarray:
    """The same positions (points, 3) [m], each panel moved along its normal until no part of the body is in front of
    it.

    Args:
        mesh: the panels.
        places: (points, 3) of the panels [m].
        body: (body vertices, 3) [m].
    """
    places = places.copy()
    for number, panel in enumerate(mesh.pattern.panels):
        outwards = panel.rotation[:, 2] * np.sign(panel.area)
        rows = mesh.panel == number
        ahead = _over(body, places, mesh.faces[mesh.face_panel == number], panel.rotation) @ outwards
        places[rows] += max(0.0, ahead.max(initial=-np.inf) + _AHEAD - places[rows][0] @ outwards) * outwards
    return places


def sleeve_points(mesh: PatternMesh, places: np.ndarray) -> np.ndarray:
    """Points (n, 3) [m] of panels labelled "arm" in the frontal plane, with right ones mirrored to the left (+X).

    Args:
        mesh: mesh of the pattern.
        places: (points, 3) [m] around the body.
    """
    arms = np.array([panel.label == "arm" for panel in mesh.pattern.panels])
    x, y, _ = places[arms[mesh.panel]].T
    return np.column_stack([np.abs(x), y, np.zeros(len(x))])


def _over(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Those of some points (n, 3) [m] that lie over or under flat triangles, whose plane has the axes `rotation`."""
    flat, corners = points @ rotation[:, :2], (vertices @ rotation[:, :2])[faces].reshape(-1, 2)
    near = points[((flat >= corners.min(axis=0)) & (flat <= corners.max(axis=0))).all(axis=1)]
    axes = rotation * np.array([1.0, 1.0, 0.0])
    face, shares = nearest_places(near @ axes, vertices @ axes, faces)
    on_panel = np.einsum("nc,ncx->nx", shares, (vertices @ axes)[faces[face]])
    return near[np.linalg.norm(near @ axes - on_panel, axis=1) < _AHEAD]
