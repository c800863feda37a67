"""Panels of the built-in garments: cut along sides, armholes, sleeves and legs, each laid flat, its grain upright."""

from __future__ import annotations

import numpy as np

from pb4u.garment.body_form import BodyForm, Limb
from pb4u.garment.cuts import Cut
from pb4u.geometry.flattening import flattened
from pb4u.geometry.topology import Topology, connected_labels, uv_islands
from pb4u.geometry.triangle_mesh import carried_directions, face_areas

_GAP = 0.02
"""Distance [m] between panels: a filtered texture must not bleed."""

_EASE = 0.8
"""Share of what a panel has too much, where the garment is curved, that is left to it. With none, the mean stretch
of a fitted dress is 2 % where it is worn; with this it is 0.3 %, for 3 % more cloth; with all, seams are gathered."""


def flat_panels(vertices: np.ndarray, faces: np.ndarray, form: BodyForm, cut: Cut) -> tuple[np.ndarray, np.ndarray]:
    """The panels of a garment laid flat side by side, as they are cut from cloth whose warp runs upwards.

    Up is the vertical of the worn garment, and along sleeves and legs the axis of the limb. A panel that would fold
    over is cut in two.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        form: the body that it was cut for.
        cut: of the garment.

    Returns:
        Points (n, 2) [m], 0 and more, and their faces (faces, 3) int64; no two panels share points.
    """
    middles = vertices[faces].mean(axis=1)
    panel_of, up = _panels(middles, form, cut)
    panel_of = _tidy(panel_of, faces, len(vertices))
    while True:
        corners = _own_corners(faces, panel_of, len(vertices))
        island = uv_islands(corners)
        first = np.unique(island, return_index=True)[1]
        points, point_faces, offset, count = [], np.empty_like(faces), 0.0, 0
        for number in np.lexsort((first, panel_of[first])):
            panel = np.flatnonzero(island == number)
            _, index, triangles = np.unique(corners[panel], return_index=True, return_inverse=True)
            triangles, places = triangles.reshape(-1, 3), vertices[faces[panel].ravel()[index]]
            flat = flattened(places, triangles, _EASE)
            if flat is None:
                across = np.linalg.svd(middles[panel] - middles[panel].mean(axis=0), full_matrices=False)[2][1]
                panel_of[panel[np.argsort(middles[panel] @ across)[: len(panel) // 2]]] = panel_of.max() + 1
                break
            flat = _upright(flat, triangles, places, up[panel])
            flat += [offset, 0.0] - flat.min(axis=0)
            offset = float(flat[:, 0].max()) + _GAP
            points.append(flat)
            point_faces[panel] = triangles + count
            count += len(flat)
        else:
            return np.concatenate(points), point_faces


def _own_corners(faces: np.ndarray, panel_of: np.ndarray, vertex_count: int) -> np.ndarray:
    """Points (faces, 3) int64 of faces that share those of an edge with a neighbour in the same panel, and no others.

    A vertex where two parts of a panel touch without an edge is a point of each.
    """
    topology = Topology(faces, vertex_count)
    joined = panel_of[topology.hinge_faces[:, 0]] == panel_of[topology.hinge_faces[:, 1]]
    sides, ends = topology.hinge_faces[joined], topology.hinges[joined, :2]
    # Number of the corner of each side's face at each end of the edge.
    at = 3 * sides[:, :, None] + (faces[sides][:, :, None] == ends[:, None, :, None]).argmax(axis=3)
    return connected_labels(faces.size, at[:, 0].ravel(), at[:, 1].ravel()).reshape(-1, 3).astype(np.int64)


def _upright(flat: np.ndarray, faces: np.ndarray, places: np.ndarray, up: np.ndarray) -> np.ndarray:
    """A panel (vertices, 2) [m] turned so that `up` (faces, 3) on its faces where it is worn points up in the mean."""
    ways = face_areas(places, faces) @ carried_directions(up, places[faces], flat[faces])
    x, y = ways / max(float(np.linalg.norm(ways)), 1e-30)
    return flat @ np.array([[y, x], [-x, y]])


def _panels(points: np.ndarray, form: BodyForm, cut: Cut) -> tuple[np.ndarray, np.ndarray]:
    """Panel (n,) of each point, and what is up there (n, 3): even numbers in front, odd ones at the back."""
    torso = form.torso
    forward = points[:, 2] - np.interp(points[:, 1], torso.heights, torso.centres[:, 1])
    part, up = np.zeros(len(points), dtype=np.int64), np.tile([0.0, 1.0, 0.0], (len(points), 1))
    if cut.sleeve > 0.0:
        for k, arm in enumerate(form.arms):
            on_arm, ahead, way = _along_arm(points, form, arm)
            part[on_arm], up[on_arm] = k + 1, -way[on_arm]
            forward = np.where(on_arm, ahead, forward)
    if cut.legs:
        for k, leg in enumerate(form.legs):
            on_leg = leg.side * points[:, 0] >= 0.0
            part[on_leg], up[on_leg] = k + 1, leg.joints[0] - leg.joints[2]
    return 2 * part + (forward <= 0.0), up


def _along_arm(points: np.ndarray, form: BodyForm, arm: Limb) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether each point (n, 3) is on the sleeve, how far before the arm's axis [m], and the way (n, 3) of that."""
    places = np.array([arm.along(s) for s in np.linspace(0.0, 2.1, 43)])
    way = np.gradient(places, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    distance = np.linalg.norm(points[:, None] - places, axis=2)
    nearest = np.argmin(distance, axis=1)
    on_arm = (nearest > 2) & (arm.side * points[:, 0] > abs(arm.joints[0, 0]) + 0.03 * form.scale)
    on_arm &= distance.min(axis=1) < 0.16 * form.scale
    forward = np.array([0.0, 0.0, 1.0]) - way[:, 2:] * way
    return on_arm, np.einsum("nd,nd->n", points - places[nearest], forward[nearest]), way[nearest]


def _tidy(panel_of: np.ndarray, faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """Gives faces that stand between two of another panel, and stray specks, to the panel around them."""
    pairs = Topology(faces, vertex_count).hinge_faces
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    names, panel_of = np.unique(panel_of, return_inverse=True)
    rows = np.arange(len(faces))
    for turn in range(10):
        # Two neighbours could swap for ever under a simple majority: later turns ask for all three.
        majority = 2.0 if turn < 4 else 3.0
        votes = np.zeros((len(faces), len(names)))
        np.add.at(votes, (pairs[:, 0], panel_of[pairs[:, 1]]), 1.0)
        winner = votes.argmax(axis=1)
        panel_of = np.where(votes[rows, winner] >= majority, winner, panel_of)
        piece = uv_islands(_own_corners(faces, panel_of, vertex_count))
        speck = np.bincount(piece)[piece] < 0.1 * np.bincount(panel_of)[panel_of]
        votes[rows, panel_of] = 0.0
        panel_of = np.where(speck & (votes.max(axis=1) > 0), votes.argmax(axis=1), panel_of)
    return names[panel_of]
