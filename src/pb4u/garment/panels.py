"""UVs of the built-in garments: panels cut along sides, armholes, sleeves and legs, each laid flat."""

from __future__ import annotations

import numpy as np

from pb4u.garment.body_form import BodyForm, Limb
from pb4u.garment.cuts import Cut
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import face_areas

# Distance between panels before all are scaled to the unit square [m]: a filtered texture must not bleed.
_GAP = 0.02


def flat_panels(
    vertices: np.ndarray, faces: np.ndarray, form: BodyForm, cut: Cut
) -> tuple[np.ndarray, np.ndarray] | None:
    """UVs of a garment, panel by panel.

    Each panel is flattened conformally (least squares conformal maps, Levy et al. 2002) and scaled to its own area, so
    that all share one scale.

    Args:
        vertices: (vertices, 3) of the garment at rest [m].
        faces: (faces, 3) int64.
        form: the body that it was cut for.
        cut: of the garment.

    Returns:
        UV points (n, 2) in the unit square and their faces (faces, 3), or None where a panel cannot be laid flat.
    """
    panel_of = _panels(vertices[faces].mean(axis=1), form, cut)
    panel_of = _tidy(panel_of, faces, len(vertices))
    uvs, uv_faces = [], np.empty_like(faces)
    offset, count = 0.0, 0
    for name in np.unique(panel_of):
        chosen = np.flatnonzero(panel_of == name)
        labels = Topology(faces[chosen], len(vertices)).piece_of_vertex[faces[chosen, 0]]
        for label in np.unique(labels):
            panel = chosen[labels == label]
            used, local = np.unique(faces[panel], return_inverse=True)
            local = local.reshape(-1, 3)
            flat = _flatten(vertices[used], local)
            if flat is None:
                return None
            flat = flat - flat.min(axis=0) + [offset, 0.0]
            offset = float(flat[:, 0].max()) + _GAP
            uvs.append(flat)
            uv_faces[panel] = local + count
            count += len(flat)
    points = np.concatenate(uvs)
    return points / points.max(), uv_faces


def _panels(points: np.ndarray, form: BodyForm, cut: Cut) -> np.ndarray:
    """(n,) number of the panel that each point is on: even in front, odd at the back; limbs from 2 on."""
    torso = form.torso
    forward = points[:, 2] - np.interp(points[:, 1], torso.heights, torso.centres[:, 1])
    part = np.zeros(len(points), dtype=np.int64)
    if cut.sleeve > 0.0:
        for k, arm in enumerate(form.arms):
            on_arm, ahead = _along_arm(points, form, arm)
            part[on_arm] = k + 1
            forward = np.where(on_arm, ahead, forward)
    if cut.legs:
        part = np.where(points[:, 0] > 0.0, 1, 2)
    return 2 * part + (forward <= 0.0)


def _along_arm(points: np.ndarray, form: BodyForm, arm: Limb) -> tuple[np.ndarray, np.ndarray]:
    """Whether each point (n, 3) is on the sleeve, and how far before the arm's axis it lies [m]."""
    places = np.array([arm.along(s) for s in np.linspace(0.0, 2.1, 43)])
    way = np.gradient(places, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    distance = np.linalg.norm(points[:, None] - places, axis=2)
    nearest = np.argmin(distance, axis=1)
    on_arm = (nearest > 2) & (arm.side * points[:, 0] > abs(arm.joints[0, 0]) + 0.03 * form.scale)
    on_arm &= distance.min(axis=1) < 0.16 * form.scale
    forward = np.array([0.0, 0.0, 1.0]) - way[:, 2:] * way
    return on_arm, np.einsum("nd,nd->n", points - places[nearest], forward[nearest])


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
        speck = np.zeros(len(faces), dtype=bool)
        for name in range(len(names)):
            chosen = np.flatnonzero(panel_of == name)
            labels = Topology(faces[chosen], vertex_count).piece_of_vertex[faces[chosen, 0]]
            speck[chosen] = np.bincount(labels)[labels] < 0.1 * len(chosen)
        votes[rows, panel_of] = 0.0
        panel_of = np.where(speck & (votes.max(axis=1) > 0), votes.argmax(axis=1), panel_of)
    return names[panel_of]


def _flatten(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray | None:
    """(vertices, 2) [m] of a panel laid flat, upright as worn; None when it is not a disk or folds over."""
    import igl

    topology = Topology(faces, len(vertices))
    starts = topology.boundary_edges[:, 0]
    if len(topology.boundary_loops) != 1 or len(np.unique(starts)) != len(starts):
        return None
    low, high = int(np.argmin(vertices[:, 1])), int(np.argmax(vertices[:, 1]))
    fixed = np.array([low, high], dtype=np.int64)
    at = np.array([[0.0, 0.0], [0.0, float(np.linalg.norm(vertices[high] - vertices[low]))]])
    flat = np.asarray(igl.lscm(vertices, faces, fixed, at)[0])
    flat = flat.reshape(-1, 2)
    one, two = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
    double = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    if not np.isfinite(flat).all() or not (double > 0.0).all():
        return None
    return flat * np.sqrt(2.0 * face_areas(vertices, faces).sum() / double.sum())
